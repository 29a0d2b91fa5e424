"""Base classes of records, several records as one, and records of samples: strobes, Poincare sections and histories.

A record gets the course of each forcing period inside the compiled program, and keeps what a dataset needs. A record
may carry numbers from period to period, so that its result has one size for runs of any length (peaks, means). Or it
samples each period, and the samples are joined in the order of time. After the run it labels its arrays for datasets.
"""

import abc
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Float, Int, PyTree

from ..model.dynamics import State, reactions
from ..model.kinematics import Motion
from ..model.layout import coordinate_rows, coordinates
from ..model.quantities import ACCELERATIONS, COORDINATES, REACTIONS, SECTIONS
from ..model.scene import Scene
from ..tools.batching import Batched
from ..tools.checks import require, whole, yes_or_no
from ..tools.columns import column
from ..tools.types import AnyArray, Real
from .course import Course
from .status import Status

Labelled = tuple[dict[str, Any], dict[str, Any]]
"""Data variables and coordinates of a dataset, in the form that xarray takes."""


class RecordedSpan(NamedTuple):
    """The recorded periods of a chunk of cases, passed to records after the run."""

    periods: int
    """Number of forcing periods."""
    steps: int
    """Integration steps in each period."""
    start: float
    """Forcing periods from distance zero to the beginning of the recorded periods."""
    status: Int[np.ndarray, " cases"]
    """`slipperjax.Status` codes."""
    scenes: Batched[Scene] | None = None
    """The scenes with which a chunk of cases began; None for a single orbit."""
    states: State | None = None
    """The states at the end; None for a single orbit."""


class AbstractOutput(abc.ABC):
    """Values of each case that become variables of a dataset."""

    name: str
    """The name in the attribute `record` of datasets."""
    each_period: bool = False
    """Whether it has values of each recorded period, on the first axis after the cases, or of all together."""

    @property
    def variables(self) -> tuple[str, ...]:
        """The names of its data variables."""
        return (self.name,)

    @abc.abstractmethod
    def values(self, scene: Scene, periods: int) -> int:
        """Return about how many numbers are kept for one case in `periods`; only shapes of the scene count."""

    def check(self, scene: Scene, periods: int, steps: int) -> None:  # noqa: B027
        """Raise `ValueError` for an unsuitable run: of `periods` recorded periods of at least `steps` steps."""

    @abc.abstractmethod
    def label(self, scene: Scene, dims: tuple[str, ...], values: PyTree) -> Labelled:
        """Return a dataset's variables and coordinates, from its arrays of shape (*grid, ...)."""


class AbstractRecord(AbstractOutput):
    """Values to keep of each case of a run.

    Subclasses are frozen dataclasses, so that equal records share a compiled program. A record that carries numbers
    from period to period defines `begin` and `add`; a record that samples each period defines `sample`; both define
    `finish` and `label`. For a chunk of cases, the order of calls is `begin`, then `add` and `sample` in each period,
    then `judge` and `finish`; `label` comes last, with the results of all chunks.
    """

    inside: bool = True
    """Whether it uses states inside periods, and not only at their ends."""
    waves: bool = False
    """Whether it uses the waves of rails that bend, and not only the deflections at the track nodes."""
    from_start: bool = False
    """Whether it also samples the periods before the recorded periods."""
    goes_on: bool = False
    """Whether the next stretch of a run continues with its carry."""

    def last(self, periods: int) -> int:
        """Return for how many periods at the end of the recorded periods samples must be kept."""
        return periods

    def begin(self, scene: Scene, state: State) -> PyTree:
        """Return the initial carry of one case, in NumPy arrays; None where nothing is carried.

        **Arguments:** `scene`, `state`: of a case; only their shapes may be used.
        """
        return None

    def add(self, carried: PyTree, course: Course) -> PyTree:
        """Return the carry after one more period, inside the compiled program."""
        return carried

    def sample(self, course: Course) -> PyTree:
        """Return the arrays that are kept for each period, inside the compiled program; None where there are none."""
        return None

    def feed_back(self, scene: Scene, carried: PyTree, epoch: Real) -> Scene:
        """Return the scene for the period number `epoch`, changed by values of earlier periods in the carry."""
        return scene

    def judge(
        self, carried: PyTree, status: np.ndarray, scenes: Batched[Scene], solver: AbstractSolver
    ) -> np.ndarray:
        """Return the `Status` codes (cases,) of a chunk after the recorded span."""
        return status

    @abc.abstractmethod
    def finish(self, carried: PyTree, samples: PyTree, span: RecordedSpan) -> PyTree:
        """Return arrays (cases, ...) from the carry (cases, ...) and samples (cases, periods, ...)."""


class Unlabelled(AbstractRecord):
    """A record without variables in datasets; callers use its samples directly."""

    name = ""
    goes_on = True

    @property
    def variables(self):
        return ()

    def finish(self, carried, samples, span):
        return samples

    def label(self, scene, dims, values):
        return {}, {}


@dataclass(frozen=True)
class RecordSet:
    """Several records of the same run. Carries and samples are tuples with one entry for each record."""

    records: tuple[AbstractRecord, ...] = ()

    @property
    def inside(self) -> bool:
        """Whether any record uses states inside periods."""
        return any(r.inside for r in self.records)

    @property
    def view(self) -> Callable[[State], State] | None:
        """Returns what the records use of a state inside periods; None where they use nothing."""
        if not self.inside:
            return None
        return (lambda state: state) if any(r.waves for r in self.records) else State.at_nodes

    @property
    def from_start(self) -> "RecordSet":
        """The records that also sample the transient."""
        return RecordSet(tuple(r for r in self.records if r.from_start))

    @property
    def feeds_back(self) -> bool:
        """Whether any record changes the scene by values that earlier periods left in its carry."""
        return any(type(r).feed_back is not AbstractRecord.feed_back for r in self.records)

    def renewed(self, carried: tuple[PyTree, ...], begun: tuple[PyTree, ...]) -> tuple[PyTree, ...]:
        """Return the carries for the beginning of the next stretch, from this stretch's and a beginning's carries."""
        parts = zip(self.records, carried, begun, strict=True)
        return tuple(mine if r.goes_on else new for r, mine, new in parts)

    def begin(self, scene: Scene, state: State) -> tuple[PyTree, ...]:
        """Return initial carries of one case."""
        return tuple(r.begin(scene, state) for r in self.records)

    def add(self, carried: tuple[PyTree, ...], course: Course) -> tuple[PyTree, ...]:
        """Return the carries after one more period."""
        return tuple(r.add(mine, course) for r, mine in zip(self.records, carried, strict=True))

    def sample(self, course: Course) -> tuple[PyTree, ...]:
        """Return the arrays that are kept for each period."""
        return tuple(r.sample(course) for r in self.records)

    def feed_back(self, scene: Scene, carried: tuple[PyTree, ...], epoch: Real) -> Scene:
        """Return the scene for the period number `epoch`, changed by values of earlier periods in the carries."""
        # one after the other, because each may change the scene
        for r, mine in zip(self.records, carried, strict=True):
            scene = r.feed_back(scene, mine, epoch)
        return scene

    def judge(
        self, carried: tuple[PyTree, ...], status: np.ndarray, scenes: Batched[Scene], solver: AbstractSolver
    ) -> np.ndarray:
        """Return the `Status` codes (cases,) of a chunk after the recorded span."""
        for r, mine in zip(self.records, carried, strict=True):
            status = r.judge(mine, status, scenes, solver)
        return status

    def finish(
        self,
        carried: tuple[PyTree, ...],
        samples: tuple[PyTree, ...],
        span: RecordedSpan,
    ) -> tuple[PyTree, ...]:
        """Return the arrays of each record, with a leading axis of cases."""
        parts = zip(self.records, carried, samples, strict=True)
        return tuple(r.finish(mine, kept, span) for r, mine, kept in parts)


class Samples:
    """Samples of records from successive calls of a program, kept outside of JAX as long as they are needed."""

    def __init__(self, records: RecordSet, periods: int):
        """**Arguments:** `periods`: number of recorded periods in all calls together."""
        self._periods = periods
        self._calls: dict[AbstractRecord, deque[PyTree]] = {r: deque() for r in records.records}
        self._held = dict.fromkeys(records.records, 0)
        """Number of periods for which each record needs samples."""

    def add(self, records: RecordSet, samples: tuple[PyTree, ...]) -> None:
        """Add the samples that some records took in one call, arrays (cases, periods, ...)."""
        for r, new in zip(records.records, samples, strict=True):
            calls = self._calls[r]
            calls.append(new)
            self._held[r] += _periods_in(new)
            # earlier calls are dropped when later calls have all needed periods, to save memory
            while not r.from_start and self._held[r] - _periods_in(calls[0]) >= r.last(self._periods):
                self._held[r] -= _periods_in(calls.popleft())

    def joined(self) -> tuple[PyTree, ...]:
        """Return each record's samples in the order of time."""
        found = []
        for record, calls in self._calls.items():
            # the earliest kept call may have more periods than needed
            last = slice(None) if record.from_start else slice(-record.last(self._periods), None)
            end_to_end = lambda *parts, last=last: np.concatenate(parts, axis=1)[:, last]
            found.append(jax.tree.map(end_to_end, *calls) if calls else None)
        return tuple(found)


def _periods_in(call: PyTree) -> int:
    """Return the number of sampled periods in a call."""
    # all arrays of a sample have the same periods, so that the first array is enough
    return sum(leaf.shape[1] for leaf in jax.tree.leaves(call)[:1])


# --- records of samples ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Strobe(AbstractRecord):
    """The state at the end of each forcing period, as the variable `strobe`. States inside periods are not stored."""

    from_start: bool = False
    """Whether the states of the transient are also kept."""

    name = "strobe"
    inside = False

    def __post_init__(self):
        yes_or_no("from_start", self.from_start)

    def values(self, scene, periods):
        return len(COORDINATES) * periods

    def sample(self, course) -> Motion:
        # Euler angles are computed after the run. Here XLA would fuse them with the step, and the last digits of
        # results would depend on the size of the batch.
        return course.end.motion

    def finish(self, carried, samples: Motion, span):
        return coordinates(State(samples, None))

    def label(self, scene, dims, values: Float[AnyArray, "*cases periods coordinates"]):
        text = "; ".join(f"{name} [{q.unit}]" for name, q in COORDINATES.items())
        strobe = column(
            (*dims, "strobe_period", "coordinate"),
            values,
            "",
            f"state once per period: {text}",
        )
        # 0 for the last state, -1 for the state before
        numbers = np.arange(1 - values.shape[-2], 1)
        period = column("strobe_period", numbers, "1", "forcing periods since the end of the record")
        return {"strobe": strobe}, {"coordinate": list(COORDINATES), "strobe_period": period}


class SectionPoints(NamedTuple):
    """Points of all sections, in the order of `slipperjax.model.SECTIONS`; NaN after a section's last crossing."""

    time: Float[AnyArray, "*cases 5 crossings"]  # [forcing periods]
    velocity: Float[AnyArray, "*cases 5 crossings"]  # [m/s], [rad/s]
    count: Int[AnyArray, "*cases 5"]
    """Number of crossings, including crossings that were not kept."""


@dataclass(frozen=True)
class PoincareSections(AbstractRecord):
    """Poincare sections: the velocity at each upward zero crossing of a coordinate, and the instant.

    The variables `crossings_<velocity>` are the numbers of crossings. Where a forcing period has more than `capacity`
    crossings, the later ones are dropped, and the case gets the status "points dropped".
    """

    capacity: int = 8
    """Number of crossings of each coordinate that are kept in a forcing period; usually there are one or two."""

    def __post_init__(self):
        whole("capacity", self.capacity, 1)

    name = "sections"

    @property
    def variables(self):
        return tuple(form.format(name) for form in ("{}", "{}_period", "crossings_{}") for name in SECTIONS)

    def values(self, scene, periods):
        return len(SECTIONS) * 2 * self.capacity * periods

    def begin(self, scene, state):
        return np.zeros((), int)

    def add(self, carried, course):
        # the greatest number of crossings of a coordinate in any period; `judge` compares it with the capacity
        return jnp.maximum(carried, jnp.max(jnp.sum(~jnp.isnan(course.crossings.time), axis=1)))

    def sample(self, course) -> SectionPoints:
        time, velocity = course.crossings
        crossed = ~jnp.isnan(time)
        # Most steps have no crossing. The k-th crossing goes to place k; steps without one, and crossings beyond the
        # capacity, go to a place that does not exist, and are dropped.
        place = jnp.where(crossed, jnp.cumsum(crossed, axis=1) - 1, self.capacity)
        at = jnp.arange(len(SECTIONS))[:, None], place
        none = jnp.full((len(SECTIONS), self.capacity), jnp.nan)
        packed = lambda values: none.at[at].set(values, mode="drop")
        return SectionPoints(packed(time), packed(velocity), jnp.sum(crossed, axis=1))

    def judge(self, carried, status, scenes, solver):
        dropped = (np.asarray(carried) > self.capacity) & (status == Status.FINITE)
        return np.where(dropped, int(Status.POINTS_DROPPED), status)

    def finish(self, carried, samples: SectionPoints, span) -> SectionPoints:
        # from (cases, periods, sections, crossings) to (cases, sections, all crossings)
        both = samples.time, samples.velocity
        time, velocity = (np.moveaxis(a, 1, 2).reshape(a.shape[0], a.shape[2], -1) for a in both)
        # crossings move to the front, and NaN of unused places to the end; "stable" keeps the order of time
        order = np.argsort(np.isnan(velocity), axis=-1, kind="stable")
        time, velocity = (np.take_along_axis(a, order, axis=-1) for a in (time, velocity))
        return SectionPoints(time - span.start, velocity, np.sum(samples.count, axis=1))

    def label(self, scene, dims, values: SectionPoints):
        # as many columns as the case with the most crossings needs
        most = int(np.max(np.sum(~np.isnan(values.velocity), axis=-1), initial=1))
        # arrays in stores have places for the greatest possible number of crossings
        capacity = values.time.shape[-1]
        along = (*dims, "crossing")
        data = {}
        for k, (name, coordinate) in enumerate(SECTIONS.items()):
            q = COORDINATES[name]
            across = f"upward zero crossings of {COORDINATES[coordinate].long_name}"
            velocity = values.velocity[..., k, :most]
            time = values.time[..., k, :most]
            instant = f"forcing periods passed at {across}"
            data[name] = column(along, velocity, q.unit, f"{q.long_name} at {across}", capacity=capacity)
            data[f"{name}_period"] = column(along, time, "1", instant, capacity=capacity)
            data[f"crossings_{name}"] = column(dims, values.count[..., k], "1", f"number of {across}")
        return data, {}


class HistoryValues(NamedTuple):
    """States, accelerations, contact forces, gaps and drive force at constant intervals, as datasets have them."""

    states: Float[AnyArray, "*cases saves coordinates"]
    period: Float[AnyArray, "*cases saves"]
    acceleration: Float[AnyArray, "*cases saves accelerations"]
    contact_force: Float[AnyArray, "... 2 points"]
    gap: Float[AnyArray, "... 2 points"]
    drive_force: Float[AnyArray, "*cases saves"]


@dataclass(frozen=True)
class History(AbstractRecord):
    """States, accelerations, contact forces, gaps and drive force `saves` times per period."""

    saves: int | None = None
    """Number of saves per forcing period, a divisor of the steps per period; None for the run's
    `saves_per_period`."""

    name = "history"

    def __post_init__(self):
        if self.saves is not None:
            whole("saves", self.saves, 1)

    def check(self, scene, periods, steps):
        divides = self.saves is not None and steps % self.saves == 0
        require(divides, "saves", f"divide the {steps} steps per period", self.saves)

    @property
    def variables(self):
        return (*COORDINATES, *ACCELERATIONS, *REACTIONS)

    def values(self, scene, periods):
        alone = len(COORDINATES) + len(ACCELERATIONS) + 2  # with time and drive force
        return (alone + 2 * scene.points) * (self.saves or 1) * periods

    def sample(self, course) -> HistoryValues:
        assert self.saves is not None  # see `check`
        saved = course.saved(self.saves)
        period = jnp.arange(1, self.saves + 1) / self.saves
        now = jax.vmap(lambda t, s: reactions(t, s, course.args))(period, saved)
        return HistoryValues(
            coordinate_rows(saved),
            period + course.args.epoch,
            now.acceleration,
            now.contact_force,
            now.gap,
            now.drive_force,
        )

    def finish(self, carried, samples: HistoryValues, span) -> HistoryValues:
        # from (cases, periods, saves, ...) to (cases, all saves, ...)
        joined = jax.tree.map(lambda a: a.reshape(a.shape[0], -1, *a.shape[3:]), samples)
        return joined._replace(period=joined.period - span.start)

    def label(self, scene, dims, values: HistoryValues):
        # one column for each coordinate and acceleration, then the forces and gaps
        rows = np.concatenate([values.states, values.acceleration], axis=-1)
        data = {}
        for k, (name, q) in enumerate((COORDINATES | ACCELERATIONS).items()):
            data[name] = column((*dims, "time"), rows[..., k], q.unit, q.long_name)
        for name, q in REACTIONS.items():
            inner = () if name == "drive_force" else tuple(scene.point_labels)
            data[name] = column((*dims, "time", *inner), getattr(values, name), q.unit, q.long_name)
        # all cases have the same instants, or NaN where they were not run: one coordinate for all
        period = np.fmin.reduce(values.period.reshape(-1, values.period.shape[-1]))
        return data, {"period": column("time", period, "1", "time in forcing periods")} | scene.point_labels
