"""A parameter followed with memory: each case from the state in which its neighbour ended."""

from collections.abc import Mapping, Sequence
from typing import Any

import diffrax
import numpy as np
import xarray as xr

from ..flow import AbstractReducer, Trajectory, first_of, initial_states
from ..model import Motion, Scene, State
from ..tools import one_of
from .cases import filled, path_cases
from .executors import ChunkRun, in_order, records_in_order, run_chunk, run_chunks
from .plan import Chunk, OnProgress, make_plan
from .reducers import resolved_record
from .sweep import CaseRuns, sweep_dataset

DIRECTIONS = {"up": 1, "down": -1}
"""Ways through a parameter's values."""


def follow(
    scene: Scene,
    path: Mapping[str, Any],
    *,
    directions: tuple[str, ...] = ("up", "down"),
    record: str | AbstractReducer | Sequence[str | AbstractReducer] = "sections",
    transient: int = 30,
    periods: int = 10,
    steps_per_period: int | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
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

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C.
    """
    recorder, start = resolved_record(record), first_of(start)
    cases, _, values = path_cases(scene, path, start)
    several = isinstance(directions, tuple | list) and len(directions) > 0
    if not several or any(directions.count(d) > 1 for d in directions):
        raise ValueError(f"Argument `directions` must name one or more ways, each once, but is {directions!r}.")
    ways = [DIRECTIONS[one_of("directions", d, tuple(DIRECTIONS))] for d in directions]
    plan = make_plan(
        scene,
        cases,
        record=recorder,
        transient=transient,
        periods=periods,
        steps_per_period=steps_per_period,
        saves_per_period=saves_per_period,
        solver=solver,
    )
    places = np.arange(len(values))
    columns = np.stack([places[::way] for way in ways], axis=1)  # (values, directions)
    # where the cases at each value stand in the list of all directions and values
    index = [column + len(values) * np.arange(len(ways)) for column in columns]
    chunks = [Chunk(at, len(ways), int(plan.steps[c].max())) for at, c in zip(index, columns, strict=True)]
    states: State | None = None
    passed = 0

    def work(chunk: Chunk, on_progress: OnProgress) -> ChunkRun:
        nonlocal states, passed
        scenes, starts = cases.take(filled(columns[passed], len(ways)))
        begin = initial_states(scenes, starts) if states is None else states
        found = run_chunk(plan, scenes, begin, chunk.steps, on_progress, epoch=passed * plan.periods)
        states, passed = found.state, passed + 1
        return found

    # one worker: each begins where the one before ended
    runs = run_chunks(chunks, 1, work, periods=plan.work, progress=progress)
    steps = in_order(chunks, [np.full(len(ways), chunk.steps) for chunk in chunks])
    status = in_order(chunks, [run.status for run in runs.results])
    found = CaseRuns(status, steps, records_in_order(chunks, [run.record for run in runs.results]))
    call = dict(
        function="follow",
        values=len(values),
        directions=list(directions),
        record=record,
        transient=transient,
        periods=periods,
        steps_per_period=steps_per_period,
        saves_per_period=saves_per_period,
    )
    return runs.checked(sweep_dataset(plan, cases, found, call, {"direction": list(directions)}))
