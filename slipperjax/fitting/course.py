"""The model's runs beside measured ones: windows of records, what sensors read in them, and its derivatives."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..flow.period_map import SlopePassage, advance, advance_slopes
from ..flow.record import RecordSet
from ..flow.status import heed_interrupts
from ..flow.stepping import SampledSteps
from ..model.dynamics import State
from ..model.kinematics import MOTION_SCALES, Motion
from ..model.layout import StateLayout
from ..model.parameters import at_values, values_of
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene
from ..model.sensors import Rig
from ..model.step_size import default_steps_per_period
from ..solvers.latching import calls_lapack
from ..sweeps.grid import VECTOR_LANES, Cases
from ..sweeps.run import gather
from ..tools.batching import Batched
from ..tools.compile import ahead, as_argument, jit
from ..tools.limits import cores
from ..tools.types import Real
from .channels import ChannelRecord, Channels, begin
from .measured import MeasuredRun
from .method import Problem

SIZES = np.array([getattr(MOTION_SCALES, name) for name in MOTION_NUMBERS])
LANES = 4
"""Runs in one call with derivatives: few, so that some searches use all cores."""
CALL = 10
"""Forcing periods in one call of the program that follows a motion without derivatives."""
SHIFTS = 8
"""Recurrences of the rail among which a first guess is looked for."""


class Windows(NamedTuple):
    """Measured runs, cut into windows of equal length; arrays are filled up where there are fewer samples."""

    run: Int[np.ndarray, " windows"]
    """Index of the run of each window."""
    lag: Int[np.ndarray, " windows"]
    """Forcing periods from where the run begins to where the window does."""
    periods: int
    """Of each window."""
    time: Float[np.ndarray, "windows sensors samples"]
    """Of the samples since the run began [s]."""
    value: Float[np.ndarray, "windows sensors samples"]
    known: Float[np.ndarray, "windows sensors samples"]
    """One for samples, and zero for what fills up."""

    @classmethod
    def of(cls, runs: Sequence[MeasuredRun], scenes: Sequence[Scene], origin: float, window: int | None) -> "Windows":
        """Cut runs of some scenes into windows.

        **Arguments:** `origin`: forcing periods from distance zero to where runs begin; `window`: forcing periods of
        each, or of fewer where runs are shorter; None for one as long as the longest run.
        """
        passed = [_passed(scene, origin, run) for scene, run in zip(scenes, runs, strict=True)]
        ends = [max(one[-1] for one in every if one.size) for every in passed]
        whole = [max(int(np.ceil(end - 2e-9)), 1) for end in ends]
        periods = max(whole) if window is None else min(window, max(whole))
        counts = [-(-length // periods) for length in whole]
        run = np.repeat(np.arange(len(runs)), counts)
        lag = np.concatenate([np.arange(count) for count in counts]) * periods
        # a sample belongs to the window in which the model passes it
        inside = []
        for number, first in zip(run, lag, strict=True):
            last = counts[number] - 1
            inside.append([np.minimum(one // periods, last) == first // periods for one in passed[number]])
        most = max(int(mask.sum()) for masks in inside for mask in masks)
        time, value, known = np.zeros((3, len(run), len(passed[0]), most))
        for w, masks in enumerate(inside):
            for s, mask in enumerate(masks):
                signal = runs[run[w]].signals[s]
                count = int(mask.sum())
                known[w, s, :count] = 1.0
                if signal is not None:
                    time[w, s, :count] = signal.time[mask]
                    value[w, s, :count] = signal.value[mask]
        return cls(run, lag, periods, time, value, known)

    @property
    def count(self) -> int:
        return len(self.run)


def _passed(scene: Scene, origin: float, run: MeasuredRun) -> list[np.ndarray]:
    """Return for each sensor the forcing periods that have passed at its samples since the run began."""
    since = lambda periods: np.asarray(scene.seconds(origin + periods) - scene.seconds(origin))
    most = 1.0
    while since(most) <= run.end:
        most *= 2
    grid = np.linspace(0.0, most, 4097)
    times = since(grid)
    # rounding may put a sample before the place where it is
    return [np.empty(0) if one is None else np.interp(one.time, times, grid) + 1e-9 for one in run.signals]


class Course(NamedTuple):
    """Runs of the model, one for each start and window."""

    reading: Float[np.ndarray, "starts windows sensors samples"]
    slope: Float[np.ndarray, "starts windows sensors samples directions"]
    """By the parameters, and by the ten numbers of the window's start in their scales."""
    end: Float[np.ndarray, "starts windows 10"]
    """Numbers of the motion where the next window's run begins [scales]."""
    end_slope: Float[np.ndarray, "starts windows 10 directions"]


@dataclass(frozen=True, kw_only=True)
class Model:
    """How the model repeats the records of a fit, with other values of its parameters."""

    problem: Problem
    windows: Windows
    steps: int
    """In each forcing period, a multiple of `samples`."""
    samples: int
    """Instants in each forcing period, between which signals are interpolated."""

    @classmethod
    def of(cls, problem: Problem, windows: Windows) -> "Model":
        """Return the model of a fit."""
        # of the scene's own values, and of those in the middle
        middle = {one.name: float(one.value(np.zeros(()))) for one in problem.unknowns if not one.of_sensors}
        scenes = [*problem.scenes, *(scene.replace(**middle) for scene in problem.scenes)]
        samples = max(map(default_steps_per_period, scenes))
        return cls(problem=problem, windows=windows, steps=samples, samples=samples).with_steps(
            problem.steps or samples
        )

    @property
    def stepping(self) -> SampledSteps:
        return SampledSteps(self.samples, as_argument(self.steps // self.samples))

    @property
    def kept(self) -> RecordSet:
        """What runs keep of each forcing period."""
        return RecordSet((ChannelRecord(self.samples),))

    def values(self, levels: Float[np.ndarray, "starts parameters"]) -> Float[np.ndarray, "starts parameters"]:
        """Return parameters from their levels."""
        return np.stack([one.value(levels[:, k]) for k, one in enumerate(self.problem.unknowns)], axis=1)

    def with_steps(self, steps: int) -> "Model":
        """Return the same with as many steps per period, or more."""
        steps = max(-(-steps // self.samples) * self.samples, self.steps)
        return self if steps == self.steps else replace(self, steps=steps)

    def with_samples(self, samples: int) -> "Model":
        """Return the same with other instants, a multiple of those it has."""
        return replace(self, samples=samples).with_steps(self.steps)

    @property
    def epoch(self) -> Float[np.ndarray, " windows"]:
        """Forcing periods from distance zero to where the model's run of each window begins."""
        return self.problem.origin - self.problem.lead + self.windows.lag

    def reader(self, samples: int, origin: float) -> "Reader":
        """Return how sensors read runs with `samples` instants in each period, whose times count from `origin`."""
        problem = self.problem
        return Reader(problem.rig, origin, problem.names, problem.sensor_names, samples)

    def each(
        self,
        values: Float[np.ndarray, "starts parameters"],
        numbers: Float[np.ndarray, "starts windows 10"] | None,
        lanes: int,
        work: Callable[[Batched[Scene], State, np.ndarray, np.ndarray], list[np.ndarray]],
        **rails: np.ndarray,
    ) -> list[np.ndarray]:
        """Call `work(scenes, starts, windows, numbers of sensors)` for the runs of all starts and windows.

        **Arguments:** `numbers`: of the motions with which runs begin [scales], None for those of the problem;
        `lanes`: runs of a call; `rails`: numbers that choose the rail of each run.

        **Returns:** its arrays, (starts, windows, ...).
        """
        count, windows = len(values), self.windows
        grid = rails
        for name in dict.fromkeys(name for run in self.problem.runs for name in run.settings):
            own = float(self.problem.scene.value(name))
            grid[name] = np.tile([self.problem.runs[k].settings.get(name, own) for k in windows.run], count)
        grid |= {name: np.repeat(values[:, k], windows.count) for k, name in enumerate(self.problem.names)}
        # a grid has one list at least
        grid |= {"start_y": np.zeros(count * windows.count)}
        cases = Cases(self.problem.scene, grid, self.problem.start, product=False)
        begun = self.problem.start
        begun = begun if isinstance(begun, State) else State(begun, None)
        starts = jax.tree.map(lambda a: np.broadcast_to(np.asarray(a, float), (cases.count, *np.shape(a))), begun)
        if numbers is not None:
            of_start = numbers.reshape(-1, len(SIZES)) * SIZES
            motion = Motion(*of_start.T, sled=starts.motion.sled, modes=starts.motion.modes)
            # closed contacts begin there
            starts = State(motion, None)
        window = np.tile(np.arange(windows.count), count)
        of_sensors = np.repeat(values[:, len(self.problem.names) :], windows.count, axis=0)

        def one(index: np.ndarray) -> list[np.ndarray]:
            scenes, _ = cases.take(index)
            begun = jax.tree.map(lambda a: a[index], starts)
            return work(scenes, begun, window[index], of_sensors[index])

        parts = in_groups(cases.count, lanes, one)
        return [a.reshape(count, windows.count, *a.shape[1:]) for a in parts]

    def course(
        self,
        values: Float[np.ndarray, "starts parameters"],
        numbers: Float[np.ndarray, "starts windows 10"],
        stride: int = 1,
    ) -> Course:
        """Run the model from some starts, and differentiate it.

        **Arguments:** `numbers`: of motions [scales]; `stride`: of the instants between which signals are
        interpolated.
        """
        problem = self.problem
        reader = self.reader(self.samples // stride, problem.origin)

        def work(scenes, starts, window, q):
            epoch = self.epoch[window]
            now = begin(scenes, starts, epoch, names=problem.names)
            seen = [jax.tree.map(lambda a: np.asarray(a)[:, None], now.samples)]
            slopes = [jax.tree.map(lambda a: np.asarray(a)[:, :, None], now.sample_slopes)]
            for k in range(self.windows.periods + problem.lead):
                heed_interrupts()
                now = self._pushed(scenes, now, epoch + k)
                seen.append(jax.tree.map(np.asarray, now.samples))
                slopes.append(jax.tree.map(np.asarray, now.sample_slopes))
                if k + 1 == self.windows.periods:
                    # the first numbers of a state are those of its motion
                    end = StateLayout.pack(now.state)[:, : len(SIZES)]
                    end_slope = np.moveaxis(np.asarray(now.slopes)[..., : len(SIZES)], 1, -1)
            (seen_,) = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1)[:, ::stride], *seen)
            (slopes_,) = jax.tree.map(lambda *parts: np.concatenate(parts, axis=2)[:, :, ::stride], *slopes)
            reading, slope = readings(reader, scenes, q, seen_, slopes_, epoch, self.windows.time[window])
            return [np.asarray(reading), np.moveaxis(np.asarray(slope), 1, -1), end, end_slope]

        reading, slope, end, end_slope = self.each(values, numbers, LANES, work)
        # numbers of sensors do not move the body
        at = [len(problem.names)] * len(problem.sensor_names)
        end_slope = np.insert(end_slope, at, 0.0, axis=-1)
        for array in (slope, end_slope):
            array[..., -len(SIZES) :] *= SIZES
        return Course(reading, slope, end / SIZES, end_slope / SIZES[:, None])

    def _pushed(self, scenes: Batched[Scene], now: SlopePassage, epoch: np.ndarray) -> SlopePassage:
        """Return runs after a forcing period, with derivatives."""
        how = dict(names=self.problem.names, records=self.kept, solver=self.problem.solver)
        return advance_slopes(scenes, now.state, now.slopes, epoch, self.stepping, **how)

    def compile_ahead(self, values: Float[np.ndarray, "starts parameters"]) -> None:
        """Compile the program of derivatives, the longest of all, while others are compiled and run."""
        if calls_lapack(self.problem.solver):
            return  # which must not be called from two threads
        # no steps at all
        model = replace(self, steps=0)

        def work(scenes, starts, window, q):
            epoch = model.epoch[window]
            model._pushed(scenes, begin(scenes, starts, epoch, names=model.problem.names), epoch)
            return []

        numbers = np.zeros((1, self.windows.count, len(SIZES)))
        ahead(lambda: model.each(values[:1], numbers, LANES, work))

    def guesses(
        self, values: Float[np.ndarray, "starts parameters"], transient: int, noise: Float[np.ndarray, " sensors"]
    ) -> tuple[Float[np.ndarray, "starts windows 10"], Float[np.ndarray, " starts"]]:
        """Return motions with which the windows may begin [scales], and how far they are from the samples.

        Of the motion to which each start settles, they are those after which the next periods are most like the
        record. On rails that do not recur there is one place, and nothing settles.
        """
        windows, problem = self.windows, self.problem
        recurrence = float(np.max(np.asarray(problem.scene.recurrence)))
        recurs = np.isfinite(recurrence)
        every = max(int(recurrence), 1) if recurs else 1
        shifts = np.arange(SHIFTS if recurs else 1) * every
        settle = -(-transient // every) * every if recurs else 0
        length = windows.periods + problem.lead
        total = settle + int(windows.lag.max() + shifts[-1]) + length
        reader = self.reader(self.samples, problem.origin)
        first = problem.origin - problem.lead

        def work(scenes, starts, window, q):
            # as runs begin, where the model's first run does
            now = begin(scenes, starts, np.full(len(window), first), names=problem.names)
            seen = self.followed(scenes, now, first, settle, total)
            best = np.full(len(window), np.inf)
            numbers = np.zeros((len(window), len(SIZES)))
            for shift in shifts:
                place = (windows.lag[window] + shift) * self.samples
                at = place[:, None] + np.arange(length * self.samples + 1)
                part = jax.tree.map(lambda a, at=at: a[np.arange(len(a))[:, None], at], seen)
                reading = values_read(reader, scenes, q, part, self.epoch[window], windows.time[window])
                off = (np.asarray(reading) - windows.value[window]) / noise[:, None] * windows.known[window]
                far = np.sum(off**2, axis=(1, 2))
                better = far < best
                best[better] = far[better]
                numbers[better] = part.motion[better, 0] / SIZES
            return [numbers, best]

        numbers, far = self.each(values, None, VECTOR_LANES, work)
        return numbers, far.sum(axis=1)

    def followed(self, scenes: Batched[Scene], now: SlopePassage, epoch: float, settle: int, total: int) -> Channels:
        """Return the channels of motions after `settle` of `total` forcing periods, (lanes, instants, ...).

        **Arguments:** `now`: where they begin, `epoch` forcing periods from distance zero.
        """
        states = now.state
        kept = [jax.tree.map(lambda a: np.asarray(a)[:, None], now.samples[0])]
        how = dict(solver=self.problem.solver, periods=CALL, records=self.kept)
        passed = 0
        while passed < total:
            heed_interrupts()
            used = min(CALL, (settle if passed < settle else total) - passed)
            ran = advance(scenes, states, epoch + passed, self.stepping, used=as_argument(used), **how)
            states = ran.state
            # periods and samples in one row, without the periods that are not used
            row = lambda a, used=used: np.asarray(a)[:, :used].reshape(len(a), used * self.samples, *a.shape[3:])
            kept.append(jax.tree.map(row, ran.samples[0]))
            passed += used
            # of the time in which the motion settles the last instant
            if passed <= settle:
                kept = [jax.tree.map(lambda a: a[:, -1:], kept[-1])]
        return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *kept)


def in_groups(count: int, lanes: int, work: Callable[[np.ndarray], list[np.ndarray]]) -> list[np.ndarray]:
    """Return the arrays that `work` gives for the indices of cases, in groups of `lanes` on all cores."""
    groups = np.split(np.arange(count), range(lanes, count, lanes))
    parts: list[list[np.ndarray]] = [[]] * len(groups)

    def one(k: int) -> None:
        # the last group is filled up with copies of its last case
        made = work(groups[k][np.minimum(np.arange(lanes), len(groups[k]) - 1)])
        parts[k] = [array[: len(groups[k])] for array in made]

    gather([functools.partial(one, k) for k in range(len(groups))], cores())
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]


class Reader(eqx.Module):
    """How sensors read runs, with other values of the scene's parameters and of their own numbers."""

    rig: Rig
    origin: Real
    """Forcing periods from distance zero to where times count from."""
    names: tuple[str, ...] = eqx.field(static=True)
    sensor_names: tuple[str, ...] = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    """Instants in each forcing period."""

    def __call__(self, scene: Scene, p: Array, q: Array, seen: Channels, epoch: Real, at: Array) -> Array:
        """Return what all sensors read in a run, which begins at `epoch`, at some times, (sensors, samples)."""
        scene, rig = at_values(scene, self.names, p), at_values(self.rig, self.sensor_names, q)
        instants = epoch + jnp.arange(seen.motion.shape[0]) / self.samples
        time = scene.seconds(instants) - scene.seconds(self.origin)
        modes = scene.slipper.modes
        return jnp.stack([sensor.read(seen, time, at[k], modes) for k, sensor in enumerate(rig.sensors)])


@jit
def values_read(reader: Reader, scenes: Batched[Scene], *of_runs: PyTree) -> Float[Array, "runs sensors samples"]:
    """Return what sensors read in some runs.

    **Arguments:** `of_runs`: numbers of the sensors, channels, epochs, and times of each run.
    """
    return scenes.map(lambda scene, *of_run: reader(scene, values_of(scene, reader.names), *of_run), *of_runs)


@jit
def readings(
    reader: Reader, scenes: Batched[Scene], *of_runs: PyTree
) -> tuple[Float[Array, "runs sensors samples"], Float[Array, "runs directions sensors samples"]]:
    """Return what sensors read in some runs, and its derivatives by parameters, numbers of sensors, and starts.

    **Arguments:** `of_runs`: as of `values_read`, with derivatives of the channels after these.
    """

    def one(scene: Scene, q: Array, seen: Channels, slopes: Channels, epoch: Real, at: Array) -> tuple[Array, Array]:
        p = values_of(scene, reader.names)
        # numbers of sensors change no channel
        none = lambda a: jnp.concatenate([a[: p.size], jnp.zeros((q.size, *a.shape[1:])), a[p.size :]])
        slopes = jax.tree.map(none, slopes)
        directions = slopes.motion.shape[0]
        read = lambda p, q, seen: reader(scene, p, q, seen, epoch, at)
        push = lambda *along: jax.jvp(read, (p, q, seen), along)
        each = jnp.eye(directions, p.size), jnp.eye(directions, q.size, -p.size), slopes
        return jax.vmap(push, out_axes=(None, 0))(*each)

    return scenes.map(one, *of_runs)
