"""Checks of arguments: one clear error that names the argument, its value and what it must be.

A concrete value raises `ValueError` at once, before anything is compiled. A traced value (inside `jax.jit`,
`jax.grad`, ...) cannot be inspected: a wrong one becomes NaN, which gives the result a status.
"""

import dataclasses
import re
import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .texts import brief
from .tracing import is_traced
from .units import in_unit, unmasked

Value = TypeVar("Value")
LATEST = 1e6
"""Time from which a time counts as one of a clock, and not as one since the beginning of a run [s]."""


def hint(wrong: object, names: Iterable[str]) -> str:
    """Return a question with the most similar of some names, for the end of an error; empty if none is similar."""
    import difflib  # here, because only errors need it

    if not isinstance(wrong, str):
        return ""
    # capitals count little
    small = {name.lower(): name for name in names}
    close = difflib.get_close_matches(wrong.lower(), small, 1)
    return f" Did you mean {small[close[0]]}?" if close else ""


def require(
    ok: object, name: str, need: str, value: object = None, *, shown: str = "", names: Iterable[str] = ()
) -> None:
    """Raise `ValueError` "Argument `name` must `need`, but is `value`." unless `ok`.

    **Arguments:** `name`: of the argument, or of an option such as --over; `need`: begins with a verb, such as "be
    positive"; after the verb "have" the message ends with "but has `value`"; `shown`: words in place of the value;
    `names`: possible names, of which the value may be a misspelt one.
    """
    if ok:
        return
    of = f"Option {name}" if name.startswith("--") else f"Argument `{name}`"
    verb = "has" if need.startswith("have") else "is"
    if not shown:
        shown = f"{value:g}" if isinstance(value, float | np.floating) else brief(value)
    raise ValueError(f"{of} must {need}, but {verb} {shown}.{hint(value, names)}")


def converted(name: str, unit: str) -> Callable[[object], Any]:
    """Return a field converter from the values that `in_unit` takes to numbers in a unit, without further checks."""

    def convert(value: object):
        try:
            return in_unit(value, unit)
        except TypeError as error:
            raise ValueError(f"Argument `{name}` must be in {unit}, but is {brief(value)}: {error}") from None

    return convert


@dataclasses.dataclass(frozen=True)
class Check:
    """Field converter to an array of any shape, which requires numbers of some kind; `optional` lets None pass.

    A value with its own unit is converted to `unit`, see `in_unit`; masked numbers are missing.
    """

    name: str
    unit: str = ""
    need: str = "finite"
    is_good: Callable[[Any], Any] = lambda x: abs(x) < np.inf
    """Returns for each number whether it is good."""
    optional: bool = False
    whole: bool = False
    """Whether the numbers are whole: they have no small changes, so that there are no derivatives by them."""
    plausible: tuple[float, float] | None = None
    """Range [unit] outside of which an `ImplausibleWarning` says that the unit may be wrong."""

    def __call__(self, value: object) -> Any:
        if self.optional and value is None:
            return None
        # Whether a traced value is good is not known here. A bad one becomes NaN, which gives the result a status.
        if isinstance(value, jax.core.Tracer):
            value = jnp.asarray(value, float)
            return jnp.where(self.is_good(value), value, jnp.nan)
        unit = "" if self.unit == "1" else self.unit
        kind = f"a number in {unit}" if unit else "a number"
        try:
            value = in_unit(value, self.unit)
        except (TypeError, RecursionError) as error:
            raise self._error(f"{brief(value)}, not {kind}: {error}") from None
        try:
            array = np.asarray(value)
            # integers and floats only: NumPy would also make numbers of bools and of texts such as "1.5"
            if array.size and array.dtype.kind not in "fiu":
                raise TypeError
            array = array.astype(float)
        except (TypeError, ValueError, RecursionError):
            raise self._error(f"{brief(value)}, not {kind}") from None
        bad = array[~self.is_good(array)]
        if bad.size:
            raise self._error(f"{bad[0]:.12g} {unit}".rstrip())
        if self.plausible is not None:
            warn_unless_within(self.name, array, *self.plausible, self.unit)
        return jnp.asarray(array)

    def _error(self, shown: str) -> ValueError:
        return ValueError(f"Argument `{self.name}` must be {self.need}, but is {shown}.")


# kinds of numbers: each is called with a name and a unit, and makes a check
finite = Check
positive = partial(Check, need="positive", is_good=lambda x: (x > 0) & (x < np.inf))
not_negative = partial(Check, need="zero or positive", is_good=lambda x: (x >= 0) & (x < np.inf))
fraction = partial(Check, need="above 0 and at most 1", is_good=lambda x: (x > 0) & (x <= 1))


def whole_number(name: str, unit: str = "", *, most: int = 2**53 - 1) -> Check:
    """Return a check of whole numbers of 0 to `most`: up to 2^53 - 1 they are exact in double precision."""
    need = f"a whole number of 0 to {'2^53 - 1' if most == 2**53 - 1 else most}"
    return Check(name, unit, need, lambda x: (x >= 0) & (x <= most) & (x == x.round()), whole=True)


def number(check: Callable[[str, str], Check], name: str, value: object, unit: str = "") -> float:
    """Return a single number that passes `check`, such as `positive`; raises `ValueError` otherwise."""
    array = check(name, unit)(known(name, value))
    require(np.ndim(array) == 0, name, "be one number", value)
    # from `value`, because inside jit the checked array is traced
    return float(np.asarray(in_unit(value, unit), float))


def yes_or_no(name: str, value: object) -> bool:
    """Return `value`, which must be True or False; raises `ValueError` otherwise."""
    require(isinstance(value, bool | np.bool_), name, "be True or False", value)
    return bool(value)


def instance(name: str, value: Any, kind: type[Value] | tuple[type[Value], ...], text: str) -> Value:
    """Return `value`, which must be of a class; the `ValueError` otherwise calls the class `text`."""
    require(isinstance(value, kind), name, f"be {text}", value)
    return value


def tuple_of(
    name: str, value: Any, kind: type[Value] | tuple[type[Value], ...], text: str, *, shown: str = ""
) -> tuple[Value, ...]:
    """Return a sequence of instances of a class as a tuple; the `ValueError` otherwise calls the class `text`."""
    # a text is a sequence, too, whose letters are texts
    try:
        parts = None if isinstance(value, str) else tuple(value)
    except TypeError:
        parts = None
    ok = parts is not None and all(isinstance(part, kind) for part in parts)
    require(ok, name, f"be {text}", value, shown=shown)
    return parts or ()


def _kind(value: object) -> str:
    """Return NumPy's letter for the type of numbers, such as "f"; "O" for values that make no array of numbers."""
    if hasattr(value, "magnitude"):  # a quantity, which NumPy would strip of its unit
        return "O"
    try:
        return np.asarray(value).dtype.kind
    except (TypeError, ValueError):  # such as datasets, and rows of different lengths
        return "O"


def numbers(name: str, value: object, axes: int = 0, unit: str | None = None) -> np.ndarray:
    """Return an array of numbers with at least `axes` axes, NaN for masked ones; raises `ValueError` otherwise.

    **Arguments:** `unit`: unit to which values with their own units are converted; None for numbers of any unit.
    """
    need = "be numbers"
    if axes:
        need += " along one axis or more" if axes == 1 else f" with {axes} axes or more"
    plain = unmasked(value) if unit is None else converted(name, unit)(value)
    require(_kind(plain) in "biufc", name, need, value)
    array = np.asarray(plain)
    require(array.ndim >= axes, name, need, shown=f"of shape {array.shape}")
    return array


def check_no_clock(name: str, time: np.ndarray) -> None:
    """Raise `ValueError` for times of a clock [s] where times since the beginning of a run are needed."""
    need = "count from the beginning of the run, and not be times of a clock: subtract the first one"
    require(np.all(np.abs(time) < LATEST), name, need, shown=f"{np.max(np.abs(time)):.10g} s")


def is_real(value: object) -> bool:
    """Return whether a value is a real number, or an array of real numbers."""
    return _kind(value) in "fiu"


def real(name: str, value: Value) -> Value:
    """Return `value`, which must be real numbers or traced; raises `ValueError` otherwise."""
    require(is_traced(value) or is_real(value), name, "be real numbers", value)
    return value


TOLD: ContextVar[set[str] | None] = ContextVar("TOLD", default=None)
"""Texts of warnings that a run has given, without numbers: no text is given twice. None outside of runs."""


@contextmanager
def told_once() -> Iterator[None]:
    """Give each kind of warning once within a block, also on threads that begin in it."""
    told = TOLD.set(set() if TOLD.get() is None else TOLD.get())
    try:
        yield
    finally:
        TOLD.reset(told)


class ImplausibleWarning(UserWarning):
    """Warning of an allowed value that is so implausible that its unit may be wrong."""


def warn_unless_within(name: str, value: object, low: float, high: float, unit: str) -> None:
    """Warn where a value, or the farthest of several values, is outside a plausible range, unless it is traced."""
    if value is None or is_traced(value):
        return
    array = np.atleast_1d(np.asarray(value, float))
    outside = array[~((array >= low) & (array <= high))]
    if outside.size:
        farthest = outside[np.argmax(np.abs(outside))]
        warn(
            f"Argument `{name}` is {farthest:g} {unit}; plausible are {low:g} to {high:g} {unit}. Is the unit right?"
        )


def warn(text: str) -> None:
    """Give an `ImplausibleWarning` that points at the caller's line outside the package, once in a run (`TOLD`)."""
    told = TOLD.get()
    # texts that differ only in their numbers count as one, but not texts with files whose names have numbers
    kind = re.sub(r"(?<![\w./])-?\d[\d.]*(e[-+]?\d+)?(?![\w/])", "", text)
    if told is not None:
        if kind in told:
            return
        told.add(kind)
    depth = 2
    frame = sys._getframe(1)
    # past the frames of the package, and of libraries that call it, to the user's own line
    while frame.f_back is not None and re.match(r"(slipperjax|equinox|jax)\b", frame.f_globals.get("__name__", "")):
        depth += 1
        frame = frame.f_back
    warnings.warn(text, ImplausibleWarning, stacklevel=depth)


def known(name: str, value: Value) -> Value:
    """Return `value`; raises `ValueError` where it is traced: datasets, files and pictures need numbers."""
    need = "be of values that are known: call this outside of jax.jit, jax.grad and jax.vmap"
    require(not is_traced(value), name, need, shown="traced")
    return value


def whole(name: str, value: object, least: int, most: int = 2**128) -> int:
    """Return `value` as an `int` of at least `least` and at most `most`; raises `ValueError` otherwise.

    The default of `most` allows seeds of 128 bits.
    """
    ok = isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= least
    require(ok, name, f"be a whole number of {least} or more", value)
    require(int(value) <= most, name, f"be at most {most}", value)
    return int(value)


def one_of(name: str, value: object, choices: Collection[str]) -> str:
    """Return `value`, which must be one of `choices`; raises `ValueError` otherwise."""
    ok = isinstance(value, str) and value in choices
    require(ok, name, f"be one of {', '.join(choices)}", value, names=choices)
    return str(value)


def shown_number(value: object) -> str:
    """Return a number, or an array of up to six, as text with five digits; of a larger array its shape and range."""
    if isinstance(value, jax.core.Tracer):
        return f"<traced {value.dtype}{list(value.shape)}>"
    if not isinstance(value, jax.Array | np.ndarray | np.generic | float) or not is_real(value):
        return brief(value)
    array = np.asarray(value)
    if array.ndim == 0:
        return f"{array:.5g}"
    if array.size <= 6:
        return str([shown_number(part) for part in array]).replace("'", "")
    return f"<{' x '.join(map(str, array.shape))}, {array.min():.5g} to {array.max():.5g}>"
