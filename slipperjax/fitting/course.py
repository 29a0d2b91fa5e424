"""The model's runs for a comparison with measured runs: windows of records, readings of sensors, and derivatives.

Channels are the quantities of a body's motion that sensors can read.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from ..analysis.environment import band_edges, window_densities
from ..flow.period_map import SlopePassage, advance, advance_slopes
from ..flow.record import Labelled, RecordSet, Unlabelled
from ..flow.status import heed_interrupts
from ..flow.stepping import SampledSteps
from ..model.dynamics import Args, State
from ..model.kinematics import MOTION_SCALES, Motion
from ..model.layout import StateLayout
from ..model.parameters import at_values, values_of
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene
from ..model.sensors import Channels, Rig, channels
from ..model.starts import state_and_penetration
from ..solvers.latching import calls_lapack
from ..sweeps.engine import gather
from ..sweeps.grid import VECTOR_LANES, Cases
from ..tools.batching import Batched
from ..tools.columns import column
from ..tools.compile import ahead, as_argument, jit
from ..tools.jacobian import slopes_along
from ..tools.limits import cores
from ..tools.types import Real
from .measured import FEWEST, MeasuredRun
from .method import Problem

SIZES = np.array([getattr(MOTION_SCALES, name) for name in MOTION_NUMBERS])
LANES = 4
"""Runs in one call with derivatives: few, so that a few searches use all cores."""
CALL = 10
"""Forcing periods in one call of the program that follows a motion without derivatives."""
SHIFTS = 8
"""Recurrences of the rail that are searched for a first guess."""


class Windows(NamedTuple):
    """Measured runs, cut into windows of equal length; arrays are filled up where there are fewer samples."""

    run: Int[np.ndarray, " windows"]
    """Index of the run of each window."""
    lag: Int[np.ndarray, " windows"]
    """Forcing periods from the beginning of the run to the beginning of the window."""
    periods: int
    """Forcing periods of each window."""
    time: Float[np.ndarray, "windows sensors samples"]
    """Times of the samples since the beginning of the run [s]."""
    value: Float[np.ndarray, "windows sensors samples"]
    known: Float[np.ndarray, "windows sensors samples"]
    """One for samples, and zero for places that fill up."""

    @classmethod
    def of(cls, problem: Problem, window: int | None = None) -> "Windows":
        """Cut the runs of a problem into windows.

        **Arguments:** `window`: forcing periods of each window, or fewer where runs are shorter; None: one window
        with the length of the longest run.
        """
        passed = [_passed(problem.origin, *both) for both in zip(problem.scenes, problem.runs, strict=True)]
        ends = np.array([np.concatenate(every).max() for every in passed])
        whole = np.maximum(np.ceil(ends - 2e-9), 1).astype(int)
        longest = int(whole.max())
        periods = min(window or longest, longest)
        counts = -(-whole // periods)
        run = np.repeat(np.arange(len(counts)), counts)
        number = np.concatenate([np.arange(count) for count in counts])
        parts = []
        for of, own in zip(run.tolist(), number.tolist(), strict=True):
            for signal, at in zip(problem.runs[of].signals, passed[of], strict=True):
                # a sample belongs to the window in which the model passes it
                inside = np.minimum(at // periods, counts[of] - 1) == own
                parts.append((signal.time[inside], signal.value[inside], np.ones(inside.sum())))
        most = max(len(time) for time, *_ in parts)
        filled = [[np.pad(array, (0, most - len(array))) for array in part] for part in parts]
        arrays = np.moveaxis(np.reshape(filled, (len(run), -1, 3, most)), 2, 0)
        return cls(run, number * periods, periods, *arrays)

    def densities(self, number: int, likely: Float[np.ndarray, "signals sensors samples"]) -> Labelled:
        """Return power spectral densities of the signals measured in a window, and of likely ones, in third octaves.

        **Returns:** no frequencies where no sensor has eight samples, the least number for a density.
        """
        known = self.known[number] > 0
        signals = np.array([self.value[number], *likely])
        times = enumerate(self.time[number])
        used = {k: time[known[k]] for k, time in times if known[k].sum() >= FEWEST}
        rates = {k: (len(at) - 1) / np.ptp(at) for k, at in used.items()}
        longest = max(map(np.ptp, used.values()), default=0.0)
        edges = np.ones(1)
        if used:
            top = max(rates.values()) / 2
            edges = band_edges(min(4.0 / longest, top / 4), top, per_octave=3)
        found = np.full((*signals.shape[:2], len(edges) - 1), np.nan)
        for k, at in used.items():
            # unequal samples become equal samples, in the same way for all signals
            grid = np.linspace(at[0], at[-1], len(at))
            equal = np.array([np.interp(grid, at, signal[k][known[k]]) for signal in signals])
            found[:, k] = window_densities(equal, rates[k], edges, window=longest)[1].mean(axis=-2)
        along = ("sensor", "frequency")
        text = "power spectral density, the square of the sensor's unit per Hz"
        data = {"measured_density": column(along, found[0], "", f"{text}, measured")}
        for name, share in (("density_low", 0.05), ("density", 0.5), ("density_high", 0.95)):
            values = np.quantile(found[1:], share, axis=0)
            data[name] = column(along, values, "", f"{text}, {share:.0%} of likely ones")
        middles = np.sqrt(edges[1:] * edges[:-1])
        return data, {"frequency": column("frequency", middles, "Hz", "middle of a band")}

    @property
    def count(self) -> int:
        return len(self.run)

    @property
    def number(self) -> Int[np.ndarray, " windows"]:
        """Number of each window in its run, from zero."""
        return self.lag // self.periods

    def first(self, count: int) -> "Windows":
        """Return the first windows of each run."""
        these = self.number < count
        return self._replace(**{name: getattr(self, name)[these] for name in self._fields if name != "periods"})


def _passed(origin: float, scene: Scene, run: MeasuredRun) -> list[np.ndarray]:
    """Return for each sensor the forcing periods from the beginning of the run to its samples."""
    since = lambda periods: np.asarray(scene.seconds(origin + periods) - scene.seconds(origin))
    end = max(one.time.max(initial=0.0) for one in run.signals)
    most = 1.0
    while since(most) <= end:
        most *= 2
    grid = np.linspace(0.0, most, 4097)
    times = since(grid)
    # rounding may put a sample slightly before its place
    return [np.interp(one.time, times, grid) + 1e-9 for one in run.signals]


@dataclass(frozen=True)
class ChannelRecord(Unlabelled):
    """The channels at equal distances in each forcing period; the last of them is the period's end."""

    samples: int

    @property
    def inside(self):
        return True

    def values(self, scene, periods):
        return 20 * self.samples * periods

    def sample(self, course) -> Channels:
        saved = course.saved(self.samples)
        instants = jnp.arange(1, self.samples + 1) / self.samples
        return jax.vmap(lambda t, state: channels(course.args, t, state))(instants, saved)


@functools.partial(jit, static_argnames=("names",))
def begin(
    scenes: Batched[Scene],
    starts: Motion | State,
    epoch: Float[Array, " runs"],
    carried: Float[Array, "runs size"] | None = None,
    *,
    names: tuple[str, ...],
) -> SlopePassage:
    """Return runs at their beginning, with the channels there as a sample of one instant.

    Derivatives are first with respect to the parameters, then to the ten numbers of the start's motion.

    **Arguments:** `starts`: motions whose closed contacts begin there; `epoch`: forcing periods from distance zero;
    `carried`: numbers of the states that differ from these, such as the memory of contacts that are closed already,
    and NaN for the others; `names`: of the parameters for derivatives of runs.
    """

    def one(scene: Scene, start: Motion | State, epoch: Real, carried: Array | None) -> SlopePassage:
        start = start if isinstance(start, State) else State(start, None)
        count = len(names)
        numbers = jnp.stack([getattr(start.motion, name) for name in MOTION_NUMBERS])
        both = jnp.concatenate([values_of(scene, names), numbers])

        def at(both: Array) -> tuple[State, Channels]:
            here = at_values(scene, names, both[:count])
            # a start at rest stays one
            motion = replace(start.motion, **dict(zip(MOTION_NUMBERS, both[count:], strict=True)))
            state, _ = state_and_penetration(here, State(motion, start.memory), epoch)
            if carried is not None:
                row, state_of = ravel_pytree(state)
                state = state_of(jnp.where(jnp.isnan(carried), row, carried))
            seen = channels(Args(here, epoch), 0.0, state)
            return state, jax.tree.map(lambda a: a[None], seen)

        (state, seen), (slopes, seen_slopes) = slopes_along(at, (both,), jnp.eye(both.size))
        return SlopePassage(state, jax.vmap(lambda slope: ravel_pytree(slope)[0])(slopes), (seen,), (seen_slopes,))

    return scenes.map(one, starts, epoch, carried)


class Course(NamedTuple):
    """Runs of the model, one for each start and window."""

    reading: Float[np.ndarray, "starts windows sensors samples"]
    slope: Float[np.ndarray, "starts windows sensors samples directions"]
    """Derivatives by the parameters, and by the ten numbers of the window's start in their scales."""
    last: Float[np.ndarray, "starts windows size"]
    """State at the beginning of the next window's run."""
    end_slope: Float[np.ndarray, "starts windows 10 directions"]
    """Derivatives of `end`."""

    @property
    def end(self) -> Float[np.ndarray, "starts windows 10"]:
        """Numbers of the motion at the beginning of the next window's run [scales]."""
        # the first numbers of a state belong to its motion
        return self.last[..., : len(SIZES)] / SIZES


@dataclass(frozen=True, kw_only=True)
class Model:
    """How the model reproduces the records of a fit, with other values of its parameters."""

    problem: Problem
    windows: Windows
    steps: int
    """Steps in each forcing period, a multiple of `samples`."""
    samples: int
    """Instants in each forcing period, between which signals are interpolated."""

    @classmethod
    def of(cls, problem: Problem, windows: Windows) -> "Model":
        """Return the model of a fit."""
        # steps for the scene's own values, and for the values in the middle of the priors
        samples = max(map(problem.needed, (problem.own, 0 * problem.own)))
        model = cls(problem=problem, windows=windows, steps=samples, samples=samples)
        return model.with_steps(problem.steps or samples)

    @property
    def stepping(self) -> SampledSteps:
        return SampledSteps(self.samples, as_argument(self.steps // self.samples))

    @property
    def _how(self) -> dict[str, object]:
        """Options with which programs follow runs and keep their channels."""
        records = RecordSet((ChannelRecord(self.samples),))
        return dict(stepping=self.stepping, records=records, solver=self.problem.solver)

    def with_steps(self, steps: int) -> "Model":
        """Return the same model with at least this number of steps per period."""
        steps = max(-(-steps // self.samples) * self.samples, self.steps)
        return self if steps == self.steps else replace(self, steps=steps)

    def with_samples(self, samples: int) -> "Model":
        """Return the same model with other instants, a multiple of the present number."""
        return replace(self, samples=samples).with_steps(self.steps)

    @property
    def centred(self) -> Motion:
        """A motion that has the parts of the problem's start, and no other numbers."""
        return Motion(payload=self.problem.motion.payload, modes=self.problem.motion.modes)

    @property
    def epoch(self) -> Float[np.ndarray, " windows"]:
        """Forcing periods from distance zero to the beginning of the model's run of each window."""
        return self.problem.origin - self.problem.lead + self.windows.lag

    def split(self, points: Float[np.ndarray, "starts unknowns"]) -> tuple[np.ndarray, np.ndarray]:
        """Return levels (starts, parameters) and numbers of the starts (starts, windows, 10) [scales] of points."""
        count = len(self.problem.unknowns)
        return points[:, :count], points[:, count:].reshape(len(points), self.windows.count, len(SIZES))

    def reader(self, samples: int, origin: float) -> Callable[..., tuple[Array, Array | None]]:
        """Return `readings` of runs with `samples` instants in each period, whose times count from `origin` [forcing
        periods from distance zero]."""
        problem = self.problem
        how = dict(names=problem.names, sensor_names=problem.sensor_names, samples=samples)
        return functools.partial(readings, problem.rig, origin, **how)

    def each(
        self,
        levels: Float[np.ndarray, "starts parameters"],
        numbers: Float[np.ndarray, "starts windows 10"] | None,
        lanes: int,
        work: Callable[..., list[np.ndarray]],
        *more: Float[np.ndarray, "starts windows *numbers"],
        **rails: np.ndarray,
    ) -> list[np.ndarray]:
        """Call `work(scenes, starts, windows, numbers of sensors, *more)` for the runs of all starts and windows.

        **Arguments:** `numbers`: of the motions with which runs begin [scales], None for the problem's motion;
        `lanes`: runs in one call; `more`: arrays of which each run gets its part; `rails`: numbers that choose the
        rail of each run.

        **Returns:** the arrays of `work`, (starts, windows, ...).
        """
        problem, windows, count = self.problem, self.windows, len(levels)
        values = problem.values(levels)
        total = count * windows.count
        grid = rails
        for name in dict.fromkeys(name for run in problem.runs for name in run.settings):
            own = float(problem.scene.value(name))
            grid[name] = np.tile([problem.runs[k].settings.get(name, own) for k in windows.run], count)
        grid |= {name: np.repeat(values[:, k], windows.count) for k, name in enumerate(problem.names)}
        # a grid needs at least one list
        grid |= {"start_y": np.full(total, float(problem.motion.y))}
        cases = Cases(problem.scene, grid, problem.start if numbers is None else self.centred, product=False)
        if numbers is not None:
            values_of_starts = (numbers.reshape(total, -1) * SIZES).T
            cases.starts = replace(cases.starts, **dict(zip(MOTION_NUMBERS, values_of_starts, strict=True)))
        window = np.tile(np.arange(windows.count), count)
        of_sensors = np.repeat(values[:, len(problem.names) :], windows.count, axis=0)
        of_runs = [window, of_sensors, *(a.reshape(total, *a.shape[2:]) for a in more)]
        # the last group is filled up with copies of the last case
        groups = np.minimum(np.arange(-(-total // lanes) * lanes), total - 1).reshape(-1, lanes)
        made: list[list[np.ndarray]] = [[]] * len(groups)

        def one(k: int) -> None:
            index = groups[k]
            made[k] = work(*cases.take(index), *(a[index] for a in of_runs))

        gather([functools.partial(one, k) for k in range(len(groups))], cores())
        every = [np.concatenate(arrays)[:total] for arrays in zip(*made, strict=True)]
        return [a.reshape(count, windows.count, *a.shape[1:]) for a in every]

    def course(
        self,
        points: Float[np.ndarray, "starts unknowns"],
        carried: Float[np.ndarray, "starts windows size"] | None = None,
        stride: int = 1,
    ) -> Course:
        """Run the model from some starts, and differentiate it.

        **Arguments:** `points`: see `split`; `carried`: see `begin`; `stride`: step between the instants from which
        signals are interpolated.
        """
        problem = self.problem
        reader = self.reader(self.samples // stride, problem.origin)
        if carried is None:
            carried = np.full((len(points), self.windows.count, self.size), np.nan)

        def work(scenes, starts, window, q, carried):
            epoch = self.epoch[window]
            how = dict(names=problem.names, **self._how)
            passed = [begin(scenes, starts, epoch, carried, names=problem.names)]
            for k in range(self.windows.periods + problem.lead):
                heed_interrupts()
                now = passed[-1]
                passed.append(advance_slopes(scenes, now.state, now.slopes, epoch + k, **how))
            (seen,) = jax.tree.map(
                lambda *parts: np.concatenate(parts, axis=1)[:, ::stride], *[one.samples for one in passed]
            )
            (slopes,) = jax.tree.map(
                lambda *parts: np.concatenate(parts, axis=2)[:, :, ::stride], *[one.sample_slopes for one in passed]
            )
            reading, slope = map(np.asarray, reader(scenes, q, seen, slopes, epoch, self.windows.time[window]))
            end = passed[self.windows.periods]
            end_slope = np.asarray(end.slopes)[..., : len(SIZES)]
            return [reading, np.moveaxis(slope, 1, -1), StateLayout.pack(end.state), np.moveaxis(end_slope, 1, -1)]

        reading, slope, last, end_slope = self.each(*self.split(points), LANES, work, carried)
        # the numbers of sensors do not move the body
        at = [len(problem.names)] * len(problem.sensor_names)
        end_slope = np.insert(end_slope, at, 0.0, axis=-1)
        for array in (slope, end_slope):
            array[..., -len(SIZES) :] *= SIZES
        return Course(reading, slope, last, end_slope / SIZES[:, None])

    @property
    def size(self) -> int:
        """Count of the numbers of a state."""
        return StateLayout.of(self.problem.scene).size

    @staticmethod
    def carried(rows: Float[np.ndarray, "starts windows size"]) -> Float[np.ndarray, "starts windows size"]:
        """Return states without their motions, which are unknown, as `course` takes them."""
        return np.concatenate([np.full_like(rows[..., : len(SIZES)], np.nan), rows[..., len(SIZES) :]], axis=-1)

    def start(self, numbers: Float[np.ndarray, "10"], carried: Float[np.ndarray, " size"]) -> Motion | State:
        """Return the start of a run that begins with some numbers [scales] and some `carried` ones, see `begin`."""
        motion = numbers * SIZES
        if np.isnan(carried).all():
            # closed contacts begin there
            return replace(self.centred, **dict(zip(MOTION_NUMBERS, motion, strict=True)))
        return StateLayout.of(self.problem.scene).unpack(np.append(motion, carried[len(SIZES) :]))

    def begun(self, levels: Float[np.ndarray, "starts parameters"]) -> Float[np.ndarray, "starts windows size"]:
        """Return the states of the problem's start at the beginning of windows."""
        names = self.problem.names
        work = lambda scenes, starts, window, q: [
            StateLayout.pack(begin(scenes, starts, self.epoch[window], names=names).state)
        ]
        return self.each(levels, None, VECTOR_LANES, work)[0]

    def compile_ahead(self) -> None:
        """Compile the program of derivatives, the longest program, while others are compiled and run."""
        # LAPACK must not be called from two threads
        if not calls_lapack(self.problem.solver):
            point = np.zeros((1, len(self.problem.unknowns) + self.windows.count * len(SIZES)))
            # zero steps
            ahead(lambda: replace(self, steps=0).course(point))

    def guesses(
        self, levels: Float[np.ndarray, "starts parameters"], transient: int, noise: Float[np.ndarray, " sensors"]
    ) -> tuple[Float[np.ndarray, "starts windows 10"], Float[np.ndarray, " starts"]]:
        """Return motions with which the windows may begin [scales], and their distance from the samples.

        For each start, these are the states of its settled motion after which the next periods are most similar to
        the record, on a rail that recurs.
        """
        windows, problem = self.windows, self.problem
        every = max(int(problem.scene.recurrence), 1)
        shifts = np.arange(SHIFTS) * every
        settle = -(-transient // every) * every
        length = windows.periods + problem.lead
        total = settle + int(windows.lag.max() + shifts[-1]) + length
        reader = self.reader(self.samples, problem.origin)
        first = problem.origin - problem.lead

        def work(scenes, starts, window, q):
            # begin as runs do, at the beginning of the model's first run
            now = begin(scenes, starts, np.full(len(window), first), names=problem.names)
            seen = self.followed(scenes, now, first, settle, total)
            best = np.full(len(window), np.inf)
            numbers = np.zeros((len(window), len(SIZES)))
            for shift in shifts:
                place = (windows.lag[window] + shift) * self.samples
                at = place[:, None] + np.arange(length * self.samples + 1)
                part = jax.tree.map(lambda a, at=at: a[np.arange(len(a))[:, None], at], seen)
                reading, _ = reader(scenes, q, part, None, self.epoch[window], windows.time[window])
                off = (np.asarray(reading) - windows.value[window]) / noise[:, None] * windows.known[window]
                far = np.sum(off**2, axis=(1, 2))
                better = far < best
                best[better] = far[better]
                numbers[better] = part.motion[better, 0] / SIZES
            return [numbers, best]

        numbers, far = self.each(levels, None, VECTOR_LANES, work)
        return numbers, far.sum(axis=1)

    def followed(self, scenes: Batched[Scene], now: SlopePassage, epoch: float, settle: int, total: int) -> Channels:
        """Return the channels of motions after `settle` of `total` forcing periods, (lanes, instants, ...).

        **Arguments:** `now`: the beginning of the motions, `epoch` forcing periods from distance zero.
        """
        states = now.state
        kept = [now.samples[0]]
        how = dict(periods=CALL, **self._how)
        passed = 0
        while passed < total:
            heed_interrupts()
            used = min(CALL, (settle if passed < settle else total) - passed)
            ran = advance(scenes, states, epoch + passed, used=as_argument(used), **how)
            states = ran.state
            # periods and samples in one row, without unused periods
            row = lambda a, used=used: np.asarray(a)[:, :used].reshape(len(a), used * self.samples, *a.shape[3:])
            kept.append(jax.tree.map(row, ran.samples[0]))
            passed += used
            # while the motion settles, only the last instant counts
            if passed <= settle:
                kept = [jax.tree.map(lambda a: a[:, -1:], kept[-1])]
        return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *kept)


@functools.partial(jit, static_argnames=("names", "sensor_names", "samples"))
def readings(
    rig: Rig,
    origin: Real,
    scenes: Batched[Scene],
    *of_runs: PyTree,
    names: tuple[str, ...],
    sensor_names: tuple[str, ...],
    samples: int,
) -> tuple[Float[Array, "runs sensors samples"], Float[Array, "runs directions sensors samples"] | None]:
    """Return the readings of sensors in some runs, and derivatives by parameters, numbers of sensors, and starts.

    **Arguments:** `origin`: forcing periods from distance zero to the zero of times; `of_runs`: numbers of the
    sensors; channels, and their derivatives, or None for no derivatives; epochs of the beginning, and times of each
    run; `names`, `sensor_names`: of the parameters and of the sensors' numbers; `samples`: instants in each period.
    """

    def one(
        scene: Scene, q: Array, seen: Channels, slopes: Channels | None, epoch: Real, at: Array
    ) -> tuple[Array, Array | None]:
        instants = epoch + jnp.arange(seen.motion.shape[0]) / samples

        def read(p: Array, q: Array, seen: Channels) -> Array:
            here = at_values(scene, names, p)
            time = here.seconds(instants) - here.seconds(origin)
            sensors = at_values(rig, sensor_names, q).sensors
            return jnp.stack([one.read(seen, time, at[k], here.slipper.modes) for k, one in enumerate(sensors)])

        p = values_of(scene, names)
        if slopes is None:
            return read(p, q, seen), None
        # numbers of sensors do not change channels
        none = lambda a: jnp.concatenate([a[: p.size], jnp.zeros((q.size, *a.shape[1:])), a[p.size :]])
        every = jax.tree.map(none, slopes)
        directions = every.motion.shape[0]
        each = jnp.eye(directions, p.size), jnp.eye(directions, q.size, -p.size), every
        return slopes_along(read, (p, q, seen), *each)

    return scenes.map(one, *of_runs)
