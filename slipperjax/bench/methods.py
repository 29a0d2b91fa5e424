"""Speed against error: every solver on easy and hard scenes, measured side by side.

A method is a row of `METHODS`: a solver, how the contact remembers its touchdowns, and the settings to go through,
which are numbers of steps or tolerances. A row more is a solver more.

The error is the worst difference of a state from the reference at the ends of the periods, in units of 1 mm, 10 mrad,
1 m/s and 10 rad/s, in the median over a batch of neighbouring cases: one case alone may be lucky. The cost is
microseconds per trajectory and forcing period, compilation left out. Each period is timed by itself, several
times over: best and median are sums over the periods of the least and of the middle times. The picture shows the
best, which the machine's other programs disturb the least: a period is short, and some repetitions pass undisturbed.
"""

import dataclasses
import functools
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from .batch import Workers, filled, start_states
from .branches import SCALES
from .checks import whole
from .compilation import jit
from .contact import AbstractMemory, EventLatch, SmoothSwitch
from .kinematics import Motion, table_2_start
from .peers import PEERS, AbstractPeer
from .records import outputs
from .scene import Scene, default_steps_per_period, paper_scene
from .simulate import integrate
from .solvers import (
    RK4,
    ROS34PW2,
    AdaptiveSteps,
    Latching,
    Rodas3,
    Rodas4,
    Tsit5,
    TwoStep,
    calls_lapack,
    with_newton,
)
from .work_precision import Point, mbdyn_points

REFERENCE_STEPS = 12_800
"""Steps per period of the reference, RK4 with the event latch."""
ENOUGH = 10.0
"""Seconds of one point's timed runs after which it is not repeated: what lasts so long is slow beyond any doubt."""
SPREAD = 0.02
"""The batch's speeds reach from 1 - SPREAD to 1 + SPREAD times the scene's."""


class Case(NamedTuple):
    """A scene of the benchmark."""

    name: str
    scene: Scene
    periods: int
    """Forcing periods to compare over; few where neighbouring motions part quickly."""
    start: Motion


def _with_gravity(scene: Scene, gravity: float) -> Scene:
    return dataclasses.replace(scene, gravity=gravity)


def all_cases() -> list[Case]:
    """The scenes, from easy to hard. All but the last have the same structure, and so share compiled programs."""
    plain = lambda **options: _with_gravity(paper_scene(**options), 0.0)
    still = dict(amplitude=0.0, roll_amplitude=0.0)
    resting = Motion(z=-5e-4, v_z=-1e-3, w_x=1e-2, w_y=1e-2)
    start = table_2_start()
    return [
        Case("nominal", plain(), 6, start),
        Case("V = 2300 m/s", plain(speed=2300.0), 6, start),
        Case("C = 4 mm", plain(clearance=4e-3), 6, start),
        Case("K = 1e10", plain(stiffness=1e10), 2, start),
        Case("K = 1e12", plain(stiffness=1e12), 2, start),
        Case("resting", _with_gravity(paper_scene(**still), 9.81), 6, resting),
        Case("two waves", plain(speed=1500.0, wavelengths=(10.0, 12.0)), 6, start),
    ]


class Method(NamedTuple):
    """A way to integrate a scene."""

    name: str
    solver: diffrax.AbstractSolver
    memory: AbstractMemory
    settings: tuple[float, ...]
    """Steps per period as multiples of the scene's default; or tolerances of `AdaptiveSteps`, where `adaptive`."""
    adaptive: bool = False
    quick: bool = False
    """Whether it is part of the quick run."""

    @property
    def stride(self) -> int:
        """Which of a batch's cases are run: every one, or every sixteenth where LAPACK solves a system for each.

        That takes milliseconds per case and period, however many there are.
        """
        return 16 if calls_lapack(self.solver) else 1

    def setting(self, case: Case, value: float) -> float:
        """The number that the program is given: steps per period, or the tolerance."""
        if self.adaptive:
            return value
        return float(max(1, round(value * default_steps_per_period(case.scene))))

    def label(self, case: Case, value: float) -> str:
        """How a setting is named in the table."""
        return f"tolerance {value:.0e}" if self.adaptive else f"{self.setting(case, value):.0f} steps"


FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6)
FIRST = 200
"""Adaptive runs begin each period with a step of one period over this."""

METHODS = [
    Method("RK4", RK4(), EventLatch(), FACTORS, quick=True),
    Method("Tsit5", Tsit5(), EventLatch(), FACTORS),
    Method("Tsit5, adaptive", Tsit5(), EventLatch(), TOLERANCES, adaptive=True),
    Method("diffrax Dopri8", Latching(diffrax.Dopri8()), EventLatch(), FACTORS[:-1]),
    Method("Rodas3", Rodas3(), EventLatch(), FACTORS),
    Method("Rodas4", Rodas4(), EventLatch(), FACTORS),
    Method("ROS34PW2", ROS34PW2(), EventLatch(), FACTORS, quick=True),
    Method("paper's two-step", TwoStep(), EventLatch(), FACTORS),
    Method("diffrax Kvaerno5", Latching(diffrax.Kvaerno5()), EventLatch(), FACTORS[:3]),
    Method("smooth: RK4", RK4(), SmoothSwitch(), FACTORS, quick=True),
    Method("smooth: ROS34PW2", ROS34PW2(), SmoothSwitch(), FACTORS),
    Method("smooth: diffrax Tsit5, adaptive", diffrax.Tsit5(), SmoothSwitch(), TOLERANCES, adaptive=True),
    Method("smooth: diffrax Kvaerno3", with_newton(diffrax.Kvaerno3()), SmoothSwitch(), FACTORS[:3]),
    Method("smooth: diffrax Kvaerno5", with_newton(diffrax.Kvaerno5()), SmoothSwitch(), FACTORS[:3]),
    Method(
        "smooth: diffrax Kvaerno5, adaptive",
        with_newton(diffrax.Kvaerno5()),
        SmoothSwitch(),
        TOLERANCES[:-1],
        adaptive=True,
    ),
    Method("smooth: diffrax implicit Euler", with_newton(diffrax.ImplicitEuler()), SmoothSwitch(), FACTORS[:4]),
]
"""The methods compared, with the event latch unless named smooth. diffrax's KenCarp methods want the sum of a stiff
and a mild part, which contact is not. Those that call LAPACK run on one thread, and a sixteenth of the cases."""


@functools.partial(jit, static_argnums=(5, 6))
def _period(scene, speeds, states, epoch, setting, solver, adaptive):
    """The states of all lanes one period after those at `epoch`."""

    def one(speed, state):
        case = scene.replace(speed=speed)
        options = dict(solver=solver, periods=1, record=None, adjoint=diffrax.ForwardMode(), epoch=epoch)
        if adaptive:
            # rtol, atol and norm are properties of it, and no arguments
            controller = AdaptiveSteps(setting)  # pyright: ignore[reportCallIssue]
            return integrate(case, state, steps=FIRST, controller=controller, **options)[0]
        return integrate(case, state, steps=setting, **options)[0]

    return jax.vmap(one)(speeds, states)


def run(
    case: Case, method: Method, setting: float, speeds: np.ndarray, workers: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """Integrates a batch, its chunks side by side and period by period together; one chunk where `calls_lapack`.

    **Returns:** the states (lanes, periods, 10), and what each period took [s].
    """
    scene = dataclasses.replace(case.scene, memory=method.memory)
    start = jax.tree.map(lambda v: jnp.asarray(v, float), case.start)
    # no more chunks than threads, for they wait for each other
    threads = Workers(len(speeds), None, workers, alone=calls_lapack(method.solver)).workers
    team = Workers(len(speeds), len(filled(-(-len(speeds) // threads))), threads)
    together = threading.Barrier(-(-len(speeds) // team.chunk))
    clock: list[list[float]] = [[] for _ in range(case.periods)]

    def work(values, tick):
        states, kept = start_states(scene, values, start), []
        try:
            for k in range(case.periods):
                together.wait()
                clock[k].append(time.perf_counter())
                states = _period(scene, values["speed"], states, float(k), setting, method.solver, method.adaptive)
                jax.block_until_ready(states)
                clock[k].append(time.perf_counter())
                kept.append(outputs(states))
        except BaseException:
            together.abort()
            raise
        return [np.stack(kept, axis=1)]

    (states,) = team.run(work, {"speed": speeds}, periods=case.periods, progress=False)
    return states, np.array([max(times) - min(times) for times in clock])


def batch_speeds(case: Case, lanes: int) -> np.ndarray:
    """Speeds [m/s] of a batch about the scene's own, which is the only one of a batch of one."""
    return float(case.scene.speed) * (1 + (np.linspace(-SPREAD, SPREAD, lanes) if lanes > 1 else np.zeros(1)))


def errors(states: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Worst scaled error of each case, infinite where it is not finite; states are (cases, periods, 10)."""
    worst = np.max(np.abs(states - truth) / SCALES, axis=(1, 2))
    return np.where(np.isfinite(worst), worst, np.inf)


def cost_of(seconds: np.ndarray, lanes: int) -> tuple[float, float]:
    """Best and median microseconds per trajectory and period from the periods' seconds (repeats, periods)."""
    of = lambda pick: float(1e6 * np.mean(pick(seconds, axis=0)) / lanes)
    return of(np.min), of(np.median)


def measure(
    case: Case,
    methods: Iterable[Method],
    *,
    batches: tuple[int, ...] = (241, 1),
    repeats: int = 5,
    reference_steps: int = REFERENCE_STEPS,
    peers: Iterable[AbstractPeer] = PEERS,
    workers: int | None = None,
    settings: slice = slice(None),
) -> Iterator[Point]:
    """The points of one scene.

    First all errors; then all costs, `repeats` times round all points: a machine whose speed changes with the
    minutes is then the same to all of them. An interrupt after the first round ends the rounds.

    **Arguments:** `batches`: numbers of trajectories to time, the first of which gives the errors; `repeats`: timed
    runs of each, fewer where they take longer than `ENOUGH`; `workers`: threads, as for `sweep`; `settings`: which
    of each method's settings.
    """
    speeds = batch_speeds(case, batches[0])
    truth, _ = run(case, METHODS[0], float(reference_steps), speeds, workers)
    found, runs = [], []
    for method in methods:
        for value in method.settings[settings]:
            setting = method.setting(case, value)
            if not method.adaptive and setting > reference_steps / 2:
                continue
            some = {lanes: batch_speeds(case, lanes)[:: method.stride] for lanes in batches}
            own = {n: functools.partial(run, case, method, setting, some[n], workers) for n in batches}
            states = [go()[0] for go in own.values()]  # compiles, too
            error = np.median(errors(states[0], truth[:: method.stride]))
            found.append((method.name, method.label(case, value), error, {n: len(some[n]) for n in batches}))
            runs.append(own)
            print(f"{case.name}: {', '.join(found[-1][:2])}: error {found[-1][2]:.1e}", file=sys.stderr)
    seconds = [{lanes: [] for lanes in own} for own in runs]
    for k in range(repeats):
        try:
            for own, mine in zip(runs, seconds, strict=True):
                for lanes, go in own.items():
                    if np.sum(mine[lanes]) < ENOUGH:
                        mine[lanes].append(go()[1])
        except KeyboardInterrupt:
            if k == 0:
                raise
            break  # an interrupt ends the rounds, and what was timed before it counts
        print(f"{case.name}: timed round {k + 1} of {repeats}", file=sys.stderr)
    for (name, label, error, run_lanes), mine in zip(found, seconds, strict=True):
        cost = {lanes: cost_of(np.array(taken), run_lanes[lanes]) for lanes, taken in mine.items()}
        yield Point(case.name, name, label, float(error), cost)
    for peer in peers:
        for setting, states, taken, picked in peer.runs(case, speeds):
            error = float(np.median(errors(states, truth[picked])))
            best, median = (1e6 * s / case.periods for s in taken)
            yield Point(case.name, peer.name, setting, error, {1: (best, median)})


def bench(
    *,
    quick: bool = False,
    cases: Iterable[str] | None = None,
    methods: Iterable[str] | None = None,
    batches: Iterable[int] | None = None,
    repeats: int = 5,
    report: Callable[[Point], None] = lambda point: None,
) -> Iterator[tuple[list[Point], tuple[int, ...]]]:
    """Measures, and yields the points so far and the batch sizes whenever a scene is done.

    **Arguments:** `quick`: two scenes, the methods marked so, and the batch alone; `cases`, `methods`: names of some
    only; `batches`: numbers of trajectories to run at once, the first of which gives the errors, by default 241 and
    1, and 241 where quick; `repeats`: timed runs of each point; `report`: called with each point.

    **Raises:** `ValueError` where a name is unknown, before anything is measured.
    """
    repeats = whole("repeats", repeats, 1)
    batches = tuple(whole("batches", n, 1) for n in batches or ((241,) if quick else (241, 1)))
    chosen = _named("cases", all_cases(), cases, lambda c: not quick or c.name in ("nominal", "K = 1e10"))
    rows = _named("methods", METHODS, methods, lambda m: not quick or m.quick)
    options = dict(batches=batches, repeats=2 if quick else repeats, settings=slice(0, 4) if quick else slice(None))
    if quick:
        options |= dict(reference_steps=3200, peers=[p for p in PEERS if p.quick])
    points = []
    for case in chosen:
        for point in measure(case, rows, **options):
            points.append(point)
            report(point)
        points += mbdyn_points([case.name])
        yield points, batches if 1 in batches else (*batches, 1)


def _named(argument: str, rows: Iterable[Any], names: Iterable[str] | None, otherwise: Callable) -> list:
    rows = list(rows)
    if names is None:
        return [row for row in rows if otherwise(row)]
    known = {row.name: row for row in rows}
    for name in names:
        if name not in known:
            raise ValueError(f"Argument `{argument}` must be of {'; '.join(known)}, but has {name!r}.")
    return [known[name] for name in names]
