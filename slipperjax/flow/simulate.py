"""One scene, simulated: trajectories with the error of some periods, and the period map without records."""

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

from ..model.dang2024 import table_2_start
from ..model.dynamics import Args, Reactions, State, check_start, initial_state, reactions
from ..model.kinematics import Motion, accuracy_scales, scaled_size
from ..model.layout import StateLayout
from ..model.scene import Scene, check_scene
from ..model.step_size import LEAST_STEPS, default_steps_per_period, given_steps
from ..model.tracks import AbstractTrack
from ..solvers.named import resolve_controller, resolve_solver
from ..tools.checks import finite, instance, number, require, shown_number, warn, whole, yes_or_no
from ..tools.compile import as_argument, call_compiled, is_traced, jit
from ..tools.description import describe
from ..tools.jacobian import by_jacobian
from ..tools.limits import refuse_impossible
from ..tools.types import AnyArray, Real, Whole
from .course import Loads, over_periods
from .period_map import Passage, PeriodMap
from .record import RecordSet, Unlabelled
from .status import Status, judge_states, most_stability_number, with_accuracy, with_loads
from .stepping import (
    AbstractStepping,
    ConstantSteps,
    ControlledSteps,
    capacity_for,
    capacity_for_periods,
)


@dataclass(frozen=True)
class TrajectoryRecord(Unlabelled):
    """The states `saves` times per period, and with `loads` the contact loads of each."""

    saves: int = 1
    loads: bool = False

    @property
    def inside(self):
        return self.loads or self.saves > 1

    def values(self, scene, periods):
        states = (40 + 3 * scene.points) * self.saves  # with the forces that follow from them
        return (states + (5 * scene.points + 1) * self.loads) * periods

    def sample(self, course) -> tuple[State, Loads | None]:
        return course.saved(self.saves), course.loads if self.loads else None


class Probe(NamedTuple):
    """Errors of some periods of a run, measured by half the step, each repeated from the state at its start.

    The error of a whole run is larger where errors grow from period to period: slowly decaying motions keep them
    for as long as they decay, chaotic ones multiply them.
    """

    period: Float[Array, " probes"]
    """Number of the repeated forcing period, from 0."""
    error: Float[Array, " probes"]
    """Change of the motion at its end, in multiples of `slipperjax.model.accuracy_scales` [1]; NaN where lost."""
    peak_error: Float[Array, " probes"]
    """Relative change of its highest contact force [1]; NaN without contact or without loads."""


def _probed(
    scene: Scene, stepping: AbstractStepping, states: State, saves: int, count: int, run: Callable[..., Passage]
) -> Probe:
    """Repeat `count` periods of a run, or all if there are fewer, the first and others at equal distances.

    **Arguments:** `states`: saved ones, `saves` per period; `run(stepping, state, epoch)`: runs one period.
    """
    # the start is saved, too
    periods = (len(states.motion.y) - 1) // saves
    rows = []
    for k in np.unique(np.linspace(0, periods - 1, min(count, periods)).astype(int)):
        state = jax.tree.map(lambda a, at=k * saves: jnp.asarray(np.asarray(a)[at]), states)
        coarse = run(stepping, state, float(k))
        fine = run(stepping.finer(), state, float(k))
        error = _difference(scene, coarse.state, fine.state)
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
"""Time of a step of one case alone: most of it starts the step's kernels."""


def period_map(
    scene: Scene,
    state: State,
    *,
    periods: int = 1,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    begin: float | None = None,
) -> State:
    """Map `state` to that `periods` forcing periods later, stroboscopically. Pure; jit, vmap or differentiate it.

    **Arguments:** as for `simulate`; `state` comes from `initial_state` or an earlier call. On a rail that does not
    repeat each call begins where the rail does, unless `begin` says how far the one before has come [m].
    """
    check_scene(scene)
    origin = beginning_of(scene, begin)
    epoch = scene.epoch_at(origin)
    instance("state", state, State, "a slipperjax.State")
    periods = whole("periods", periods, 1)
    check_rail(scene, periods, origin)
    steps = default_steps(_at_slowest(scene, epoch, periods), steps_per_period)
    refuse_periods(periods, steps)
    solver = resolve_solver(scene, solver)
    controller = resolve_controller(stepsize_controller, solver)
    stepping = ConstantSteps(steps) if controller is None else _controlled(1, steps, controller, adjoint)
    epochs = (epoch,) if is_traced(origin) or origin else ()  # zero is a constant of the program
    mapped = PeriodMap(scene, stepping, solver, periods)
    return call_compiled(_mapped, mapped, (), state, *epochs)


def _mapped(map_: PeriodMap, static: tuple, state: State, epoch: Real = 0.0) -> State:
    return map_.run(state, epoch).state


def refuse_periods(periods: int, steps: int, numbers: int = 0) -> None:
    """Raise `ValueError` for a run of one case that keeps too many numbers or takes too long."""
    what = f"{periods} forcing periods of {steps} steps"
    refuse_impossible(what, 8.0 * numbers, SECONDS_PER_STEP * steps * periods)


def check_rail(scene: Scene, periods: int, begin: Real, transient: int = 0, after: int = 0) -> None:
    """Raise `ValueError` where a rail ends before a run of some forcing periods does, or where slippers wear.

    A warning says where a rail that goes on straight is known no further.

    **Arguments:** `begin`: where the run begins [m]; `transient`: how many of the periods pass before any is
    recorded: they must end on the rail; `after`: periods that records run on for.
    """
    require(
        scene.wear is None,
        "scene",
        "have no wear here, which slipperjax.run follows alone",
        scene.wear,
    )
    track = scene.track
    if is_traced((track, begin)) or not track.extent < np.inf:
        return  # nothing is known, or the rail goes on
    wave = float(np.max(np.asarray(scene.wavelength)))
    most = int((track.extent - begin) / wave * (1 + 1e-9))
    why = f"because the rail ends at {track.extent:g} m"
    total = periods + after
    if track.end < np.inf:
        need = f"be at most {most} here, with those before and after the recorded ones, {why}"
        require(total <= most, "periods", need, total)
    recorded = begin + transient * wave < track.extent
    require(recorded, "transient", f"be fewer than {most + 1} periods here, {why}", transient)
    warn_beyond(track, "periods", begin + total * wave)


def warn_beyond(track: AbstractTrack, name: str, travelled: float) -> None:
    """Warn where the argument `name` leads to a distance [m] beyond what is known of a rail."""
    if travelled > track.extent + 1e-9 * abs(track.extent):
        warn(f"Argument `{name}` leads to {travelled:g} m, but the rail is known up to {track.extent:g} m only.")


def default_steps(scene: Scene, steps: int | None) -> int:
    """Return the caller's steps per period, or the default; raise `ValueError` where the scene is traced."""
    return default_steps_per_period(scene) if steps is None else given_steps(steps)


def _at_slowest(scene: Scene, begin: Real, periods: int) -> Scene:
    """Return a scene at the least speed of a run from the forcing period number `begin` on, for its steps."""
    return eqx.tree_at(lambda s: s.speed, scene, scene.slowest_between(begin, begin + periods).speed)


def dynamic_steps(steps: int, *, most: int | None = None) -> ConstantSteps:
    """Return constant steps whose number is an argument of the program: one for many numbers; for forward mode.

    **Arguments:** `most`: the most steps that the program is to serve, where states inside periods are recorded.
    """
    capacity = None if most is None else capacity_for(most)
    return ConstantSteps(capacity, as_argument(steps))


def _controlled(
    samples: int, first_steps: int, controller: diffrax.AbstractStepSizeController, adjoint: object
) -> ControlledSteps:
    adjoint = diffrax.ForwardMode() if adjoint is None else adjoint
    instance("adjoint", adjoint, diffrax.AbstractAdjoint, "a diffrax adjoint")
    return ControlledSteps(samples, first_steps, controller, adjoint)


class Peak(NamedTuple):
    """The highest contact force of a run."""

    force: Real
    """Normal force [N]."""
    period: Real
    """When [forcing periods]; NaN without contact."""
    end: Whole
    """0 at the front, 1 at the rear."""
    point: Whole
    """Index of the point in `Section.names`."""

    def text(self, scene: Scene) -> str:
        """Say in words how high, where and when."""
        if not float(self.force) > 0:
            return "no contact"
        where = f"{scene.section.names[int(self.point)]}{int(self.end) + 1}"
        return f"highest contact force {float(self.force):.0f} N at {where}, period {float(self.period):.3f}"


class Trajectory(eqx.Module):
    """A simulated motion, saved at constant intervals."""

    scene: Scene
    period: Float[Array, " saves"]
    """Time in forcing periods [1]."""
    state: State
    """The saved states, with a leading axis of saves."""
    steps_per_period: Whole
    """Integration steps per forcing period; with adaptive steps, the number of states they were interpolated at."""
    steps_taken: Int[Array, " periods"]
    """Steps tried in each forcing period, those included that an adaptive controller rejected."""
    status: Int[Array, ""]
    """0 where nothing is wrong, else see `slipperjax.Status`."""
    loads: Loads | None
    """Contact loads of each forcing period, over every step, arrays (periods, ...); None where switched off."""
    call: str = eqx.field(static=True, default="{}")
    """The arguments of `simulate` besides scene and start, as JSON, for datasets and files."""
    probe: Probe | None = None
    """Errors of some periods, measured by half the step; None without `probe`."""

    def __repr__(self) -> str:
        saves = f"Trajectory({jax.typeof(self.period)} of saves"
        # inside a transformation, and of a batch, there are no numbers to show
        if is_traced(self.state) or np.ndim(self.status):
            return f"{saves})"
        status = Status(int(self.status))
        has_peak = self.loads is not None and status != Status.NOT_FINITE
        peak = f", {self.peak.text(self.scene)}" if has_peak else ""
        steps = shown_number(self.steps_per_period)
        return f"{saves}, {steps} steps per period, status {int(status)}: {status}{peak})"

    @property
    def time(self) -> Float[Array, " saves"]:
        """Time [s]."""
        return self.scene.seconds(self.period)

    @property
    def end(self) -> State:
        """The state at the end, with which another run can start."""
        return jax.tree.map(lambda a: a[-1], self.state)

    @property
    def peak(self) -> Peak:
        """The highest contact force over every step, when and where. **Raises:** `ValueError` without loads."""
        if self.loads is None:
            raise ValueError("Argument `loads` must be True in `simulate` for peak forces, but is False.")
        return _peak(self.loads)

    @property
    def reactions(self) -> Reactions:
        """Contact forces, drive force, loads on the track nodes, accelerations; leading axis saves."""
        return _reactions(self.scene, self.period, self.state)

    def to_xarray(self):
        """Return the trajectory as an `xarray.Dataset`, see `slipperjax.flow.datasets.trajectory_dataset`."""
        from .datasets import trajectory_dataset

        return trajectory_dataset(self)


@jit
def _reactions(scene, periods, states):
    return jax.vmap(lambda p, s: reactions(0.0, s, Args(scene, p)))(periods, states)


@jit
def _peak(loads: Loads) -> Peak:
    force, when = over_periods(loads)[:2]
    # the place of the highest has no derivative
    at = jnp.argmax(jax.lax.stop_gradient(force))
    end, point = jnp.unravel_index(at, force.shape)
    return Peak(jnp.max(force), when[end, point], end, point)


@functools.partial(jit, static_argnames=("saves",))
def _finished(
    first: State, passage: Passage, scene: Scene, most_stability_number: Real, epoch: Real, *, saves: int
) -> tuple:
    """Return states, loads, instants [forcing periods] and status of a run; one program, not one per operation."""
    ((saved, loads),) = passage.samples
    states = jax.tree.map(
        lambda a, b: jnp.concatenate([a[None], b.reshape(-1, *b.shape[2:])]),
        first,
        saved,
    )
    times = epoch + jnp.arange(passage.steps_taken.shape[0] * saves + 1) / saves
    # states between the ends of periods count, too
    code = jnp.where(passage.status == int(Status.FINITE), judge_states(states), passage.status)
    if loads is not None:
        total = over_periods(loads)
        closed = jnp.sum(total.contact_fraction)
        deepest = jnp.max(total.penetration)
        code = with_loads(code, closed, deepest, total.stability_number, scene, most_stability_number)
    return states, loads, times, code


def simulate(
    scene: Scene,
    periods: int = 60,
    *,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    start: object = None,
    begin: float | None = None,
    saves_per_period: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    loads: bool = True,
    probe: int = 0,
) -> Trajectory:
    """Simulate one scene.

    **Arguments:**

    - `scene`: the case, see `paper_scene`.
    - `periods`: number of forcing periods, wavelength / speed each.
    - `steps_per_period`: integration steps per forcing period; default from the duration of a typical contact at the
        least speed of the run, see `default_steps_per_period`, rounded up to a multiple of `saves_per_period`. It
        must be given where the scene's values are traced (jit, vmap).
    - `solver`: a diffrax solver, or the name of one as in "Rodas4"; see `resolve_solver` for the default. With
        `EventLatch` memory a stock one is put into `Latching`.
    - `stepsize_controller`: default constant steps. `AdaptiveSteps(tolerance)`, or one of diffrax's, goes with
        solvers that estimate their error; then `steps_per_period` is the first guess, and states between the ends
        of periods are interpolated at as many instants, to third order.
    - `start`: motion or state at `begin`, or a `Trajectory`, from whose end it goes on; default Table 2 of Dang et
        al. 2024. Or a dataset of `slipperjax.run`, from whose state at `begin` it goes on, by default at its end.
    - `begin`: place of the rail at which the run begins [m], by default where the rail does; zero for rails without
        a beginning. Time counts from distance zero.
    - `saves_per_period`: saved states per forcing period, a divisor of `steps_per_period`; default 40, or
        50, 40 or all, the first that divides them, where `steps_per_period` is given.
    - `adjoint`: for a step size controller only, as constant steps can be differentiated in both modes: default
        `diffrax.ForwardMode()`, for `jax.jvp` and `jax.jacfwd`; `diffrax.RecursiveCheckpointAdjoint()` for
        `jax.grad`.
    - `loads`: whether peak forces, impulses, time in contact and penetration are looked for over every step.
    - `probe`: in how many periods the error is measured by half the step (a tenth of the tolerance where steps are
        adaptive), see `Probe`; 0 for none. Not under a transformation.

    **Returns:** a `Trajectory`, the start included.

    **Raises:** `ValueError` that names the argument which is wrong, or memory and time of an impossible run.
    """
    check_scene(scene)
    periods = whole("periods", periods, 1)
    loads = yes_or_no("loads", loads)
    origin, start = beginning(scene, begin, start)
    probe = whole("probe", probe, 0)
    traced = is_traced((scene, start))
    require(not (probe and traced), "probe", "be 0 under jit, vmap or grad", probe)
    epoch = scene.epoch_at(origin)
    check_rail(scene, periods, origin)
    default = lambda: default_steps(_at_slowest(scene, epoch, periods), None)
    if steps_per_period is not None:
        steps_per_period = given_steps(steps_per_period)  # one number here
    steps, saves = step_plan(default, steps_per_period, saves_per_period)
    solver = resolve_solver(scene, solver)
    controller = resolve_controller(stepsize_controller, solver)
    record = TrajectoryRecord(saves, loads)
    records = RecordSet((record,))
    refuse_periods(periods, steps, record.values(scene, periods))
    if controller is not None:
        stepping = _controlled(steps if loads else saves, steps, controller, adjoint)
    elif traced:  # for both modes of derivatives
        stepping = ConstantSteps(steps)
    else:
        # one program for many numbers of steps; probes take twice as many
        most = (2 if probe else 1) * steps
        stepping = dynamic_steps(steps, most=most if records.inside else None)
    run = PeriodMap(scene, stepping, solver)
    if traced:
        # from the start, so that the numbers of a derivative are those of the caller
        first, passage = call_compiled(_from_start, run, (periods, records), start, epoch)
    else:
        first = initial_state(scene, start, epoch)
        passage = run_eagerly(run, first, periods, records, epoch)
    limit = most_stability_number(solver, controller)
    states, loads_of_periods, times, status = _finished(first, passage, scene, limit, epoch, saves=saves)
    # with adaptive steps, loads are looked for at as many instants
    shown = steps if controller is None or loads or saves == 1 else saves
    options = dict(
        periods=periods,
        steps_per_period=steps,
        saves_per_period=saves,
        solver=solver,
        stepsize_controller=controller,
        loads=loads,
        probe=probe,
        begin=origin,
    )
    call = json.dumps(describe(options))
    trajectory = Trajectory(
        scene,
        times,
        states,
        shown,
        passage.steps_taken,
        status,
        loads_of_periods,
        call,
    )
    if not probe:
        return trajectory
    repeat = lambda s, state, k: run_eagerly(
        PeriodMap(scene, s, solver),
        state,
        1,
        records,
        epoch + k,
        periods,
    )
    measured = _probed(scene, stepping, states, saves, probe, repeat)
    status = jnp.asarray(with_accuracy(np.asarray(status), np.max(np.asarray(measured.error))))
    return eqx.tree_at(
        lambda t: (t.status, t.probe),
        trajectory,
        (status, measured),
        is_leaf=lambda x: x is None,
    )


def _from_start(
    run: PeriodMap,
    static: tuple,
    start: Motion | State,
    epoch: Real,
) -> tuple[State, Passage]:
    """Return the state with which a run begins, and the run."""
    periods, records = static

    def begun(run: PeriodMap, start: Motion | State) -> tuple[State, Passage]:
        first = initial_state(run.scene, start, epoch)
        return first, run.run(first, epoch, periods=periods, records=records)

    return by_jacobian(begun, run, start)


def run_eagerly(
    run: PeriodMap, state: State, periods: int, records: RecordSet, epoch: Real = 0.0, like: int | None = None
) -> Passage:
    """Run with a program that serves other numbers of periods, too; that of a run of `like` periods if given."""
    size = capacity_for_periods(periods if like is None else like)
    numbers = as_argument(epoch), as_argument(periods)
    passage = call_compiled(_run, run, (size, records), state, *numbers)
    # on the host, where a slice of another length needs no compilation
    cut = lambda tree: jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[:periods]), tree)
    return passage._replace(samples=cut(passage.samples), steps_taken=cut(passage.steps_taken))


def _run(run: PeriodMap, static: tuple, state: State, epoch: Real, used: Whole) -> Passage:
    periods, records = static
    return run.run(state, epoch, periods=periods, records=records, used=used)


def step_plan(default: Callable[[], AnyArray | int], steps: Whole, saves: int | None) -> tuple[int | np.ndarray, int]:
    """Return integration steps per period, and saves per period, which divide them.

    **Arguments:** `default`: gives steps where the caller gave none, which are rounded up to a multiple of the saves;
    `steps`: one number, an array of them, or None; `saves`: by default 40, or of given steps 50, 40 or all, the first
    that divides them.
    """
    saves = None if saves is None else whole("saves_per_period", saves, 1)
    if steps is None:
        saves = LEAST_STEPS if saves is None else saves
        return -(-default() // saves) * saves, saves
    # one number, or one for each case
    numbers = [given_steps(n) for n in (np.ravel(steps).tolist() if np.ndim(steps) else [steps])]
    if saves is None:
        common = math.gcd(*numbers)
        saves = next(n for n in (50, LEAST_STEPS, common) if common % n == 0)
    for n in numbers:
        require(n % saves == 0, "saves_per_period", f"divide steps_per_period = {n}", saves)
    return (np.array(numbers) if np.ndim(steps) else numbers[0]), saves


def first_of(start: object) -> Motion | State:
    """Return the start of a run: None is Table 2's, a `Trajectory` goes on from its end.

    **Raises:** `ValueError` for what is no start, or has a number that is not finite.
    """
    if start is None:
        return table_2_start()
    return check_start("start", start.end if isinstance(start, Trajectory) else start)


def beginning_of(scene: Scene, begin: float | None) -> Real:
    """Return where a run begins [m]: by default where its rail does.

    **Raises:** `ValueError` for a place off the rail; by default for a programme of speeds, or a table of wear, that
    has ended before the rail begins.
    """
    track = scene.track
    if begin is not None:
        begin = number(finite, "begin", begin, "m")
        if not is_traced(track):
            slack = 1e-9 * abs(begin)
            on_rail = track.begin - slack <= begin < track.extent
            need = f"be on the rail, which is known from {track.begin:.10g} to {track.extent:.10g} m"
            require(on_rail, "begin", need, shown=f"{begin:.10g} m")
        return begin
    # parts of a scene that may be tables by distance
    for name in ("speed", "wear"):
        places = getattr(getattr(scene, name), "distance", None)
        if places is not None and not is_traced((places, track)) and (origin := track.origin):
            last = float(np.asarray(places)[-1])
            need = f"be by distances along the rail, which begins at {origin:.10g} m: or give `begin`"
            require(last >= origin, name, need, shown=f"a table up to {last:.10g} m")
    return track.origin


def beginning(scene: Scene, begin: float | None, start: Any) -> tuple[Real, Motion | State]:
    """Return where a run begins [m], and its start, which may be the state of an earlier run there."""
    if not hasattr(start, "data_vars"):
        return beginning_of(scene, begin), first_of(start)
    begin = None if begin is None else number(finite, "begin", begin, "m")
    from .datasets import load_base  # which is of trajectories

    marks = start.get("state")
    is_run = marks is not None and marks.ndim == 2
    require(is_run, "start", "be a motion, a state, or one run of slipperjax", shown="another dataset")
    # a run keeps its state at the end of each stretch
    places = start["stretch"].values
    begin = float(places[-1]) if begin is None else begin
    hits = np.flatnonzero(np.isclose(places, begin, rtol=1e-9, atol=0.0))
    need = f"be one of the distances where the earlier run kept its state, {places[0]:g} to {places[-1]:g} m"
    require(len(hits), "begin", need, begin)
    scene, _ = load_base(start)
    at = hits[0]
    state = StateLayout.of(scene).unpack(jnp.asarray(start["state"].values[at]))
    return float(places[at]), first_of(state)
