"""Scenes written as TOML text; `slipperjax.model.scene_files` reads them."""

import json
from typing import Any

from ..tools.checks import brief, require, unit_of
from ..tools.description import TYPE, describe
from .quantities import COORDINATES

NUMBERS = ("speed", "gravity")
"""Numbers of the scene itself."""
TABLES = ("slipper", "section", "track", "contact", "memory")
"""Parts of a scene, a table each."""
START_UNITS: dict[str, str] = {name: q.unit for name, q in COORDINATES.items()} | dict.fromkeys(
    ("q_x", "q_y", "q_z"), ""
)
"""Units of the coordinates at the start; the attitude's quaternion has none."""


def scene_to_toml(scene: Any, start: Any = None) -> str:
    """Returns a scene, and a motion at the start if given, as TOML text in SI units, exact to the last bit.

    **Raises:** `ValueError` for a part that has parts of its own, or holds what is no plain value.
    """
    description = describe(scene)
    lines = [
        _line(name, _shown(description[name], unit_of(type(scene), name)))
        for name in NUMBERS
        if description[name] is not None
    ]
    for name in TABLES:
        part, table = getattr(scene, name), description[name]
        lines += ["", f"[{name}]"]
        for field, value in table.items():
            if value is not None and not (field == TYPE and value.lower() == name):
                lines.append(_line(field, value if field == TYPE else _shown(value, unit_of(type(part), field))))
    if start is not None:
        if type(start).__name__ != "Motion":  # whose module needs this one
            need = "a slipperjax.Motion in TOML, such as run.end.motion"
            raise ValueError(f"Argument `start` must be {need}, but is {brief(start)}.")
        lines += ["", "[start]"]
        lines += [_line(k, _shown(v, START_UNITS[k])) for k, v in describe(start).items() if k != TYPE and v != 0]
    return "\n".join(lines) + "\n"


def _line(name: str, value: Any) -> str:
    return f"{name} = {value if isinstance(value, _Written) else _written(value)}"


class _Written(str):
    """TOML text of a value."""


def _written(value: Any) -> str:
    """Returns a value as TOML; JSON writes texts, numbers, booleans and lists alike."""
    require(not isinstance(value, dict), "scene", "have no parts within parts in TOML", value)
    return json.dumps(value)


def _shown(value: Any, unit: str) -> Any:
    """Returns a value with its unit: a text for a number, an inline table for an array."""
    if not unit:
        return value
    if isinstance(value, list):
        return _Written(f"{{ unit = {json.dumps(unit)}, values = {json.dumps(value)} }}")
    return f"{value!r} {unit}"
