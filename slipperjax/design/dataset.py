"""A design as one labelled dataset, with the scene of the optimum and the call as attributes."""

import math
from typing import Any

import numpy as np
import xarray as xr

from ..flow.datasets import run_attributes, scene_attributes
from ..model.dang2024 import table_2_start
from ..model.paths import parameter
from ..model.quantities import Quantity
from ..model.scene import Scene
from .problem import Problem


def labels(q: Quantity) -> dict[str, Any]:
    """Attributes of a variable of a dataset from which pictures label and scale it, whatever its name."""
    return {
        "units": q.unit,
        "long_name": q.long_name,
        "quantity": q.name,
        "symbol": q.symbol,
        "shown_unit": q.display_unit,
        "per_shown": q.per_shown,
    }


def merged(
    problem: Problem,
    scene: Scene,
    values: dict[str, float],
    tables: dict[str, xr.Dataset],
    summary: dict[str, Any],
) -> xr.Dataset:
    """Several tables as one dataset, each variable with its table's prefix.

    **Arguments:** `scene` and `values`: of the best design; `tables`: datasets by prefix, such as "trial" for
    trial_smooth, or "" for none; `summary`: further attributes.
    """
    renamed = [
        ds.rename({name: f"{prefix}_{name}" for name in ds.data_vars}) if prefix else ds
        for prefix, ds in tables.items()
    ]
    names, over = problem.names, tuple(problem.over)
    known = [parameter(name, problem.scene) for name in names]
    words = lambda text: {"long_name": f"{text}, in the unit of each variable"}
    own = xr.Dataset(
        {
            "design": ("variable", [values[name] for name in names], words("best design")),
            "low": ("variable", problem.low, words("lower bound")),
            "high": ("variable", problem.low + problem.width, words("upper bound")),
        },
        {"variable": list(names), "variable_unit": ("variable", [q.unit for q in known])},
    )
    ds = xr.merge([own, *renamed], join="exact", compat="equals")
    question = problem.question
    finite = lambda v: v if math.isfinite(v) else None
    call = {
        "function": "optimise_design",
        "objective": problem.objective.name,
        "variables": [[name, *bounds] for name, bounds in problem.bounds.items()],
        "over": [[name, values] for name, values in problem.over.items()],
        "robust": problem.robust,
        "constraints": [[c.objective.name, finite(c.low), finite(c.high)] for c in problem.constraints],
        "periodic": problem.periodic,
        "transient": question.transient,
        "steps_per_period": question.steps,
        "solver": question.solver,
        "spread": list(problem.spread),
    }
    start = table_2_start() if problem.start is None else problem.start
    attrs = scene_attributes(scene, without=(*over, *names)) | run_attributes(scene, start, call, over)
    numbers = {name: np.int8(v) if isinstance(v, bool) else v for name, v in summary.items()}
    return ds.assign_attrs(attrs | {"robust": problem.robust} | numbers)
