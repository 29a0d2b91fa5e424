"""A parameter followed with memory: each case from the state in which its neighbour ended."""

from collections.abc import Mapping
from typing import Any

import diffrax
import numpy as np
import xarray as xr

from ..flow import check_start, initial_states
from ..model import Motion, Scene, table_2_start
from ..tools import one_of
from .cases import filled, path_cases
from .executors import in_order, progress_bar, records_in_order, run_chunk
from .plan import Chunk, make_plan
from .sweep import CaseRuns, sweep_dataset

DIRECTIONS = {"up": 1, "down": -1}
"""Ways through a parameter's values."""


def follow(
    scene: Scene,
    path: Mapping[str, Any],
    *,
    directions: tuple[str, ...] = ("up", "down"),
    record: str = "sections",
    transient: int = 30,
    periods: int = 10,
    steps_per_period: int | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | None = None,
    start: Motion | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Sweeps a parameter with memory: each case starts from the state in which its neighbour ended.

    So a motion is followed along its branch until that ends, which from a fixed start it need not be. Where "up"
    and "down" disagree, attractors coexist.

    **Arguments:**

    - `path`: one parameter's name and values, in increasing order.
    - `directions`: "up" begins at the first value, "down" at the last; both run as one batch.
    - `transient`, `periods`: forcing periods at each value, before recording and recorded. The transient is
        rounded up to tens if above ten.
    - others: as for `sweep`; `start` is that of the first value met. Values that are visited together take the larger
        of their step counts.

    **Returns:** as `sweep`, with `direction` as first dimension.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    start = table_2_start() if start is None else check_start(start)
    cases, _, values = path_cases(scene, path, start)
    several = isinstance(directions, tuple | list) and len(directions) > 0
    if not several or any(directions.count(d) > 1 for d in directions):
        raise ValueError(f"Argument `directions` must name one or more ways, each once, but is {directions!r}.")
    ways = [DIRECTIONS[one_of("directions", d, tuple(DIRECTIONS))] for d in directions]
    plan = make_plan(
        scene,
        cases,
        record=record,
        transient=transient,
        periods=periods,
        steps_per_period=steps_per_period,
        saves_per_period=saves_per_period,
        solver=solver,
    )
    places = np.arange(len(values))
    columns = np.stack([places[::way] for way in ways], axis=1)  # (values, directions)
    states, runs, chunks = None, [], []
    with progress_bar(plan.periods * columns.size, progress) as bar:
        for k, column in enumerate(columns):
            scenes, starts = cases.take(filled(column, len(column)))
            states = initial_states(scenes, starts) if states is None else states
            most = int(plan.steps[column].max())
            on_progress = lambda periods: bar.update(periods * len(ways))
            runs.append(run_chunk(plan, scenes, states, most, on_progress, epoch=k * plan.periods))
            states = runs[-1].state
            # where these cases stand in the list of all directions and values
            chunks.append(Chunk(column + len(values) * np.arange(len(ways)), len(ways), most))
    steps = in_order(chunks, [np.full(len(ways), chunk.steps) for chunk in chunks])
    status = in_order(chunks, [run.status for run in runs])
    found = CaseRuns(status, steps, records_in_order(chunks, [run.record for run in runs]))
    return sweep_dataset(scene, plan, cases, found, {"direction": list(directions)})
