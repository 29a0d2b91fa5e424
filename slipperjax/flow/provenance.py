"""What a result was made of: the whole scene, its start, the call and the versions, as attributes of a dataset."""

import functools
import importlib.metadata
import json
import platform
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from ..model import (
    Motion,
    Scene,
    State,
    scene_to_json,
)
from ..tools import build, describe


@functools.cache
def versions() -> dict[str, str]:
    """Versions of slipperjax, of the packages it computes with, and of Python."""
    found = {"python": platform.python_version()}
    for name in ("slipperjax", "jax", "jaxlib", "diffrax", "equinox", "numpy"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def run_attributes(scene: Scene, start: Motion | State, call: Mapping[str, Any], varied: Any = ()) -> dict[str, str]:
    """Attributes, JSON each, from which `load_scene`, `load_start` and `load_call` read.

    **Arguments:** `call`: the function's name as `function`, and its arguments; `varied`: names of the coordinates
    that hold what differs between cases.
    """
    return {
        "scene": scene_to_json(scene),
        "start": json.dumps(describe(start)),
        "varied": json.dumps(list(varied)),
        "call": json.dumps({name: describe(value) for name, value in call.items()}),
        "versions": json.dumps(versions()),
    }


def start_from_json(text: str) -> Motion | State:
    """The start of an attribute of `run_attributes`."""
    description = json.loads(text)
    if "motion" not in description:
        return build(description, (Motion,), "start")
    memory = description["memory"]
    motion = build(description["motion"], (Motion,), "start")
    return State(motion, None if memory is None else jnp.asarray(memory))
