"""Every number of a scene as a named parameter: by its name in the registry, or by its path in the scene.

A path names fields, and places in arrays: slipper.inertia.1 is the moment of inertia about y, section.play.2 the play
of the third face, section.points.D.1 the height z of point D.
"""

import dataclasses
import itertools
import operator
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import ShapeChecked, axes_of, brief, finite, require, unit_of
from ..tools.compile import is_traced
from .quantities import PARAMETERS, Parameter, entry


def parameter(name: Any, scene: Any = None) -> Parameter:
    """Returns a scene's parameter by name or path.

    **Arguments:** `scene`: where a path leads; without it paths are unknown.

    **Raises:** `ValueError` for an unknown name, or a path that leads to no number.
    """
    require(scene is None or hasattr(scene, "__dataclass_fields__"), "scene", "be a slipperjax.Scene", scene)
    if isinstance(name, str) and name in PARAMETERS:
        return PARAMETERS[name]
    if isinstance(name, str) and "." in name and scene is not None:
        return _at_path(name, scene)
    shown = name if isinstance(name, str) and name in brief(name) else brief(name)  # without quotes where it can be
    raise ValueError(
        f"Argument `{shown}` is no parameter; the names are {', '.join(PARAMETERS)}, and paths such as "
        f"section.play.2 or slipper.inertia.1."
    )


def refuse_undone(parameters: Sequence[Parameter], scene: Any) -> None:
    """Raises `ValueError` where one of several parameters, which are set in their order, undoes what another sets.

    The clearance followed by section.play.2 is a section with another third face; the other way round
    section.play.2 would be without effect, as would one of mass and slipper.mass.
    """
    with jax.ensure_compile_time_eval():
        for first, later in itertools.combinations(parameters, 2):
            if is_traced(first.leaf(scene)) or is_traced(later.leaf(scene)):
                continue
            both = later.replaced(first.replaced(scene, np.nan), 0.0)
            if not np.any(np.isnan(first.of(both))):
                raise ValueError(
                    f"Argument `{first.name}` must not be given with `{later.name}`, which sets the same; "
                    f"what is a part of the other must come second."
                )


def checked_parameters(names: Any, scene: Any) -> list[Parameter]:
    """Returns parameters by which results can be differentiated together.

    **Raises:** `ValueError` where `names` is no list of parameters that the scene has and that do not undo each
    other.
    """
    listed = isinstance(names, Sequence) and not isinstance(names, str) and names
    require(listed, "names", "be a list of parameters", names)
    parameters = [parameter(name, scene) for name in names]
    for one in parameters:
        one.check_exists(scene)
        one.check_varies()
        if one.of(scene) is None:
            raise ValueError(f"Argument `names` must be of numbers that the scene has, but it has no {one.name}.")
    refuse_undone(parameters, scene)
    return parameters


def at_values(scene: Any, names: Sequence[str], values: Any) -> Any:
    """Returns the scene with other values of named parameters, unchecked."""
    for k, name in enumerate(names):
        scene = parameter(name, scene).replaced(scene, values[k])
    return scene


def values_of(scene: Any, names: tuple[str, ...]) -> Float[Array, " parameters"]:
    """Returns the values of named parameters [their SI units]."""
    return jnp.stack([jnp.asarray(parameter(name, scene).of(scene), float) for name in names])


def _at_path(path: str, scene: Any) -> Parameter:
    """Gives the parameter at a path: fields of modules, then indices into an array, the first by name for points."""
    words, part, owner, fields = path.split("."), scene, scene, []
    while words and dataclasses.is_dataclass(part):
        owner = part
        numbers = [f.name for f in dataclasses.fields(owner) if not f.metadata.get("static", False)]
        if words[0] not in numbers:
            has = f"{', '.join(numbers)}, but not" if numbers else "no numbers, and so not"
            raise ValueError(
                f"Argument `{path}` leads to no number: {type(owner).__name__} has {has} {brief(words[0])}."
            )
        fields.append(words.pop(0))
        part = getattr(owner, fields[-1])
    shape = np.shape(part) if part is not None else ()
    field = next(f for f in dataclasses.fields(owner) if f.name == fields[-1])
    rank = axes_of(field, len(shape))
    if dataclasses.is_dataclass(part) or len(words) != rank:
        leaf = f"an array of shape {shape}" if shape else type(part).__name__
        raise ValueError(f"Argument `{path}` leads to no number: {'.'.join(fields)} is {leaf}.")
    sizes = shape[len(shape) - rank :]  # without axes of cases
    index = [_place(path, word, size, owner) for word, size in zip(words, sizes, strict=True)]
    check = owner.check_of(field.name) if isinstance(owner, ShapeChecked) else None
    need = (
        finite
        if check is None
        else lambda name, unit: dataclasses.replace(check, name=name, unit=unit, optional=False)
    )
    place: dict[str, Any] = dict(where=operator.attrgetter(".".join(fields)), **(entry(*index) if index else {}))
    unit = unit_of(type(owner), field.name) or "1"
    return Parameter(path, unit, path.replace(".", " "), check=need, **place)


def _place(path: str, word: str, size: int, owner: Any) -> int:
    """Returns an index into an array, as a number or, for points of a section, as a name."""
    names = getattr(owner, "names", ())
    if word in names:
        return names.index(word)
    if word.isdecimal() and int(word) < size:
        return int(word)
    choices = f"a number of 0 to {size - 1}" + (f" or one of {', '.join(names)}" if len(names) == size else "")
    raise ValueError(f"Argument `{path}` must have {choices} in place of {word!r}.")
