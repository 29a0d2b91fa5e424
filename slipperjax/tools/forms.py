"""Tricks for speed, each in a fast form that uses internals of JAX, and in a plain form that uses public JAX only.

All tricks have the plain form where the environment variable `SLIPPERJAX_PLAIN` is 1; where a self-test at the first
use finds that this version of JAX breaks a fast form; and after JAX could not compile a program in the fast form.
Therefore a new version of JAX may make the package slower, but cannot break it or make its results wrong.
"""

import os
import threading
import warnings
from collections.abc import Callable
from types import ModuleType

import jax
from jaxtyping import PyTree

from . import plain


class PlainWarning(UserWarning):
    """The package computes in its plain form, which is slower."""


class _Choice:
    """The form that this process uses; None until it is chosen."""

    form: ModuleType | None = None
    lock = threading.RLock()


def compiler_options(backend: str | None = None) -> dict[str, bool]:
    """Return XLA's options for a backend, by default the backend in use; only the fast form has some, for CPUs."""
    return _form().compiler_options(backend)


def in_one_kernel(fun: Callable, *args: PyTree) -> PyTree:
    """Call `fun(*args)`; in the fast form as one kernel of the compiled program, see `one_kernel`.

    **Arguments:** `fun`: function of pytrees that returns a pytree of arrays.
    """
    return _form().in_one_kernel(fun, *args)


def sums(*operands):
    """Return the sum of each operand over its last axis, in the fast form in one pass; operands have one shape.

    **Arguments:** arrays of shape `(*batch, n)` and of one floating-point type.

    **Returns:** a list with one array of shape `batch` per operand.
    """
    return _form().sums(*operands)


def spread(n: int, *scalars):
    """Repeat each value along a new last axis of length n, which is the transpose of `sums`.

    **Returns:** a list with one array of shape `(*batch, n)` per value, where `batch` is the shape to which all of
    them broadcast.
    """
    return _form().spread(n, *scalars)


def store(tree):
    """Return the same values; in the fast form each is computed once and stored, see `fused`.

    **Arguments:** a pytree of floating-point arrays.
    """
    return _form().store(tree)


def store_cotangent(tree):
    """Return the same values; in the fast form reverse mode stores their cotangents."""
    return _form().store_cotangent(tree)


def store_if_differentiated(tree):
    """Return the same values; where they are differentiated, they are stored as `store` does."""
    return _form().store_if_differentiated(tree)


def circle(angle):
    """Return cosine and sine of an angle [rad]; derivatives of all orders use both values in the fast form."""
    return _form().circle(angle)


def is_plain() -> bool:
    """Return whether the tricks have their plain form; the first call may run the self-test."""
    return _form() is plain


def fall_back(error: Exception) -> bool:
    """Use the plain form from this call on, and return whether this is new.

    **Arguments:** `error`: JAX's error, that it has no code for a program.
    """
    with _Choice.lock:
        if is_plain():
            return False
        _use_plain(f"JAX {jax.__version__} cannot compile a program: {_first_line(error)}")
        # programs that were kept have the fast form
        jax.clear_caches()
        return True


def _form() -> ModuleType:
    """Return the module of the form in use."""
    # other threads wait until the self-test has ended
    with _Choice.lock:
        if _Choice.form is None:
            _choose()
        assert _Choice.form is not None
        return _Choice.form


def _choose() -> None:
    """Choose the form by the environment, or by the self-test."""
    wanted = os.environ.get("SLIPPERJAX_PLAIN", "")
    if wanted not in ("", "0", "1"):
        raise ValueError(f"Environment variable SLIPPERJAX_PLAIN must be 0 or 1, but is {wanted!r}.")
    if wanted == "1":
        return _use_plain("SLIPPERJAX_PLAIN is 1")
    try:
        from . import fast, self_test  # here, because the import must not fail where JAX no longer has a name

        fault = self_test.fault()
    except Exception as error:
        fault = _first_line(error)
    if fault:
        return _use_plain(f"the self-test of the fast form fails with JAX {jax.__version__}: {fault}")
    _Choice.form = fast


def _use_plain(reason: str) -> None:
    """Take the plain form, with a warning."""
    _Choice.form = plain
    text = f"slipperjax computes in its plain form, up to five times slower (docs/lab/speed.md), because {reason}."
    warnings.warn(text, PlainWarning, stacklevel=2)


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".partition("\n")[0]
