"""Records of samples over time: strobes, Poincare sections, histories, and loads of each period."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..model.dynamics import State, reactions
from ..model.kinematics import Motion
from ..model.layout import coordinate_rows, coordinates
from ..model.quantities import ACCELERATIONS, COORDINATES, REACTIONS, SECTIONS
from ..tools.checks import require, whole
from .course import Loads
from .record import AbstractRecord, Unlabelled, attributes, point_labels
from .status import Status


@dataclass(frozen=True)
class Strobe(AbstractRecord):
    """The state at the end of each forcing period, as the variable `strobe`. Nothing is stored inside periods."""

    from_start: bool = False
    """Whether states of the transient are kept, too."""
    latest: int | None = None
    """How many of the recorded periods are kept at their end; None for all."""

    name = "strobe"
    inside = False

    def __post_init__(self):
        if self.latest is not None:
            whole("latest", self.latest, 1)

    def values(self, periods):
        return len(COORDINATES) * self.last(periods)

    def last(self, periods):
        return periods if self.latest is None else min(self.latest, periods)

    def sample(self, course) -> Motion:
        # as it is: Euler angles made here would be fused with the step, which then rounds differently in each batch
        return course.end.motion

    def finish(self, carried, samples: Motion, span):
        return coordinates(State(samples, None))

    def label(self, scene, dims, values: Float[Any, "*cases periods coordinates"]):
        text = "; ".join(f"{name} [{q.unit}]" for name, q in COORDINATES.items())
        words = {"long_name": f"state once per period: {text}"}
        numbers = np.arange(1 - values.shape[-2], 1)
        since = attributes("1", "forcing periods since the end of the record")
        coords = {"coordinate": list(COORDINATES), "strobe_period": ("strobe_period", numbers, since)}
        return {"strobe": ((*dims, "strobe_period", "coordinate"), values, words)}, coords


class SectionPoints(NamedTuple):
    """Points of all sections, in the order of `slipperjax.model.SECTIONS`; NaN where there are fewer crossings."""

    time: Float[Any, "*cases 5 crossings"]  # [forcing periods]
    velocity: Float[Any, "*cases 5 crossings"]  # [m/s], [rad/s]
    count: Int[Any, "*cases 5"]
    """How many crossings there were, also those that were not kept."""


@dataclass(frozen=True)
class Sections(AbstractRecord):
    """Poincare sections: velocities at the upward zero crossings of each coordinate, and when they were.

    `crossings_<velocity>` says how many there were. Where a period has more of them than `capacity`, its later ones
    are dropped, and the case gets the status "points dropped".
    """

    capacity: int = 8
    """Crossings of each coordinate that are kept of a forcing period; one or two are usual."""

    def __post_init__(self):
        whole("capacity", self.capacity, 1)

    name = "sections"

    @property
    def variables(self):
        return tuple(f"{before}{name}{behind}" for before, behind in _SECTION_NAMES for name in SECTIONS)

    def values(self, periods):
        return len(SECTIONS) * 2 * self.capacity * periods

    def begin(self, scene, state):
        return np.zeros((), int)

    def add(self, carried, course):
        return jnp.maximum(carried, jnp.max(jnp.sum(~jnp.isnan(course.crossings.time), axis=1)))

    def sample(self, course) -> SectionPoints:
        time, velocity = course.crossings
        crossed = ~jnp.isnan(time)
        # the crossings to the front; those beyond the capacity fall out
        place = jnp.where(crossed, jnp.cumsum(crossed, axis=1) - 1, self.capacity)
        at = jnp.arange(len(SECTIONS))[:, None], place
        none = jnp.full((len(SECTIONS), self.capacity), jnp.nan)
        packed = lambda values: none.at[at].set(values, mode="drop")
        return SectionPoints(packed(time), packed(velocity), jnp.sum(crossed, axis=1))

    def after(self, carried, samples, status, run):
        dropped = (np.asarray(carried) > self.capacity) & (status == Status.FINITE)
        return carried, np.where(dropped, int(Status.POINTS_DROPPED), status)

    def finish(self, carried, samples: SectionPoints, span) -> SectionPoints:
        in_time = lambda a: np.moveaxis(a, 1, 2).reshape(a.shape[0], a.shape[2], -1)
        time, velocity = in_time(samples.time), in_time(samples.velocity)
        # crossings to the front
        order = np.argsort(np.isnan(velocity), axis=-1, kind="stable")
        time, velocity = (np.take_along_axis(a, order, axis=-1) for a in (time, velocity))
        return SectionPoints(time - span.start, velocity, np.sum(samples.count, axis=1))

    def label(self, scene, dims, values: SectionPoints):
        most = max(int(np.max(np.sum(~np.isnan(values.velocity), axis=-1), initial=0)), 1)
        data = {}
        for k, (name, coordinate) in enumerate(SECTIONS.items()):
            q, across = COORDINATES[name], f"upward zero crossings of {COORDINATES[coordinate].long_name}"
            # results on disk have a capacity for as many crossings as could be
            capacity = {"capacity": values.time.shape[-1]}
            for suffix, of, unit, text in (
                ("", values.velocity, q.unit, f"{q.long_name} at {across}"),
                ("_period", values.time, "1", f"forcing periods passed at {across}"),
            ):
                data[f"{name}{suffix}"] = ((*dims, "crossing"), of[..., k, :most], attributes(unit, text) | capacity)
            data[f"crossings_{name}"] = (dims, values.count[..., k], attributes("1", f"number of {across}"))
        return data, {}


_SECTION_NAMES = ("", ""), ("", "_period"), ("crossings_", "")


class HistoryValues(NamedTuple):
    """States, accelerations, contact forces, gaps and drive force at constant intervals, as datasets have them."""

    states: Float[Any, "*cases saves coordinates"]
    period: Float[Any, "*cases saves"]
    acceleration: Float[Any, "*cases saves accelerations"]
    contact_force: Float[Any, "*cases saves 2 points"]
    gap: Float[Any, "*cases saves 2 points"]
    drive_force: Float[Any, "*cases saves"]


@dataclass(frozen=True)
class History(AbstractRecord):
    """States, accelerations, contact forces, gaps and drive force `saves` times per period."""

    saves: int | None = None
    """A divisor of the steps per period; None for the run's `saves_per_period`."""

    name = "history"

    def with_saves(self, saves):
        return History(saves) if self.saves is None else self

    def check(self, scene, periods, steps):
        divides = self.saves is not None and steps % self.saves == 0
        require(divides, "saves", f"divide the {steps} steps per period", self.saves)

    @property
    def variables(self):
        return (*COORDINATES, *ACCELERATIONS, *_INNER_DIMS)

    def values(self, periods):
        return 57 * (self.saves or 1) * periods

    def sample(self, course) -> HistoryValues:
        assert self.saves is not None  # see `check`
        saved = course.saved(self.saves)
        period = jnp.arange(1, self.saves + 1) / self.saves
        now = jax.vmap(lambda t, s: reactions(t, s, course.args))(period, saved)
        forces = now.contact_force, now.gap, now.drive_force
        return HistoryValues(coordinate_rows(saved), period + course.args.epoch, now.acceleration, *forces)

    def finish(self, carried, samples: HistoryValues, span) -> HistoryValues:
        joined = jax.tree.map(lambda a: a.reshape(a.shape[0], -1, *a.shape[3:]), samples)
        return joined._replace(period=joined.period - span.start)

    def label(self, scene, dims, values: HistoryValues):
        data: dict[str, Any] = {}
        for quantities, rows in ((COORDINATES, values.states), (ACCELERATIONS, values.acceleration)):
            for k, (name, q) in enumerate(quantities.items()):
                data[name] = ((*dims, "time"), rows[..., k], q.attributes)
        for name, inner in _INNER_DIMS.items():
            data[name] = ((*dims, "time", *inner), getattr(values, name), REACTIONS[name].attributes)
        # the same for all cases, but NaN for those that were not run
        period = np.fmin.reduce(values.period.reshape(-1, values.period.shape[-1]))
        coords = {"period": ("time", period, attributes("1", "time in forcing periods"))}
        return data, coords | point_labels(scene)


_INNER_DIMS = {"contact_force": ("end", "point"), "gap": ("end", "point"), "drive_force": ()}


@dataclass(frozen=True)
class States(Unlabelled):
    """The states `saves` times per period, as they are."""

    saves: int = 1

    @property
    def inside(self):
        return self.saves > 1

    def values(self, periods):
        return 100 * self.saves * periods  # with the forces that follow from them

    def sample(self, course):
        return course.saved(self.saves)


@dataclass(frozen=True)
class PeriodLoads(Unlabelled):
    """The contact loads of each period."""

    def values(self, periods):
        return 100 * periods

    def sample(self, course) -> Loads:
        return course.loads
