"""Error against cost: every method on every scene, measured side by side.

The error of a case is the greatest difference of a state from the reference at the ends of periods, in units of 1 mm,
10 mrad, 1 m/s and 10 rad/s. The median over a batch of neighbouring cases is shown, because a single case may be
accurate by chance. The cost is the time per trajectory and forcing period in microseconds, without compiling. Each
period is timed by itself, several times: the best and median costs are sums over periods of least and median times.
The pictures show the best, which other programs on the machine disturb least.
"""

import dataclasses
import functools
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from slipperjax.flow.period_map import advance, initial_states
from slipperjax.flow.record import RecordSet
from slipperjax.flow.stepping import ConstantSteps, ControlledSteps
from slipperjax.model.layout import coordinates
from slipperjax.model.quantities import COORDINATE_SCALES
from slipperjax.solvers.adaptive import AdaptiveSteps
from slipperjax.sweeps.call import Call, make_plan
from slipperjax.sweeps.grid import Grid
from slipperjax.tools.checks import one_of, whole

from .methods import METHODS, Case, Method, all_cases
from .work_precision import Point, mbdyn_points

REFERENCE_STEPS = 12_800
"""Steps per period of the reference, RK4 with the event latch."""


def run(
    case: Case,
    method: Method,
    setting: float,
    speeds: np.ndarray,
    workers: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate a batch period by period, with its chunks in parallel.

    **Returns:** the states at the ends of periods (lanes, periods, 10), and the time that each period took [s].
    """
    scene = dataclasses.replace(case.scene, memory=method.memory)
    grid = Grid(scene, {"speed": speeds}, product=False)
    # a sweep's plan, for its chunks and threads
    options = Call(0, case.periods, steps_per_period=1, solver=method.solver)
    plan = make_plan(grid, case.start, options, RecordSet())
    chunks, threads = plan.chunks(None, workers)
    if method.adaptive:
        # The first step of a period is 1/200 of it. pyright takes the properties rtol, atol and norm for arguments.
        controller = AdaptiveSteps(jnp.asarray(setting))  # pyright: ignore[reportCallIssue]
        stepping = ControlledSteps(1, 200, controller)
    else:
        # an array: one program serves every number of steps
        stepping = ConstantSteps(steps=jnp.asarray(setting))
    batches = [plan.cases.take(chunk.index) for chunk in chunks]
    states = [initial_states(*batch) for batch in batches]

    # block_until_ready, because JAX returns before the result is computed
    def one_period(batch, state, epoch):
        end = advance(batch[0], state, epoch, stepping, solver=plan.solver, periods=1)
        return jax.block_until_ready(end.state)

    saved = []
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        over_chunks = pool.map if threads > 1 else map
        # timed period by period, so that a disturbance spoils one of them only
        for k in range(case.periods):
            begin = time.perf_counter()
            states = list(over_chunks(functools.partial(one_period, epoch=float(k)), batches, states))
            seconds.append(time.perf_counter() - begin)
            # the last chunk is filled up with copies of cases, which do not count
            ends = [coordinates(state)[: chunk.cases] for state, chunk in zip(states, chunks, strict=True)]
            saved.append(np.concatenate(ends))
    return np.stack(saved, axis=1), np.array(seconds)


def batch_speeds(case: Case, lanes: int) -> np.ndarray:
    """Return the speeds [m/s] of a batch: within 2 % of the scene's speed, which is that of a batch of one."""
    share = np.linspace(-0.02, 0.02, lanes) if lanes > 1 else np.zeros(1)
    return float(case.scene.speed) * (1 + share)


def errors(states: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the greatest scaled error of each case, from states (cases, periods, 10); infinite where not finite."""
    worst = np.max(np.abs(states - truth) / COORDINATE_SCALES, axis=(1, 2))
    return np.where(np.isfinite(worst), worst, np.inf)


def cost_of(seconds: np.ndarray, lanes: int) -> tuple[float, float]:
    """Return best and median microseconds per trajectory and period, from seconds (repeats, periods)."""
    of = lambda pick: float(1e6 * np.mean(pick(seconds, axis=0)) / lanes)
    return of(np.min), of(np.median)


def measure(
    case: Case,
    methods: Iterable[Method],
    *,
    batches: tuple[int, ...] = (241, 1),
    repeats: int = 5,
    reference_steps: int = REFERENCE_STEPS,
    settings: slice = slice(None),
) -> list[Point]:
    """Measure the points of one scene.

    All errors come first. Then the costs of all points are measured in turn, `repeats` times over, so that slow
    changes of the machine's speed affect all points alike.

    **Arguments:** `batches`: numbers of trajectories to time; the first batch also gives the errors. `repeats`: timed
    runs of each point, fewer where they take more than 10 s. `settings`: which of each method's settings.
    """
    truth, _ = run(case, METHODS[0], float(reference_steps), batch_speeds(case, batches[0]))
    points: list[Point] = []
    # of each point with each batch: the call to time, and the seconds of each period by call
    timings = []
    for method in methods:
        for value in method.settings[settings]:
            setting = method.setting(case, value)
            # the reference must be finer than what it judges
            if not method.adaptive and setting > reference_steps / 2:
                continue
            calls = [functools.partial(run, case, method, setting, batch_speeds(case, lanes)) for lanes in batches]
            # the first calls also compile, and are not timed
            states = [call()[0] for call in calls]
            error = float(np.median(errors(states[0], truth)))
            point = Point(case.name, method.name, method.label(case, value), error, {})
            print(f"{case.name}: {method.name}, {point.setting}: error {error:.1e}", file=sys.stderr)
            points.append(point)
            timings += [(point, lanes, call, []) for lanes, call in zip(batches, calls, strict=True)]
    # each round times every batch of every point once
    for _ in range(repeats):
        for _, _, call, seconds in timings:
            # slow ones are repeated less often
            if np.sum(seconds) < 10.0:
                seconds.append(call()[1])
    for point, lanes, _, seconds in timings:
        point.cost[lanes] = cost_of(np.array(seconds), lanes)
    return points


def bench(
    *,
    quick: bool = False,
    cases: Iterable[str] | None = None,
    methods: Iterable[str] | None = None,
    batches: Iterable[int] | None = None,
    repeats: int | None = None,
) -> Iterator[list[Point]]:
    """Measure one scene after the other, and yield the points of each.

    **Arguments:** `quick`: fewer scenes, methods, settings and repeats; `cases`, `methods`: names, default all;
    `batches`: numbers of trajectories to run at once, default 241 and 1, or 241 if quick; the first one gives the
    errors. `repeats`: timed runs of each point, default 5, or 2 if quick.

    **Raises:** `ValueError` for an unknown name, before anything is measured.
    """
    all_methods = {method.name: method for method in METHODS}
    scenes = {case.name: case for case in all_cases()}
    options = {}
    if quick:
        cases = cases or ("nominal", "K = 1e10")
        methods = methods or [method.name for method in METHODS if method.quick]
        batches = batches or (241,)
        repeats = repeats or 2
        options = dict(reference_steps=3200, settings=slice(0, 4))
    # names are checked before anything is measured
    chosen = [scenes[one_of("cases", name, tuple(scenes))] for name in cases or scenes]
    rows = [all_methods[one_of("methods", name, tuple(all_methods))] for name in methods or all_methods]
    sizes = tuple(whole("batches", n, 1) for n in batches or (241, 1))
    repeats = whole("repeats", 5 if repeats is None else repeats, 1)
    for case in chosen:
        points = measure(case, rows, batches=sizes, repeats=repeats, **options)
        yield points + mbdyn_points(case.name)
