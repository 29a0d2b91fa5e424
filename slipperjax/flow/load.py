"""Scenes, starts and calls from files: TOML of scenes, and netCDF of results."""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import diffrax
import lineax
import numpy as np
import optimistix

from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..model.scene_files import SceneFile, scene_from_json, scene_from_toml
from ..tools.checks import brief
from ..tools.description import build
from .datasets import open_result, start_from_json
from .record import AbstractRecord

SAME_VALUE = 1e-9
"""Relative difference up to which a value asked for is one of a dataset's."""


def load_scene(source: Any, **chosen: float) -> Scene:
    """Returns the scene of a TOML file, of a result's netCDF file, or of a dataset; exactly as it was.

    **Arguments:** `source`: a path or an `xarray.Dataset`. `chosen`: for a result of many cases, the values of what
    was varied, by name [SI units], unless the dataset is of one case already, as by `ds.isel(speed=3)`.

    **Raises:** `ValueError` where the source holds no scene, or several and none is chosen; `OSError` for a file that
    cannot be read.
    """
    if _is_toml(source):
        return _chosen_none(_read_toml(source), chosen).scene
    ds = dataset_of(source)
    scene, _ = load_base(ds)
    values = _varied(ds, chosen, lambda name: not _of_start(name))
    return scene.replace(**values) if values else scene


def load_start(source: Any, **chosen: float) -> Motion | State | None:
    """Returns the start of a TOML file, a netCDF file or a dataset; None where a TOML file has none.

    **Arguments:** and **Raises:** as for `load_scene`.
    """
    if _is_toml(source):
        return _chosen_none(_read_toml(source), chosen).start
    ds = dataset_of(source)
    _, start = load_base(ds)
    values = {name.removeprefix("start_"): v for name, v in _varied(ds, chosen, _of_start).items()}
    if isinstance(start, State):
        return State(Motion(**(vars(start.motion) | values)), start.memory)
    return Motion(**(vars(start) | values))


def load_base(source: Any) -> tuple[Scene, Motion | State]:
    """Gives the scene and the start of which a result's cases are variations; raises `ValueError` as `load_scene`."""
    ds = dataset_of(source)
    return scene_from_json(_attribute(ds, "scene")), start_from_json(_attribute(ds, "start"))


def load_call(source: Any) -> dict[str, Any]:
    """Returns the function that made a result, as `function`, and its arguments besides scene, grid and start.

    **Raises:** `ValueError` where a solver, controller or record cannot be rebuilt.
    """
    call = json.loads(_attribute(dataset_of(source), "call"))
    kinds = (
        diffrax.AbstractSolver,
        diffrax.AbstractStepSizeController,
        diffrax.AbstractAdjoint,
        optimistix.AbstractRootFinder,
        lineax.AbstractLinearSolver,
        Motion,
        AbstractRecord,
    )
    return {name: build(value, kinds, name) for name, value in call.items()}


def _is_toml(source: Any) -> bool:
    return isinstance(source, str | os.PathLike) and Path(source).suffix.lower() == ".toml"


def _read_toml(source: Any) -> SceneFile:
    try:
        text = Path(source).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileNotFoundError(f"No such file: {source}") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: must be UTF-8 text, but is not: {error}.") from None
    return scene_from_toml(text, str(source))


def _chosen_none(file: SceneFile, chosen: Mapping[str, Any]) -> SceneFile:
    if chosen:
        raise ValueError(f"Argument `{next(iter(chosen))}` must not be given for a TOML file, which has one scene.")
    return file


def dataset_of(source: Any) -> Any:
    """Returns a dataset as it is, or that of a file."""
    if isinstance(source, str | os.PathLike):
        return open_result(Path(source))
    if not hasattr(source, "attrs") or not hasattr(source, "coords"):
        raise ValueError(
            f"Argument `source` must be a TOML or netCDF file, or a dataset of slipperjax, but is {brief(source)}."
        )
    return source


def _attribute(ds: Any, name: str) -> str:
    if name not in ds.attrs:
        raise ValueError(
            f"Argument `source` must be a result of slipperjax, but has no attribute `{name}`. Single variables and "
            f"results of calculations have none."
        )
    return ds.attrs[name]


def varied_names(ds: Any) -> list[str]:
    """Returns names of the coordinates that were varied; raises `ValueError` where one of them is lost."""
    names = json.loads(_attribute(ds, "varied"))
    for name in names:
        if name not in ds.coords:
            raise ValueError(
                f"Argument `source` must have the coordinate `{name}`, which was varied; without it the scene is "
                f"unknown."
            )
    return names


def _of_start(name: str) -> bool:
    return name.startswith("start_")


def _varied(ds: Any, chosen: Mapping[str, float], wanted: Callable[[str], bool]) -> dict[str, float]:
    """Gives wanted values of what was varied, for one case: chosen, or the dataset's own if it is of one case."""
    names = varied_names(ds)
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ValueError(f"Argument `{unknown[0]}` must be one of what was varied, {', '.join(names) or 'nothing'}.")
    values = {name: np.asarray(ds.coords[name].values, float) for name in names}
    fits = {name: np.abs(values[name] - value) <= SAME_VALUE * abs(value) for name, value in chosen.items()}
    for name, hits in fits.items():
        if not np.any(hits):
            nearest = values[name].ravel()[np.argmin(np.abs(values[name].ravel() - chosen[name]))]
            raise ValueError(
                f"Argument `{name}` must be one of the result's, but is {chosen[name]:g}; nearest is {nearest:.10g}."
            )
    listed = [name for name in names if ds.coords[name].dims == ("case",)]  # lists that were read side by side
    if listed:
        keep = np.logical_and.reduce([fits[name] for name in listed if name in fits] or [np.ones(1, bool)])
        values |= {name: values[name][np.broadcast_to(keep, values[name].shape)] for name in listed}
    values |= {name: values[name][hits] for name, hits in fits.items() if name not in listed and values[name].ndim}
    values = {name: v for name, v in values.items() if wanted(name)}
    several = [name for name, v in values.items() if v.size != 1]
    if several:
        raise ValueError(
            f"Argument `{several[0]}` must be given, as the result has {values[several[0]].size} values of it; or "
            f"select a case, as by ds.isel({several[0]}=0)."
        )
    return {name: float(v.ravel()[0]) for name, v in values.items()}
