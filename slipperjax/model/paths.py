"""Every number of a scene as a named parameter: by its name in the registry, or by its path in the scene.

A path names fields, and places in arrays: slipper.inertia.1 is the moment of inertia about y, section.play.2 the play
of the third face, section.points.D.1 the height z of point D.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from ..tools.checks import axes_of, brief, finite, unit_of
from ..tools.compile import is_traced
from .quantities import PARAMETERS, Parameter, with_entry


def parameter(name: Any, scene: Any = None) -> Parameter:
    """Returns a scene's parameter by name or path.

    **Arguments:** `scene`: where a path leads; without it paths are unknown.

    **Raises:** `ValueError` for an unknown name, or a path that leads to no number.
    """
    if isinstance(name, str) and name in PARAMETERS:
        return PARAMETERS[name]
    if isinstance(name, str) and "." in name and scene is not None:
        return _at_path(name, scene)
    raise ValueError(
        f"Argument `{name}` is no parameter; the names are {', '.join(PARAMETERS)}, and paths such as "
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


def _at_path(path: str, scene: Any) -> Parameter:
    """Gives the parameter at a path: fields of modules, then indices into an array, the first by name for points."""
    words, part, fields = path.split("."), scene, []
    owner, field = None, ""
    while words and hasattr(type(part), "__dataclass_fields__"):
        owner, field = part, words.pop(0)
        numbers = [name for name, f in part.__dataclass_fields__.items() if not f.metadata.get("static", False)]
        if field not in numbers:
            raise ValueError(
                f"Argument `{path}` leads to no number: {type(part).__name__} has {', '.join(numbers)}, "
                f"but not {brief(field)}."
            )
        fields.append(field)
        part = getattr(part, field)
    shape = np.shape(part) if part is not None else ()
    rank = axes_of(type(owner), field, len(shape)) if owner is not None else -1
    if hasattr(type(part), "__dataclass_fields__") or len(words) != rank:
        raise ValueError(
            f"Argument `{path}` leads to no number: {'.'.join(fields)} is "
            f"{type(part).__name__ if part is None or not shape else f'an array of shape {shape}'}."
        )
    shape = shape[len(shape) - rank :]  # without axes of cases
    index = tuple(_place(path, word, size, owner) for word, size in zip(words, shape, strict=True))
    unit = unit_of(type(owner), field)
    check = {f.name: f for f in type(owner).__dataclass_fields__.values()}[field].metadata.get("converter")
    need = finite if check is None else lambda name, unit: replace(check, name=name, unit=unit, optional=False)

    def where(scene: Any) -> Any:
        for name in fields:
            scene = getattr(scene, name)
        return scene

    more = (
        dict(read=lambda leaf: leaf[(..., *index)], write=lambda value, leaf: with_entry(leaf, value, index))
        if index
        else {}
    )
    return Parameter(path, unit or "1", path.replace(".", " "), where=where, check=need, **more)


def _place(path: str, word: str, size: int, owner: Any) -> int:
    """Returns an index into an array, as a number or, for points of a section, as a name."""
    names = getattr(owner, "names", ())
    if word in names:
        return names.index(word)
    if word.isdecimal() and int(word) < size:
        return int(word)
    choices = f"a number of 0 to {size - 1}" + (f" or one of {', '.join(names)}" if len(names) == size else "")
    raise ValueError(f"Argument `{path}` must have {choices} in place of {word!r}.")
