"""Every number of a scene as a named parameter: by its name in the registry, or by its path in the scene.

A path names fields, and places in arrays. slipper.inertia.1 is the moment of inertia about y, section.play.2 the play
of the third face, section.points.D.1 the height z of point D, slipper.mounts.left1.x the place of a sled's slipper.
The field declares unit, check and plausible range, see `slipperjax.tools.fields`.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ..tools.checks import Check, brief, finite, hint, instance, not_negative, positive, require
from ..tools.compile import as_argument
from ..tools.fields import ShapeChecked, axes_of, declared_check, labels_of
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from .contact import Flores
from .quantities import ACCELERATIONS, COORDINATES, LOADS, REACTIONS, SLIPPER_LOADS, Quantity
from .slipper import Slipper
from .tracks import HarmonicTrack, on_host

# a Scene, whose module imports this one
AnyScene = TypeVar("AnyScene", bound=eqx.Module)


DIRECTIONS = ("lateral", "vertical")
"""Names of directions across the rail: of play, and in which rails bend."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parameter(Quantity):
    """A number that is one leaf of a scene."""

    path: str
    """Fields that lead to the leaf, joined by points; empty for a number of the start."""
    check: Check
    """Converter of values [unit] to an array: raises `ValueError` out of range, warns of implausible values."""
    index: tuple[int, ...] = ()
    """Place in the leaf where the leaf is an array, after axes of cases."""

    @property
    def whole(self) -> bool:
        return self.check.whole

    @property
    def attributes(self):
        # pictures of a result know a path's unit from these alone
        return super().attributes | ({"shown_unit": self.shown_unit} if self.shown_unit else {})

    def leaf(self, scene: eqx.Module) -> Array | None:
        """Return the leaf in a scene; None where the scene has no such part, or where the part is None."""
        try:
            return self._where(scene)
        except AttributeError:
            return None

    def of(self, scene: eqx.Module) -> Real | np.ndarray | None:
        """Return the value in a scene [unit]; None where the scene has no such part, or where the part is None."""
        leaf = self.leaf(scene)
        return None if leaf is None else self._read(leaf)

    def stated(self, scene: eqx.Module) -> Real | np.ndarray | None:
        """Return the value in a scene as `of`, but NaN for a mean of several different numbers."""
        return self.of(scene)

    def check_exists(self, scene: eqx.Module) -> None:
        """Raise `ValueError` where a scene has no such part; a part that is None can be set."""
        try:
            self._where(scene)
        except AttributeError:
            raise ValueError(f"Argument `{self.name}` cannot be set: the scene has no {self.long_name}.") from None

    def check_varies(self) -> None:
        """Raise `ValueError` where values are whole numbers, for which there are no derivatives."""
        if self.whole:
            raise ValueError(f"Argument `{self.name}` cannot be varied by little: it is a whole number, of no slope.")

    def replaced(self, scene: AnyScene, value: ArrayLike) -> AnyScene:
        """Return a copy of `scene` with another, unchecked value; `value` may have leading axes of cases.

        **Raises:** `ValueError` where the scene has no such part.
        """
        self.check_exists(scene)
        leaf = self._write(as_argument(value), self._where(scene))
        # None counts as a leaf, so that a part that is None can be set
        return eqx.tree_at(self._where, scene, leaf, is_leaf=lambda part: part is None)

    def _where(self, scene: eqx.Module) -> Any:
        if not self.path:
            return None
        leaf: Any = scene
        for word in self.path.split("."):
            # parts may be in a list, such as loads
            leaf = leaf[int(word)] if isinstance(leaf, tuple) else getattr(leaf, word)
        if isinstance(leaf, eqx.Module):  # a part that replaces a number, such as a programme of speeds
            raise AttributeError(self.path)
        return leaf

    def _read(self, leaf: Array) -> Real | np.ndarray:
        return on_host(leaf)[(..., *self.index)] if self.index else leaf

    def _write(self, value: Array, leaf: Array) -> Array:
        if not self.index:
            return value
        shape = np.shape(leaf)
        of_cases = len(shape) - len(self.index)
        cases = jnp.broadcast_shapes(np.shape(value), shape[:of_cases])
        # cases of the value and of the array become common leading axes
        every = jnp.broadcast_to(leaf, (*cases, *shape[of_cases:]))
        return every.at[(..., *self.index)].set(value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Clearance(Parameter):
    """The total play, half of it at each face; where faces differ, twice the mean play of the faces."""

    direction: int | None = None
    """0 for the lateral axis, 1 for the vertical axis, None for both."""

    def stated(self, scene):
        leaf = self.leaf(scene)
        return None if leaf is None else _twice_the_play(leaf, np.ones(leaf.shape[-1:], bool))

    def check_exists(self, scene):
        super().check_exists(scene)
        mounts = getattr(getattr(scene, "slipper", None), "mounts", ())
        own = bool(mounts) and all(mount.play is not None for mount in mounts)
        need = "be set where slippers use the play of the section"
        require(not own, self.name, need, shown="given for mounts that have their own play")

    def _read(self, leaf: Array) -> Real | np.ndarray:
        # over all faces, each of which has half of the clearance
        return 2 * on_host(leaf).mean()

    def _write(self, value: Array, leaf: Array) -> Array:
        return half_play(value, leaf.shape[-1])


class PlayAlong(Clearance):
    """The total play along one axis, half of it at each face whose normal is nearest to this axis."""

    @property
    def words(self) -> str:
        assert self.direction is not None
        return f"{DIRECTIONS[self.direction]} play"

    def of(self, scene):
        """Return twice the mean play of these faces [m]; NaN without such faces."""
        leaf = self.leaf(scene)
        if leaf is None:
            return None
        mine = self._faces(scene)
        with np.errstate(invalid="ignore"):
            total = (on_host(leaf) * mine).sum(axis=-1)
            return 2 * total / mine.sum(axis=-1)

    def stated(self, scene):
        leaf = self.leaf(scene)
        return None if leaf is None else _twice_the_play(leaf, self._faces(scene))

    def replaced(self, scene, value):
        self.check_exists(scene)
        half = as_argument(value)[..., None] / 2
        leaf = jnp.where(self._faces(scene), half, self._where(scene))
        return eqx.tree_at(self._where, scene, leaf)

    def _faces(self, scene: eqx.Module) -> Bool[Array | np.ndarray, "*cases faces"]:
        """Return whether a face is of this direction."""
        return on_host(scene.section.directions == self.direction)  # pyright: ignore[reportAttributeAccessIssue]


def _twice_the_play(play: Array, faces: Array | np.ndarray) -> np.ndarray | None:
    """Return twice the play of some faces [m]; NaN where they differ or there are none, None where it is traced."""
    if is_traced(play) or is_traced(faces):
        return None
    least = np.min(np.where(faces, np.asarray(play), np.inf), axis=-1)
    most = np.max(np.where(faces, np.asarray(play), -np.inf), axis=-1)
    return np.where(least == most, 2 * least, np.nan)


def half_play(clearance: Array | np.ndarray, faces: int) -> Float[Array, "*cases faces"]:
    """Return a total play of `clearance` [m], shape (*cases,), as the play of each face [m]."""
    return jnp.asarray((on_host(clearance)[..., None] / 2).repeat(faces, axis=-1))


def _declared(
    path: str, owner: type, check: Check | None = None, *, name: str = "", index: tuple[int, ...] = ()
) -> Parameter:
    """Return the parameter that a field of a module declares.

    **Arguments:** `path`: fields that lead to the field; `owner`: the module's class; `check`: None for the check
    that the field declares, if any; `name`: of the parameter, by default that of the field; `index`: place in the
    field's array.
    """
    field = path.rpartition(".")[2]
    name = name or field
    # None is not a value to vary, also where the field allows it
    own = dataclasses.replace(check or declared_check(owner, field) or finite(""), name=name, optional=False)
    labels = labels_of(owner, field)
    text = labels.pop("text") or (name if "." in name else path).replace(".", " ")
    return Parameter(name, own.unit or "1", text, path=path, check=own, index=index, **labels)


def _moment_of_inertia(k: int, axis: str) -> Parameter:
    moment = _declared("slipper.inertia", Slipper, name=f"inertia_{axis}", index=(k,))
    return dataclasses.replace(moment, long_name=f"moment of inertia about {axis}", symbol=f"J_{axis}")


PARAMETERS: dict[str, Parameter] = {
    p.name: p
    for p in (
        Parameter(
            "speed",
            "m/s",
            "constant travelling speed",
            "V",
            path="speed",
            check=positive("speed", "m/s", plausible=(5.0, 1e4)),
        ),
        Clearance(
            "clearance",
            "m",
            "total play of slipper and rail",
            "C",
            shown_unit="mm",
            path="section.play",
            check=not_negative("clearance", "m", plausible=(0.0, 0.04)),
        ),
        *(
            PlayAlong(
                f"play.{name}",
                "m",
                f"total {name} play of slipper and rail",
                shown_unit="mm",
                path="section.play",
                check=not_negative(f"play.{name}", "m", plausible=(0.0, 0.04)),
                direction=direction,
            )
            for direction, name in enumerate(DIRECTIONS)
        ),
        _declared("slipper.length", Slipper),
        _declared("slipper.mass", Slipper),
        *(_moment_of_inertia(k, axis) for k, axis in enumerate("xyz")),
        # labels are those of the paper's kinds of contact and track; other kinds may have the same names
        _declared("contact.stiffness", Flores),
        _declared("contact.restitution", Flores),
        _declared("track.amplitude", HarmonicTrack),
        _declared("track.roll_amplitude", HarmonicTrack),
        Parameter(
            "gravity",
            "m/s^2",
            "gravitational acceleration",
            "g",
            path="gravity",
            check=not_negative("gravity", "m/s^2", plausible=(0.0, 1e3)),
        ),
    )
}
"""The parameters of a scene by name, for `Scene.replace` and `sweep`."""
MAIN = ("speed", "clearance", "play.vertical", "play.lateral", "length")
"""Parameters that titles and texts on a case state; plays only where there is no common clearance."""


def _at_start(q: Quantity) -> Parameter:
    # greatest plausible magnitudes
    far = {"m": 0.02, "m/s": 100.0, "rad/s": 1e3}[q.unit]
    text = f"{q.long_name.split(',')[0]} at the start"
    name = START + q.name
    check = finite(name, q.unit, plausible=(-far, far))
    return Parameter(name, q.unit, text, q.symbol, q.scale, q.shown_unit, path="", check=check)


START = "start_"
"""Prefix of a start's coordinates in grids and datasets, where `y` is the displacement itself."""
STARTS: dict[str, Parameter] = {
    START + name: _at_start(q) for name, q in COORDINATES.items() if name not in ("roll", "pitch", "yaw")
}
"""The coordinates of the start that a grid may vary in addition to `PARAMETERS`, for basins of attraction."""


def of_motion(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of `values` that are coordinates of the start, by their names in a `Motion`."""
    return {name.removeprefix(START): value for name, value in values.items() if name in STARTS}


QUANTITIES: dict[str, Quantity] = {
    **PARAMETERS,
    **STARTS,
    **COORDINATES,
    **ACCELERATIONS,
    **REACTIONS,
    **LOADS,
    **SLIPPER_LOADS,
}
"""Quantities by their names in datasets."""


def quantity(name: str) -> Quantity:
    """Return a quantity by its name in datasets.

    **Raises:** `KeyError` for an unknown name, `ValueError` for a value that is no name.
    """
    instance("name", name, str, "the name of a quantity")
    return QUANTITIES[name]


def check_units(ds: Any, argument: str) -> None:
    """Raise `ValueError` where variables of a result, an `xarray.Dataset`, do not have SI units."""
    for name, variable in ds.variables.items():
        known = QUANTITIES.get(str(name))
        if known is not None:
            given = variable.attrs.get("units", known.unit)
            need = f"have {name} in {known.unit}, as slipperjax makes it"
            require(given == known.unit, argument, need, shown=f"it in {given}")


def parameter(name: object, scene: eqx.Module | None = None) -> Parameter:
    """Return a scene's parameter by name or path.

    **Arguments:** `scene`: the scene in which a path leads to a number; without it paths are unknown.

    **Raises:** `ValueError` for an unknown name, or a path that leads to no number.
    """
    require(scene is None or dataclasses.is_dataclass(scene), "scene", "be a slipperjax.Scene", scene)
    if isinstance(name, str) and name in PARAMETERS:
        return PARAMETERS[name]
    if isinstance(name, str) and "." in name and scene is not None:
        return _at_path(name, scene)
    shown = name if isinstance(name, str) and name in brief(name) else brief(name)  # without quotes where possible
    meant = START + shown if START + shown in STARTS else name
    raise ValueError(
        f"Argument `{shown}` is no parameter; the names are {', '.join(PARAMETERS)}, and paths such as "
        f"section.play.2 or slipper.inertia.1.{hint(meant, [*PARAMETERS, *STARTS])}"
    )


def _at_path(path: str, scene: eqx.Module) -> Parameter:
    """Return the parameter at a path: fields of modules, then indices into an array, for points also names."""
    words = path.split(".")
    owner = scene
    part: Any = scene
    fields = []
    # down the modules; the rest of the path is a place in an array
    while words and (dataclasses.is_dataclass(part) or isinstance(part, tuple)):
        if isinstance(part, tuple):
            fields.append(str(_place(path, words.pop(0), len(part), owner)))
            part = part[int(fields[-1])]
            continue
        owner = part
        numbers = [f.name for f in dataclasses.fields(owner) if not f.metadata.get("static", False)]
        if words[0] not in numbers:
            has = f"{', '.join(numbers)}, but not" if numbers else "no numbers, and so not"
            raise ValueError(
                f"Argument `{path}` leads to no number: {type(owner).__name__} has {has} {brief(words[0])}."
                f"{hint(words[0], numbers)}"
            )
        fields.append(words.pop(0))
        part = getattr(owner, fields[-1])
    shape = () if part is None else np.shape(part)
    rank = axes_of(type(owner), fields[-1], len(shape))
    if dataclasses.is_dataclass(part) or len(words) != rank or (part is None and words):
        leaf = "absent from the scene" if part is None else type(part).__name__
        if shape and not isinstance(part, tuple):
            leaf = f"an array of shape {shape}"
        raise ValueError(f"Argument `{path}` leads to no number: {'.'.join(fields)} is {leaf}.")
    sizes = shape[len(shape) - rank :]  # without axes of cases
    index = tuple(_place(path, word, size, owner) for word, size in zip(words, sizes, strict=True))
    # the module gives the check, because its other values may bound this value
    check = owner.check_of(fields[-1]) if isinstance(owner, ShapeChecked) else None
    return _declared(".".join(fields), type(owner), check, name=path, index=index)


def _place(path: str, word: str, size: int, owner: eqx.Module) -> int:
    """Return an index into an array or a tuple, from a number or, for points of a section and mounts, from a name."""
    names = getattr(owner, "names", ())
    # points of a section and mounts of a sled have names
    names = names if len(names) == size else ()
    # a number is a place, even where a number is the name of a mount
    if word.isdecimal() and int(word) < size:
        return int(word)
    if word in names:
        return names.index(word)
    choices = f"a number of 0 to {size - 1}" + (f" or one of {', '.join(names)}" if names else "")
    raise ValueError(f"Argument `{path}` must have {choices} in place of {word!r}.")


def check_no_overlap(parameters: Sequence[Parameter], scene: eqx.Module) -> None:
    """Raise `ValueError` where one of several parameters, set in their order, undoes another.

    The clearance followed by section.play.2 gives a section with another third face. In the other order
    section.play.2 would have no effect; so would the first of mass and slipper.mass.
    """
    with jax.ensure_compile_time_eval():
        for first, later in itertools.combinations(parameters, 2):
            if is_traced(first.leaf(scene)) or is_traced(later.leaf(scene)):
                continue
            # the NaN of the first parameter is lost where the later one overwrites it
            both = later.replaced(first.replaced(scene, np.nan), 0.0)
            if not np.any(np.isnan(np.asarray(first.of(both)))):
                raise ValueError(
                    f"Argument `{first.name}` must not be given with `{later.name}`, which sets the same; "
                    f"what is a part of the other must come second."
                )


def checked_parameters(names: Sequence[str], scene: eqx.Module) -> list[Parameter]:
    """Return parameters with respect to which results can be differentiated together.

    **Raises:** `ValueError` unless `names` is a list of parameters that the scene has and that do not undo each
    other.
    """
    # a single name would be read letter by letter
    listed = isinstance(names, Sequence) and not isinstance(names, str) and names
    require(listed, "names", "be a list of parameters", names)
    parameters = [parameter(name, scene) for name in names]
    for one in parameters:
        one.check_exists(scene)
        one.check_varies()
        if one.of(scene) is None:
            raise ValueError(f"Argument `names` must be of numbers that the scene has, but it has no {one.name}.")
    check_no_overlap(parameters, scene)
    return parameters


def at_values(scene: AnyScene, names: Sequence[str], values: Numbers) -> AnyScene:
    """Return the scene with other values of named parameters, unchecked."""
    for k, name in enumerate(names):
        # in their order, so that a part may follow the whole array
        scene = parameter(name, scene).replaced(scene, values[k])
    return scene


def values_of(scene: eqx.Module, names: tuple[str, ...]) -> Float[Array, " parameters"]:
    """Return the values of named parameters, in their SI units."""
    values = [jnp.asarray(parameter(name, scene).of(scene), float) for name in names]
    return jnp.stack(values) if values else jnp.zeros(0)
