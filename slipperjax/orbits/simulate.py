"""Simulation of one scene: its trajectory, errors of single periods, and the period map without records."""

import functools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..flow.course import Loads, over_periods
from ..flow.datasets import load_base, trajectory_dataset
from ..flow.period_map import Passage, PeriodMap
from ..flow.record import RecordSet, Unlabelled
from ..flow.status import (
    Status,
    first_problem,
    heed_interrupts,
    is_lost,
    judge_states,
    most_stability_number,
    with_accuracy,
    with_loads,
)
from ..flow.stepping import ROOM, ConstantSteps, ControlledSteps, calls_of, capacity_for
from ..model.dang2024 import table_2_start
from ..model.dynamics import Args, Reactions, State, reactions
from ..model.kinematics import Motion, accuracy_scales, scaled_size
from ..model.layout import StateLayout
from ..model.scene import Scene, check_scene, travel_unit
from ..model.starts import AtRest, check_start, initial_state
from ..model.step_size import LEAST_STEPS, default_steps_per_period, given_steps
from ..model.tracks import AbstractTrack
from ..results.result import AbstractResult
from ..solvers.named import resolve_controller, resolve_solver
from ..tools.checks import Check, finite, instance, number, one_of, require, shown_number, warn, whole, yes_or_no
from ..tools.compile import as_argument, call_compiled, jit
from ..tools.description import describe
from ..tools.jacobian import by_jacobian
from ..tools.limits import refuse_impossible
from ..tools.progress import bar as progress_bar
from ..tools.tracing import is_traced
from ..tools.types import AnyArray, Real, Whole


@dataclass(frozen=True)
class TrajectoryRecord(Unlabelled):
    """The states `saves` times per forcing period, and with `loads` the contact loads of each period."""

    saves: int = 1
    loads: bool = False
    waves = True

    @property
    def inside(self):
        return self.loads or self.saves > 1

    def values(self, scene, periods):
        # a saved state, and the accelerations and forces that are computed from the state later
        states = (40 + 3 * scene.points) * self.saves
        return (states + (5 * scene.points + 2) * self.loads) * periods

    def sample(self, course) -> tuple[State, Loads | None]:
        return course.saved(self.saves), course.loads if self.loads else None


class Probe(NamedTuple):
    """Errors of some forcing periods of a run: each is repeated with half the step, from the state at its start.

    The error of a whole run is larger: slowly decaying motions keep errors while they decay, and chaotic motions
    multiply errors from period to period.
    """

    period: Float[Array, " probes"]
    """Number of the repeated forcing period, from 0."""
    error: Float[Array, " probes"]
    """Change of the motion at the period's end, in multiples of `slipperjax.model.accuracy_scales` [1]; NaN where a
    solver gave up."""
    peak_error: Float[Array, " probes"]
    """Relative change of the period's highest contact force [1]; NaN without contact or without loads."""

    @property
    def worst(self) -> Float[np.ndarray, ""]:
        """The greatest error of all motions and forces; not for use under a transformation."""
        return np.asarray(np.max([self.error, np.nan_to_num(self.peak_error)]))


def _probed(run: PeriodMap, records: RecordSet, states: State, saves: int, epoch: Real, count: int) -> Probe:
    """Return the errors of `count` periods of a run, equally spaced from the first to the last, or of all if fewer.

    **Arguments:** `states`: saved in the run, `saves` per period; the run began at forcing period number `epoch`.
    """
    # the start is also saved
    periods = (len(states.motion.y) - 1) // saves
    finer = PeriodMap(run.scene, run.stepping.finer(), run.solver)
    rows = []
    for k in np.unique(np.linspace(0, periods - 1, min(count, periods)).astype(int)):
        state = jax.tree.map(lambda a, at=k * saves: jnp.asarray(np.asarray(a)[at]), states)
        # both runs begin at the saved state, so that only the steps differ
        coarse, fine = (run_eagerly(map_, state, 1, records, epoch + k) for map_ in (run, finer))
        error = _difference(run.scene, coarse.state, fine.state)
        peaks = []
        for passage in (coarse, fine):
            ((_, loads),) = passage.samples
            peaks.append(np.nan if loads is None else np.max(np.asarray(loads.peak_force)))
        # without contact, or without loads, there is no peak
        peak_error = abs(peaks[0] / peaks[1] - 1) if peaks[1] > 0 else np.nan
        rows.append((k, float(error), peak_error))
    return Probe(*map(jnp.asarray, np.array(rows, float).T))


@jit
def _difference(scene: Scene, a: State, b: State) -> Array:
    return scaled_size(jax.tree.map(jnp.subtract, a.motion, b.motion), accuracy_scales(scene))


SECONDS_PER_STEP = 8e-6
"""Time of a step of a single case: most of the time is needed to start the step's kernels."""


def period_map(
    scene: Scene,
    state: State,
    *,
    periods: int = 1,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    begin: Real | None = None,
) -> State:
    """Return the state `periods` forcing periods after `state`: the stroboscopic map. Jit, vmap or differentiate it.

    **Arguments:** `state`: from `initial_state` or an earlier call; others as for `simulate`. On a rail that does
    not repeat, each call begins at the rail's beginning, unless `begin` gives the end of the previous call [m].
    """
    scene = check_scene(scene)
    origin = beginning_of(scene, begin)
    epoch = scene.epoch_at(origin)
    instance("state", state, State, "a slipperjax.State")
    adjoint = _resolved_adjoint(adjoint)
    periods = whole("periods", periods, 1)
    check_rail(scene, periods, origin)
    steps = default_steps(_at_slowest(scene, epoch, periods), steps_per_period)
    refuse_periods(periods, steps)
    solver = resolve_solver(scene, solver)
    controller = resolve_controller(stepsize_controller, solver)
    stepping = ConstantSteps(steps) if controller is None else ControlledSteps(1, steps, controller, adjoint)
    epochs = (epoch,) if is_traced(origin) or origin else ()  # zero is a constant of the program
    mapped = PeriodMap(scene, stepping, solver, periods)
    return call_compiled(_mapped, mapped, (), state, *epochs)


def _mapped(map_: PeriodMap, static: tuple, state: State, epoch: Real = 0.0) -> State:
    return map_.run(state, epoch).state


def refuse_periods(periods: int, steps: int, numbers: int = 0) -> None:
    """Raise `ValueError` for a run of one case that keeps more `numbers` than fit into memory, or takes too long."""
    what = f"{periods} forcing periods of {steps} steps"
    refuse_impossible(what, 8.0 * numbers, SECONDS_PER_STEP * steps * periods)


def check_rail(scene: Scene, periods: int, begin: Real, transient: int = 0, after: int = 0) -> None:
    """Raise `ValueError` where a run goes beyond the end of its rail, or where slippers wear.

    A rail that continues straight has no end; there a warning says how far the rail is known. But the recorded part
    must begin before this distance.

    **Arguments:** `periods`: forcing periods of the run; `begin`: where it begins [m]; `transient`: number of
    periods before the recorded periods; `after`: further periods that records add to the run.
    """
    require(
        scene.wear is None,
        "scene",
        "have no wear here, which slipperjax.run follows alone",
        scene.wear,
    )
    track = scene.track
    if is_traced((track, begin)) or not track.extent < np.inf:
        return  # nothing is known, or the rail continues
    # of a batch, the case that travels farthest
    wave = float(np.max(np.asarray(scene.wavelength)))
    # the foremost slipper must not leave the rail
    begin = begin + float(np.max(np.asarray(scene.ahead)))
    most = int((track.extent - begin) / wave * (1 + 1e-9))
    why = f"because the rail ends at {track.extent:g} m"
    total = periods + after
    if track.end < np.inf:
        need = f"be at most {most} here, with those before and after the recorded ones, {why}"
        require(total <= most, "periods", need, shown=f"{total}; {longer_rails(track, begin + total * wave)}")
    recorded = begin + transient * wave < track.extent
    require(recorded, "transient", f"be fewer than {most + 1} periods here, {why}", transient)
    warn_beyond(track, "periods", begin + total * wave)


def warn_beyond(track: AbstractTrack, name: str, travelled: float) -> None:
    """Warn where the argument `name` leads to a distance [m] beyond the known part of a rail."""
    if travelled > track.extent + 1e-9 * abs(track.extent):
        warn(
            f"Argument `{name}` leads to {travelled:g} m, but the rail is known up to {track.extent:g} m only; "
            f"{longer_rails(track, travelled)}."
        )


def longer_rails(track: AbstractTrack, travelled: float) -> str:
    """Return a text that names the rails which reach a distance [m] beyond the end of one."""
    length = np.ceil(travelled - track.origin)
    alike = "RandomRails" if track.rails else "RandomTrack"
    return (
        'a rail that repeats (ends="repeat", ramp=8) goes on, and random ones are as long as one likes '
        f"({alike}.like(survey, length={length:.0f}))"
    )


def default_steps(scene: Scene, steps: int | None) -> int:
    """Return the caller's steps per period, or the default; raise `ValueError` where the scene is traced."""
    return default_steps_per_period(scene) if steps is None else given_steps(steps)


def _at_slowest(scene: Scene, begin: Real, periods: int) -> Scene:
    """Return a scene with the least speed of a run from the forcing period number `begin` on, for default steps."""
    return eqx.tree_at(lambda s: s.speed, scene, scene.slowest_between(begin, begin + periods).speed)


def dynamic_steps(steps: int, *, most: int | None = None) -> ConstantSteps:
    """Return constant steps whose number is an argument of the compiled program, so that it serves many numbers.

    The program can be differentiated only in forward mode.

    **Arguments:** `most`: where states inside periods are recorded, the greatest number of steps.
    """
    return ConstantSteps(most and capacity_for(most), as_argument(steps))


def steps_of_call(steps: int, *given: object) -> ConstantSteps:
    """Return constant steps of which one program serves all numbers; but where any of the arguments `given` is
    traced, a fixed number, which reverse mode needs."""
    return ConstantSteps(steps) if is_traced(given) else dynamic_steps(steps)


def _resolved_adjoint(adjoint: object) -> diffrax.AbstractAdjoint:
    """Return how runs with a step size controller are differentiated, by default in forward mode."""
    adjoint = diffrax.ForwardMode() if adjoint is None else adjoint
    return instance("adjoint", adjoint, diffrax.AbstractAdjoint, "a diffrax adjoint")


class Peak(NamedTuple):
    """The highest contact force of a run."""

    force: Real
    """Normal force [N]."""
    period: Real
    """Instant of the highest force [forcing periods]; NaN without contact."""
    point: Whole
    """Index of the point in `Scene.point_names`."""

    def text(self, scene: Scene) -> str:
        """Return a text that says how high, where and when the force is."""
        if not float(self.force) > 0:
            return "no contact"
        where = scene.point_names[int(self.point)]
        when = f"period {float(self.period):.3f}"
        # on rails without waves the distance counts
        if travel_unit(scene) != "period":
            when = f"{float(self.period * scene.wavelength):.2f} m"
        return f"highest single contact point {float(self.force):.0f} N at {where}, {when}"


class Trajectory(eqx.Module, AbstractResult):
    """A simulated motion: states saved at constant intervals, and loads of every forcing period."""

    scene: Scene
    period: Float[Array, " saves"]
    """Instants of the saved states [forcing periods]."""
    state: State
    """The saved states, with a leading axis of saves."""
    steps_per_period: Whole
    """Integration steps per forcing period; with adaptive steps, instants at which states are interpolated."""
    steps_taken: Int[Array, " periods"]
    """Steps tried in each forcing period, including those that a step size controller rejected."""
    status: Int[Array, ""]
    """Code of `slipperjax.Status`, 0 where nothing is wrong."""
    loads: Loads | None
    """Contact loads of each forcing period, over every step, arrays (periods, ...); None with `loads=False`."""
    call: str = eqx.field(static=True, default="{}")
    """The arguments of `simulate` except scene and start, as JSON, for datasets and files."""
    probe: Probe | None = None
    """Errors of some forcing periods; None unless `simulate` had a `probe`."""

    def __repr__(self) -> str:
        saves = f"Trajectory({jax.typeof(self.period)} of saves"
        # inside a transformation, and of a batch, there are no numbers to show
        if is_traced(self.state) or np.ndim(self.status):
            return f"{saves})"
        status = Status(int(self.status))
        has_peak = self.loads is not None and not is_lost(status)
        peak = f", {self.peak.text(self.scene)}" if has_peak else ""
        steps = f"{shown_number(self.steps_per_period)} steps per {travel_unit(self.scene)}"
        return f"{saves}, {steps}, status {int(status)}: {status}{peak})"

    @property
    def time(self) -> Float[Array, " saves"]:
        """Instants of the saved states [s]."""
        return self.scene.seconds(self.period)

    @property
    def end(self) -> State:
        """The last state, with which another run can start."""
        return jax.tree.map(lambda a: a[-1], self.state)

    @property
    def peak(self) -> Peak:
        """The highest contact force over all steps, with time and place. **Raises:** `ValueError` without loads."""
        if self.loads is None:
            raise ValueError("Argument `loads` must be True in `simulate` for peak forces, but is False.")
        return _peak(self.loads)

    @property
    def reactions(self) -> Reactions:
        """Contact forces, drive force, loads on the track nodes and accelerations, with a leading axis of saves."""
        return _reactions(self.scene, self.period, self.state)

    @property
    def ds(self):
        return trajectory_dataset(self)


@jit
def _reactions(scene, periods, states):
    return jax.vmap(lambda p, s: reactions(0.0, s, Args(scene, p)))(periods, states)


@jit
def _peak(loads: Loads) -> Peak:
    force, when = over_periods(loads)[:2]
    # the point's number changes by whole numbers, and has no derivative
    at = jnp.argmax(jax.lax.stop_gradient(force))
    return Peak(jnp.max(force), when.ravel()[at], at)


@functools.partial(jit, static_argnames=("saves",))
def _finished(first: State, passage: Passage, scene: Scene, most: Real, epoch: Real, *, saves: int) -> tuple:
    """Return states, loads, instants [forcing periods] and status of a run; as one program, not one per operation.

    **Arguments:** `most`: see `with_loads`.
    """
    ((saved, loads),) = passage.samples
    states = jax.tree.map(
        lambda a, b: jnp.concatenate([a[None], b.reshape(-1, *b.shape[2:])]),
        first,
        saved,
    )
    times = epoch + jnp.arange(passage.steps_taken.shape[0] * saves + 1) / saves
    # states between the ends of periods also count
    code = jnp.where(passage.status == int(Status.FINITE), judge_states(states), passage.status)
    if loads is not None:
        total = over_periods(loads)
        closed = jnp.sum(total.contact_fraction)
        deepest = jnp.max(total.penetration)
        code = with_loads(code, closed, deepest, total.stability_number, total.damping_ratio, scene, most)
    return states, loads, times, code


def simulate(
    scene: Scene,
    periods: int = 60,
    *,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    start: object = None,
    begin: Real | None = None,
    saves_per_period: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    loads: bool = True,
    probe: int = 0,
    progress: bool | None = None,
) -> Trajectory:
    """Simulate the motion of one scene over some forcing periods.

    **Arguments:**

    - `scene`: the case, see `paper_scene`.
    - `periods`: number of forcing periods; each takes the first wavelength over the speed.
    - `steps_per_period`: integration steps per forcing period. By default a typical contact at the least speed of the
        run takes ten steps, see `default_steps_per_period`, rounded up to a multiple of `saves_per_period`. The
        number must be given where the scene's values are traced (jit, vmap).
    - `solver`: a diffrax solver, or a solver's name such as "Rodas4"; see `resolve_solver` for the default. With
        `EventLatch` memory, `Latching` wraps solvers of diffrax.
    - `stepsize_controller`: default None, for constant steps. `AdaptiveSteps(tolerance)`, or a controller of diffrax,
        needs a solver that estimates its error. The first step is then a period over `steps_per_period`, and states
        inside periods are interpolated at this number of instants, to third order.
    - `start`: the motion or state at `begin`; by default Table 2 of Dang et al. 2024; "rest" for `AtRest()`. From a
        `Trajectory` the run continues from its end, from a dataset of `slipperjax.run` from its state at `begin`, by
        default from its end.
    - `begin`: distance along the rail at which the run begins [m]; by default the beginning of the rail, or zero for
        rails without a beginning. Time counts from distance zero.
    - `saves_per_period`: saved states per forcing period, a divisor of `steps_per_period`. Default 40; where
        `steps_per_period` is given, 50 or 40 if one of them divides it, otherwise all steps.
    - `adjoint`: only for a step size controller, because constant steps can be differentiated in both modes. The
        default `diffrax.ForwardMode()` serves `jax.jvp` and `jax.jacfwd`, `diffrax.RecursiveCheckpointAdjoint()`
        serves `jax.grad`.
    - `loads`: whether to compute peak forces, impulses, time in contact and penetration over every step.
    - `probe`: number of forcing periods to repeat with half the step (for adaptive steps with a tenth of the
        tolerance) to measure their error, see `Probe`; 0 for none. Not inside a JAX transformation.
    - `progress`: as for `sweep`.

    **Returns:** a `Trajectory`, which includes the start.

    **Raises:** `ValueError` that names the wrong argument, or memory and time of an impossible run.
    """
    scene = check_scene(scene)
    periods = whole("periods", periods, 1)
    loads = yes_or_no("loads", loads)
    adjoint = _resolved_adjoint(adjoint)
    origin, start = beginning(scene, begin, start)
    probe = whole("probe", probe, 0)
    traced = is_traced((scene, start, origin))
    require(not (probe and traced), "probe", "be 0 under jit, vmap or grad", probe)
    epoch = scene.epoch_at(origin)
    check_rail(scene, periods, origin)
    default = lambda: default_steps_per_period(_at_slowest(scene, epoch, periods))
    # `step_plan` would also take an array, for the cases of a sweep
    if steps_per_period is not None:
        steps_per_period = given_steps(steps_per_period)
    steps, saves = step_plan(default, steps_per_period, saves_per_period)
    solver = resolve_solver(scene, solver)
    controller = resolve_controller(stepsize_controller, solver)
    record = TrajectoryRecord(saves, loads)
    records = RecordSet((record,))
    refuse_periods(periods, steps, record.values(scene, periods))
    if controller is not None:
        stepping = ControlledSteps(steps if loads else saves, steps, controller, adjoint)
    elif traced:  # for both modes of derivatives
        stepping = ConstantSteps(steps)
    else:
        # one program for many numbers of steps: capacity for twice as many, because probes need these
        most = (2 if probe else 1) * steps
        stepping = dynamic_steps(steps, most=most if records.inside else None)
    run = PeriodMap(scene, stepping, solver)
    if traced:
        # the start is made inside, so that derivatives are by the caller's few numbers, not by a whole state
        first, passage = call_compiled(_from_start, run, (periods, records), start, epoch)
    else:
        first = initial_state(scene, start, epoch)
        with progress_bar(progress, total=periods, desc="simulate", unit=" periods") as bar:
            passage = run_eagerly(run, first, periods, records, epoch, bar.update)
    limit = most_stability_number(solver, controller)
    states, loads_of_periods, times, status = _finished(first, passage, scene, limit, epoch, saves=saves)
    measured = None
    if probe:
        measured = _probed(run, records, states, saves, epoch, probe)
        status = jnp.asarray(with_accuracy(np.asarray(status), measured.worst))
    # with adaptive steps, the number of instants of interpolated states
    shown = steps if controller is None or loads or saves == 1 else saves
    call = dict(
        periods=periods,
        steps_per_period=steps,
        saves_per_period=saves,
        solver=solver,
        stepsize_controller=controller,
        loads=loads,
        probe=probe,
        begin=origin,
    )
    return Trajectory(
        scene,
        times,
        states,
        shown,
        passage.steps_taken,
        status,
        loads_of_periods,
        json.dumps(describe(call)),
        measured,
    )


def stand_in(
    scene: Scene,
    periods: int,
    *,
    start: object = None,
    begin: Real | None = None,
    steps_per_period: int | None = None,
    saves_per_period: int | None = None,
) -> Trajectory:
    """Return the result of `simulate` with zeros in place of numbers, to compile programs that follow a run.

    **Arguments:** as for `simulate`.
    """
    origin, start = beginning(scene, begin, start)
    first = initial_state(scene, start, scene.epoch_at(origin))
    _, saves = step_plan(lambda: LEAST_STEPS, steps_per_period, saves_per_period)
    zeros = lambda *shape: jnp.asarray(np.zeros(shape))
    instants = periods * saves + 1
    states = jax.tree.map(lambda a: zeros(instants, *a.shape), first)
    of_points = zeros(periods, *scene.point_shape)
    of_periods = zeros(periods)
    loads = Loads(*[of_points] * 5, *[of_periods] * 2)
    whole_numbers = jnp.asarray(np.zeros(periods, int))
    return Trajectory(scene, zeros(instants), states, saves, whole_numbers, whole_numbers[0], loads)


def _from_start(
    run: PeriodMap,
    static: tuple,
    start: Motion | State,
    epoch: Real,
) -> tuple[State, Passage]:
    """Return the state with which a run begins, and the result of the run."""
    periods, records = static

    def begun(run: PeriodMap, start: Motion | State) -> tuple[State, Passage]:
        first = initial_state(run.scene, start, epoch)
        return first, run.run(first, epoch, periods=periods, records=records)

    return by_jacobian(begun, run, start)


def run_eagerly(
    run: PeriodMap,
    state: State,
    periods: int,
    records: RecordSet,
    epoch: Real = 0.0,
    on_progress: Callable[[int], object] = lambda passed: None,
) -> Passage:
    """Run one case call by call, by a compiled program that serves any number of periods.

    **Arguments:** `on_progress`: called with the number of forcing periods that have just passed.

    **Raises:** `KeyboardInterrupt` where the run is asked to end.
    """
    parts = []
    at = epoch
    status = np.asarray(int(Status.FINITE))
    for used in calls_of(periods):
        heed_interrupts()
        passage = call_compiled(_run, run, records, state, as_argument(at), as_argument(used))
        state = passage.state
        at += used
        status = first_problem(status, passage.status)
        # on the host, where a slice of another length needs no compilation
        per_period = passage.samples, passage.steps_taken
        parts.append(jax.tree.map(lambda a, used=used: np.asarray(a)[:used], per_period))
        on_progress(used)
    samples, steps_taken = jax.tree.map(lambda *of_calls: jnp.asarray(np.concatenate(of_calls)), *parts)
    return passage._replace(samples=samples, steps_taken=steps_taken, status=jnp.asarray(status))


def _run(run: PeriodMap, records: RecordSet, state: State, epoch: Real, used: Whole) -> Passage:
    return run.run(state, epoch, periods=ROOM, records=records, used=used)


def step_plan(default: Callable[[], AnyArray | int], steps: Whole, saves: int | None) -> tuple[int | np.ndarray, int]:
    """Return integration steps per period, and a number of saves per period that divides them.

    **Arguments:** `steps`: the caller's number or array of numbers; None for the result of `default`, rounded up to a
    multiple of the saves; `saves`: by default 40, for given steps the first of 50, 40 and the greatest common divisor
    that divides the steps.
    """
    if saves is not None:
        saves = whole("saves_per_period", saves, 1)
    if steps is None:
        saves = saves or LEAST_STEPS
        return -(-default() // saves) * saves, saves
    # one number, or one for each case of a sweep
    numbers = [given_steps(n) for n in (np.ravel(steps).tolist() if np.ndim(steps) else [steps])]
    if saves is None:
        common = math.gcd(*numbers)
        saves = next(n for n in (50, LEAST_STEPS, common) if common % n == 0)
    for n in numbers:
        require(n % saves == 0, "saves_per_period", f"divide steps_per_period = {n}", saves)
    return (np.array(numbers) if np.ndim(steps) else numbers[0]), saves


def first_of(start: object) -> Motion | State:
    """Return the motion or state with which a run begins: Table 2's for None, the last state of a `Trajectory`,
    `AtRest()` for "rest".

    **Raises:** `ValueError` for a value that is no start, or that has a number which is not finite.
    """
    if start is None:
        return table_2_start()
    if isinstance(start, str):
        one_of("start", start, ("rest",))
        return AtRest()
    return check_start("start", start.end if isinstance(start, Trajectory) else start)


def beginning_of(scene: Scene, begin: Real | None) -> Real:
    """Return where a run begins [m], by default the rail's beginning. A traced place outside the rail becomes NaN.

    **Raises:** `ValueError` for a place outside the rail; by default also for a programme of speeds, or a table of
    wear or of loads, that has ended before the rail begins.
    """
    track = scene.track
    if begin is not None:
        if is_traced(begin):
            return Check("begin", "m", is_good=lambda place: (place >= track.begin) & (place < track.extent))(begin)
        begin = number(finite, "begin", begin, "m")
        if not is_traced(track):
            # computed distances may have rounding errors
            slack = 1e-9 * abs(begin)
            need = f"be on the rail, which is known from {track.begin:.10g} to {track.extent:.10g} m"
            require(track.begin - slack <= begin < track.extent, "begin", need, shown=f"{begin:.10g} m")
        return begin
    # Tables by distance that end before the rail begins were meant to count from its beginning, not from zero.
    loads = getattr(scene.load, "loads", (scene.load,))
    for name, part in (("speed", scene.speed), ("wear", scene.wear), *(("load", load) for load in loads)):
        places = getattr(part, "distance", None)
        if places is not None and not is_traced((places, track)) and (origin := track.origin):
            last = float(np.asarray(places)[-1])
            need = f"be by distances along the rail, which begins at {origin:.10g} m: or give `begin`"
            require(last >= origin, name, need, shown=f"a table up to {last:.10g} m")
            first = float(np.asarray(places)[0])
            if getattr(part, "time", None) is not None and first < origin:
                # such as the history of a sled that begins with the rail
                warn(
                    f"The run begins at {origin:.10g} m, the beginning of the rail, but its speeds over time begin "
                    f"at {first:.10g} m, so that the sled already moves: give a `begin` to the speeds, or to the run."
                )
    return track.origin


def beginning(scene: Scene, begin: Real | None, start: Any) -> tuple[Real, Motion | State]:
    """Return where a run begins [m], and its start, for a dataset of `slipperjax.run` the state kept there."""
    if not hasattr(start, "data_vars"):
        return beginning_of(scene, begin), first_of(start)
    states = start.get("state")
    is_run = states is not None and states.ndim == 2
    require(is_run, "start", "be a motion, a state, or one run of slipperjax", shown="another dataset")
    # a run keeps its state at the end of each stretch
    places = start["stretch"].values
    begin = float(places[-1]) if begin is None else number(finite, "begin", begin, "m")
    hits = np.flatnonzero(np.isclose(places, begin, rtol=1e-9, atol=0.0))
    need = f"be one of the distances where the earlier run kept its state, {places[0]:g} to {places[-1]:g} m"
    require(len(hits), "begin", need, begin)
    scene, _ = load_base(start)
    at = hits[0]
    state = StateLayout.of(scene).unpack(jnp.asarray(start["state"].values[at]))
    return float(places[at]), first_of(state)
