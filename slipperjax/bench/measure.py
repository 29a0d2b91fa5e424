"""Error against cost: every method on every scene, measured side by side.

The error is the worst difference of a state from the reference at the ends of the periods, in units of 1 mm, 10 mrad,
1 m/s and 10 rad/s, in the median over a batch of neighbouring cases, because a single case may be accurate by chance.
The cost is microseconds per trajectory and forcing period without compiling. Each period is timed by itself, several
times over: best and median are sums over the periods of the least and of the middle times. The pictures show the
best, which other programs on the machine disturb the least.
"""

import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..flow.period_map import advance, initial_states
from ..flow.stepping import ConstantSteps, ControlledSteps
from ..model.layout import coordinates
from ..model.quantities import COORDINATE_SCALES
from ..solvers.adaptive import AdaptiveSteps
from ..sweeps.grid import Grid
from ..sweeps.run import RunOptions, make_plan
from ..tools.checks import whole
from .methods import METHODS, Case, Method, all_cases
from .work_precision import Point, mbdyn_points

REFERENCE_STEPS = 12_800
"""Steps per period of the reference, RK4 with the event latch."""
ENOUGH_SECONDS = 10.0
"""Seconds of one point's timed runs after which it is not repeated."""
SPREAD = 0.02
"""The batch's speeds reach from 1 - SPREAD to 1 + SPREAD times the scene's."""
FIRST_STEPS = 200
"""Adaptive runs begin each period with a step of one period over this."""


def run(
    case: Case, method: Method, setting: float, speeds: np.ndarray, workers: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """Integrates a batch period by period, its chunks concurrently; in one chunk where `calls_lapack`.

    **Returns:** the states (lanes, periods, 10), and the time of each period [s].
    """
    scene = dataclasses.replace(case.scene, memory=method.memory)
    grid, options = Grid(scene, {"speed": speeds}, product=False), RunOptions(0, case.periods, 1, None, method.solver)
    plan = make_plan(grid, case.start, options)  # for its chunks and threads
    chunks, threads = plan.chunks(None, workers)
    if method.adaptive:
        # rtol, atol and norm are properties of it, and no arguments
        controller = AdaptiveSteps(jnp.asarray(setting))  # pyright: ignore[reportCallIssue]
        stepping = ControlledSteps(1, FIRST_STEPS, controller)
    else:
        stepping = ConstantSteps(steps=jnp.asarray(setting))  # an array: one program serves every number
    batches = [plan.cases.take(chunk.index) for chunk in chunks]
    states = [initial_states(*batch) for batch in batches]

    def one_period(batch, state, epoch):
        end = advance(batch[0], state, epoch, stepping, solver=plan.solver, periods=1)
        return jax.block_until_ready(end.state)

    saved, seconds = [], []
    with ThreadPoolExecutor(threads) as pool:
        over_chunks = pool.map if threads > 1 else map
        for k in range(case.periods):
            begin = time.perf_counter()
            states = list(over_chunks(functools.partial(one_period, epoch=float(k)), batches, states))
            seconds.append(time.perf_counter() - begin)
            ends = [coordinates(s)[: c.cases] for s, c in zip(states, chunks, strict=True)]
            saved.append(np.concatenate(ends))
    return np.stack(saved, axis=1), np.array(seconds)


def batch_speeds(case: Case, lanes: int) -> np.ndarray:
    """Gives the speeds [m/s] of a batch about the scene's own, which is the only one of a batch of one."""
    return float(case.scene.speed) * (1 + (np.linspace(-SPREAD, SPREAD, lanes) if lanes > 1 else np.zeros(1)))


def errors(states: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Gives the worst scaled error of each case, infinite where it is not finite; states are (cases, periods, 10)."""
    worst = np.max(np.abs(states - truth) / COORDINATE_SCALES, axis=(1, 2))
    return np.where(np.isfinite(worst), worst, np.inf)


def cost_of(seconds: np.ndarray, lanes: int) -> tuple[float, float]:
    """Gives best and median microseconds per trajectory and period from the periods' seconds (repeats, periods)."""
    of = lambda pick: float(1e6 * np.mean(pick(seconds, axis=0)) / lanes)
    return of(np.min), of(np.median)


def measure(
    case: Case,
    methods: Iterable[Method],
    *,
    batches: tuple[int, ...] = (241, 1),
    repeats: int = 5,
    reference_steps: int = REFERENCE_STEPS,
    workers: int | None = None,
    settings: slice = slice(None),
) -> Iterator[Point]:
    """Measures the points of one scene.

    All errors come first. Then all costs are measured `repeats` times in rounds over all points, so that slow changes
    of the machine's speed affect all points alike. An interrupt is raised again after the points that were timed once
    at least.

    **Arguments:** `batches`: numbers of trajectories to time, the first of which gives the errors; `repeats`: timed
    runs of each, fewer where they take longer than `ENOUGH_SECONDS`; `workers`: threads, as for `sweep`; `settings`:
    slice of each method's settings.
    """
    speeds = batch_speeds(case, batches[0])
    truth, _ = run(case, METHODS[0], float(reference_steps), speeds, workers)
    points: list[Point] = []
    calls: list[dict[int, Callable]] = []
    lanes_of: list[dict[int, int]] = []
    for method in methods:
        for value in method.settings[settings]:
            setting = method.setting(case, value)
            if not method.adaptive and setting > reference_steps / 2:
                continue
            speeds_of = {lanes: batch_speeds(case, lanes)[:: method.stride] for lanes in batches}
            calls.append({n: functools.partial(run, case, method, setting, v, workers) for n, v in speeds_of.items()})
            lanes_of.append({n: len(v) for n, v in speeds_of.items()})
            states = [call()[0] for call in calls[-1].values()]  # compiles, too
            error = float(np.median(errors(states[0], truth[:: method.stride])))
            points.append(Point(case.name, method.name, method.label(case, value), error, {}))
            print(f"{case.name}: {method.name}, {points[-1].setting}: error {error:.1e}", file=sys.stderr)
    seconds: list[dict[int, list]] = [{n: [] for n in of_point} for of_point in calls]
    interrupt = None
    try:
        for k in range(repeats):
            # each round times every batch of every point once
            for of_point, times in zip(calls, seconds, strict=True):
                for n, call in of_point.items():
                    if np.sum(times[n]) < ENOUGH_SECONDS:
                        times[n].append(call()[1])
            print(f"{case.name}: timed round {k + 1} of {repeats}", file=sys.stderr)
    except KeyboardInterrupt as error:
        interrupt = error
    for point, times, lanes in zip(points, seconds, lanes_of, strict=True):
        cost = {n: cost_of(np.array(of_batch), lanes[n]) for n, of_batch in times.items() if of_batch}
        if cost:
            yield point._replace(cost=cost)
    if interrupt is not None:
        raise interrupt


def bench(
    *,
    quick: bool = False,
    cases: Iterable[str] | None = None,
    methods: Iterable[str] | None = None,
    batches: Iterable[int] | None = None,
    repeats: int | None = None,
    report: Callable[[Point], None] = lambda point: None,
) -> Iterator[tuple[list[Point], tuple[int, ...]]]:
    """Measures, and yields the points so far and the batch sizes whenever a scene is done, and after an interrupt.

    **Arguments:** `quick`: two scenes, the methods marked so, and the batch alone; `cases`, `methods`: names, default
    all; `batches`: numbers of trajectories to run at once, the first of which gives the errors, by default 241 and 1,
    and 241 where quick; `repeats`: timed runs of each point, by default 5, and 2 where quick; `report`: called with
    each point.

    **Raises:** `ValueError` where a name is unknown, before anything is measured.
    """
    repeats = (2 if quick else 5) if repeats is None else whole("repeats", repeats, 1)
    batches = tuple(whole("batches", n, 1) for n in batches or ((241,) if quick else (241, 1)))
    chosen = _named("cases", all_cases(), cases, lambda c: not quick or c.name in ("nominal", "K = 1e10"))
    rows = _named("methods", METHODS, methods, lambda m: not quick or m.quick)
    options: dict[str, Any] = dict(batches=batches, repeats=repeats)
    if quick:
        options |= dict(settings=slice(0, 4), reference_steps=3200)
    return _scenes(chosen, rows, options, report)


def _scenes(cases, methods, options, report):
    """Measures scene after scene, and yields all points so far after each."""
    points, batches = [], options["batches"]
    shown = batches if 1 in batches else (*batches, 1)
    for case in cases:
        try:
            for point in measure(case, methods, **options):
                points.append(point)
                report(point)
        except KeyboardInterrupt:
            if points:
                yield points, shown
            raise
        points += mbdyn_points([case.name])
        yield points, shown


def _named(argument: str, rows: Iterable[Any], names: Iterable[str] | None, otherwise: Callable) -> list:
    """Gives the rows with some names, or those that meet a condition where there are no names."""
    rows = list(rows)
    if names is None:
        return [row for row in rows if otherwise(row)]
    by_name = {row.name: row for row in rows}
    for name in names:
        if name not in by_name:
            raise ValueError(f"Argument `{argument}` must be of {'; '.join(by_name)}, but has {name!r}.")
    return [by_name[name] for name in names]
