"""Scenes, starts and calls from files: TOML of scenes, and netCDF of results."""

import json
import os
from collections.abc import Mapping
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
    file = _scene_file(source, chosen)
    if file is not None:
        return file.scene
    ds = dataset_of(source)
    scene, _ = load_base(ds)
    values = _varied(ds, chosen, of_start=False)
    return scene.replace(**values) if values else scene


def load_start(source: Any, **chosen: float) -> Motion | State | None:
    """Returns the start of a TOML file, a netCDF file or a dataset; None where a TOML file has none.

    **Arguments:** and **Raises:** as for `load_scene`.
    """
    file = _scene_file(source, chosen)
    if file is not None:
        return file.start
    ds = dataset_of(source)
    _, start = load_base(ds)
    values = {name.removeprefix("start_"): v for name, v in _varied(ds, chosen, of_start=True).items()}
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
    of_diffrax = diffrax.AbstractSolver, diffrax.AbstractStepSizeController, diffrax.AbstractAdjoint
    kinds = (*of_diffrax, optimistix.AbstractRootFinder, lineax.AbstractLinearSolver, Motion, AbstractRecord)
    return {name: build(value, kinds, name) for name, value in call.items()}


def _scene_file(source: Any, chosen: Mapping[str, Any]) -> SceneFile | None:
    """Returns what a TOML file holds; None for another source."""
    if not isinstance(source, str | os.PathLike) or Path(source).suffix.lower() != ".toml":
        return None
    try:
        text = Path(source).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileNotFoundError(f"No such file: {source}") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: must be UTF-8 text, but is not: {error}.") from None
    file = scene_from_toml(text, str(source))
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


def _varied(ds: Any, chosen: Mapping[str, float], of_start: bool) -> dict[str, float]:
    """Gives the values of one case of what was varied of the start, or of the scene: chosen, or the dataset's own if
    it is of one case."""
    names = varied_names(ds)
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ValueError(f"Argument `{unknown[0]}` must be one of what was varied, {', '.join(names) or 'nothing'}.")
    cases = ds.coords.to_dataset()[names]
    for name, value in chosen.items():
        values = np.asarray(cases[name].values, float)
        hits = np.abs(values - value) <= SAME_VALUE * abs(value)
        if not np.any(hits):
            nearest = values.ravel()[np.argmin(np.abs(values.ravel() - value))]
            raise ValueError(
                f"Argument `{name}` must be one of the result's, but is {value:g}; nearest is {nearest:.10g}."
            )
        # of several names along one dimension, such as lists that were read side by side, the other ones, too
        cases = cases.isel({dim: np.flatnonzero(hits) for dim in cases[name].dims})
    columns = {name: cases[name].values.ravel() for name in names if name.startswith("start_") == of_start}
    for name, values in columns.items():
        if values.size != 1:
            raise ValueError(
                f"Argument `{name}` must be given, as the result has {values.size} values of it; or select a case, "
                f"as by ds.isel({name}=0)."
            )
    return {name: float(values[0]) for name, values in columns.items()}
