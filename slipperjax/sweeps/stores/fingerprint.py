"""What was asked of a store, as plain data: the same call finds it again, another one is told the difference."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...flow.datasets import versions
from ...flow.simulate import first_of
from ...model.scene_files import scene_to_json
from ...tools.description import describe
from ..grid import Grid
from .target import Tiling

UNSEEN = ("progress", "workers", "chunk")
"""Arguments that change no result."""
LONG = 60
"""Length from which a value is cut in a message."""


def fingerprint(function: Any, grid: Grid, options: Mapping[str, Any], tiles: Tiling) -> dict[str, Any]:
    """What determines every number of a store, as JSON holds it."""
    asked = {name: value for name, value in options.items() if name not in (*UNSEEN, "start", "product")}
    if "start" in options:
        asked["start"] = first_of(options["start"])
    return {
        "function": function.__name__,
        "scene": json.loads(scene_to_json(grid.scene)),
        "grid": {name: _summary(values) for name, values in grid.axes.items()},
        "product": grid.product,
        "tile": list(tiles.tile),
        "arguments": {name: plain(value) for name, value in asked.items()},
        "versions": {name: version for name, version in versions().items() if name != "python"},
    }


def _summary(values: np.ndarray) -> dict[str, Any]:
    """An axis in few numbers that tell it from others."""
    ends = {"values": len(values), "first": float(values[0]), "last": float(values[-1])}
    return ends | {"sha256": hashlib.sha256(np.ascontiguousarray(values, float).tobytes()).hexdigest()[:16]}


def plain(value: Any) -> Any:
    """A value as JSON holds it; a function by its name and a digest of its code."""
    if isinstance(value, np.ndarray) and value.size > LONG:
        return _summary(value.ravel())
    return json.loads(json.dumps(describe(value)))


def differences(found: Any, asked: Any, path: str = "") -> list[str]:
    """Where two fingerprints differ, a line each: "scene.contact.restitution: 0.9 in the store, 0.8 asked"."""
    if isinstance(found, dict) and isinstance(asked, dict):
        lines = []
        for name in dict.fromkeys([*found, *asked]):
            below = f"{path}.{name}" if path else str(name)
            lines += differences(found.get(name, "nothing"), asked.get(name, "nothing"), below)
        return lines
    # NaN is a value of its own here, as in JSON's text
    if json.dumps(found) == json.dumps(asked):
        return []
    return [f"{path}: {_short(found)} in the store, {_short(asked)} asked"]


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= LONG else f"{text[: LONG - 3]}..."
