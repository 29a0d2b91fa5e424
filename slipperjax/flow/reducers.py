"""Reducers by name: loads, accelerations, excursions, section points, strobe states, and any function."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..model.dang2024 import table_2_start
from ..model.dynamics import Args, State, state_and_penetration
from ..model.kinematics import contact_points
from ..model.quantities import ACCELERATIONS, COORDINATES, LOADS, SECTIONS
from ..model.scene import Scene
from ..tools.checks import brief, one_of, require, whole
from .poincare import highest_point
from .recorders import STROBE_VALUES, attributes, places, stacked
from .reducing import AbstractReducer, PeriodView, Stretch


@dataclass(frozen=True)
class PointLoad(AbstractReducer):
    """A load of each contact point over the recorded periods, one of `slipperjax.model.LOADS`.

    All five are found together, over every step and inside it: the second costs nothing.
    """

    load: str = "peak_force"

    def __post_init__(self):
        one_of("load", self.load, tuple(LOADS))

    @property
    def name(self):
        return self.load

    @property
    def variables(self):
        return (self.load,)

    @property
    def loads(self):
        return True

    def values(self, periods):
        return 20

    def finish(self, carried, stretch):
        found = np.asarray(getattr(stretch.loads, self.load))
        return found - stretch.start if self.load == "peak_period" else found

    def label(self, scene, dims, found):
        return {self.load: ((*dims, "end", "point"), found, LOADS[self.load].attributes)}, places(scene)


@dataclass(frozen=True)
class RMSAccelerations(AbstractReducer):
    """The root mean square of each of `slipperjax.model.ACCELERATIONS`, over the ends of all steps."""

    @property
    def name(self):
        return "rms"

    @property
    def variables(self):
        return tuple(f"rms_{name}" for name in ACCELERATIONS)

    @property
    def cost(self):
        return 0.02

    def values(self, periods):
        return len(ACCELERATIONS)

    def begin(self, scene, state):
        return np.zeros(len(ACCELERATIONS))

    def add(self, carried, period: PeriodView):
        return carried + jnp.sum(period.over_steps(period.acceleration**2, 0.0), axis=0)

    def finish(self, carried, stretch: Stretch):
        return np.sqrt(np.asarray(carried) / stretch.samples)

    def label(self, scene, dims, found):
        text = "root mean square of the"
        return {
            f"rms_{name}": (dims, found[..., k], attributes(q.unit, f"{text} {q.long_name}"))
            for k, (name, q) in enumerate(ACCELERATIONS.items())
        }, {}


@dataclass(frozen=True)
class Extremes(AbstractReducer):
    """The largest and the smallest value of each of `slipperjax.model.COORDINATES`, over every step and inside it."""

    @property
    def name(self):
        return "extremes"

    @property
    def variables(self):
        return tuple(f"{which}_{name}" for which in ("largest", "smallest") for name in COORDINATES)

    @property
    def cost(self):
        return 0.45

    def values(self, periods):
        return 2 * len(COORDINATES)

    def begin(self, scene, state):
        return np.full((2, len(COORDINATES)), -np.inf)

    def add(self, carried, period: PeriodView):
        one = lambda motion, rate: jax.jvp(lambda m: stacked(State(m, None)), (motion,), (rate,))
        values, slopes = jax.vmap(one)(period.states.motion, period.rates)
        both = jnp.stack([values, -values], axis=1), jnp.stack([slopes, -slopes], axis=1) / period.steps
        _, highest = highest_point(both[0][:-1], both[1][:-1], both[0][1:], both[1][1:])
        return jnp.maximum(carried, jnp.max(period.over_steps(highest, -jnp.inf), axis=0))

    def finish(self, carried, stretch):
        return np.asarray(carried) * np.array([1.0, -1.0])[:, None]

    def label(self, scene, dims, found):
        return {
            f"{which}_{name}": (dims, found[..., side, k], attributes(q.unit, f"{which} {q.long_name}"))
            for side, which in enumerate(("largest", "smallest"))
            for k, (name, q) in enumerate(COORDINATES.items())
        }, {}


class PointsFound(NamedTuple):
    """The first crossings of each section."""

    time: Float[Any, "*cases 5 crossings"]
    """Instants [forcing periods]; NaN where there are fewer."""
    velocity: Float[Any, "*cases 5 crossings"]
    """Velocities there [m/s], [rad/s], in the order of `slipperjax.model.SECTIONS`."""
    count: Int[Any, "*cases 5"]
    """How many crossings there were, also those beyond the first."""


@dataclass(frozen=True)
class SectionPoints(AbstractReducer):
    """Velocities at the first upward zero crossings of each coordinate, as many for every case.

    `crossings_<velocity>` says how many there were: where it is larger than `crossings`, some were dropped.
    """

    crossings: int = 64
    """Crossings of each section that are kept."""

    def __post_init__(self):
        whole("crossings", self.crossings, 1)

    @property
    def name(self):
        return "sections"

    @property
    def variables(self):
        return tuple(f"{before}{name}{behind}" for before, behind in _SECTION_NAMES for name in SECTIONS)

    @property
    def cost(self):
        return 0.5

    def values(self, periods):
        return len(SECTIONS) * (2 * self.crossings + 1)

    def begin(self, scene, state):
        none = np.full((len(SECTIONS), self.crossings), np.nan)
        return PointsFound(none, none, np.zeros(len(SECTIONS), int))

    def add(self, carried: PointsFound, period: PeriodView):
        time, velocity = period.crossings
        there = ~jnp.isnan(time)
        place = carried.count[:, None] + jnp.cumsum(there, axis=1) - 1
        place = jnp.where(there, place, self.crossings)  # beyond the last: dropped
        at = jnp.arange(len(SECTIONS))[:, None], place
        put = lambda room, new: room.at[at].set(new, mode="drop")
        return PointsFound(
            put(carried.time, time), put(carried.velocity, velocity), carried.count + jnp.sum(there, axis=1)
        )

    def finish(self, carried: PointsFound, stretch: Stretch):
        found = jax.tree.map(np.asarray, carried)
        return found._replace(time=found.time - stretch.start)

    def label(self, scene, dims, found: PointsFound):
        data = {}
        for k, (name, coordinate) in enumerate(SECTIONS.items()):
            q, across = COORDINATES[name], f"upward zero crossings of {COORDINATES[coordinate].long_name}"
            at, passed = f"{q.long_name} at {across}", f"forcing periods passed at {across}"
            data[name] = ((*dims, "crossing"), found.velocity[..., k, :], attributes(q.unit, at))
            data[f"{name}_period"] = ((*dims, "crossing"), found.time[..., k, :], attributes("1", passed))
            text = f"number of {across}, of which the first {self.crossings} are kept"
            data[f"crossings_{name}"] = (dims, found.count[..., k], attributes("1", text))
        return data, {}


_SECTION_NAMES = ("", ""), ("", "_period"), ("crossings_", "")


@dataclass(frozen=True)
class StrobeStates(AbstractReducer):
    """The states at the ends of the last forcing periods, as the variable `strobe`."""

    last: int | None = None
    """How many; None for all."""

    def __post_init__(self):
        if self.last is not None:
            whole("last", self.last, 1)

    @property
    def name(self):
        return "strobe"

    @property
    def variables(self):
        return ("strobe",)

    @property
    def inside(self):
        return False

    def strobes(self, periods):
        return periods if self.last is None else min(self.last, periods)

    def values(self, periods):
        return STROBE_VALUES * self.strobes(periods)

    def finish(self, carried, stretch: Stretch):
        assert stretch.strobe is not None  # it is asked for
        return stretch.strobe[:, -self.strobes(stretch.periods) :]

    def label(self, scene, dims, found):
        text = "; ".join(f"{name} [{q.unit}]" for name, q in COORDINATES.items())
        data = {
            "strobe": ((*dims, "strobe_period", "coordinate"), found, {"long_name": f"state once per period: {text}"})
        }
        numbers = np.arange(1 - found.shape[-2], 1)
        since = attributes("1", "forcing periods since the end of the record")
        return data, {"coordinate": list(COORDINATES), "strobe_period": ("strobe_period", numbers, since)}


_OVER: dict[str, tuple[Callable, float, str]] = {
    "max": (jnp.max, -np.inf, "greatest"),
    "min": (jnp.min, np.inf, "least"),
    "sum": (jnp.sum, 0.0, "sum of"),
    "mean": (jnp.sum, 0.0, "mean"),
}
"""Of each way to reduce: the function, its value of nothing, and words."""


@dataclass(frozen=True)
class Reduced(AbstractReducer):
    """Any JAX function of one instant, over the ends of all steps of the recorded periods.

    An objective of `slipperjax.design` is a function of a whole period's curves; this one sees one instant, and what
    happens between the ends of steps it does not see.
    """

    function: Callable[[Any, State, Args], Any]
    """Gives a real number, or an array of them, of the time since the start of the period [forcing periods], the
    state and `Args(scene, epoch)`, such as `lambda t, state, args: slipperjax.reactions(t, state, args).drive_force`.
    Another function, or the same text in another lambda, is compiled anew."""
    name: str = "reduced"  # pyright: ignore[reportIncompatibleMethodOverride, reportAssignmentType]
    """Its name in datasets."""
    units: str = "1"
    over: str = "max"
    """"max", "min", "sum" or "mean" over the steps."""
    text: str = ""
    """Description in a few words."""

    def __post_init__(self):
        require(callable(self.function), "function", "be a function of (t, state, args)", self.function)
        for name in ("name", "units", "text"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"Argument `{name}` must be a text, but is {brief(getattr(self, name))}.")
        try:
            hash(self.function)
        except TypeError:
            raise ValueError(f"Argument `function` must be hashable, but is {brief(self.function)}.") from None
        require(self.name.isidentifier(), "name", "be a name such as spring_force", self.name)
        one_of("over", self.over, tuple(_OVER))

    @property
    def variables(self):
        return (self.name,)

    @property
    def cost(self):
        return 0.2

    def values(self, periods):
        return 20

    def check(self, scene, periods, steps):
        try:
            state, _ = jax.eval_shape(state_and_penetration, scene, table_2_start())
            made = self._made(scene, state)
        except Exception as error:
            raise ValueError(
                f"Argument `function` of `{self.name}` must take (t, state, args), but raised "
                f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
            ) from error
        if not (isinstance(made, jax.ShapeDtypeStruct) and made.dtype.kind in "fiub"):
            raise ValueError(f"Argument `function` of `{self.name}` must give real numbers, but gives {brief(made)}.")

    def _made(self, scene: Scene, state: State) -> Any:
        """Shape and type of what the function gives."""
        return jax.eval_shape(self.function, 0.0, state, Args(scene, 0.0, jax.eval_shape(contact_points, scene)))

    def begin(self, scene, state):
        return np.full(self._made(scene, state).shape, _OVER[self.over][1])

    def add(self, carried, period: PeriodView):
        reduce, rest, _ = _OVER[self.over]
        values = jax.vmap(lambda t, state: self.function(t, state, period.args))(period.times, period.ends)
        now = reduce(period.over_steps(values.astype(float), rest), axis=0)
        return reduce(jnp.stack([carried, now]), axis=0)

    def finish(self, carried, stretch: Stretch):
        return np.asarray(carried) / (stretch.samples if self.over == "mean" else 1)

    def label(self, scene, dims, found):
        shape = found.shape[len(dims) :]
        at_points = shape == (2, scene.points // 2)
        more = ("end", "point") if at_points else tuple(f"{self.name}_{k}" for k in range(len(shape)))
        text = f"{_OVER[self.over][2]} {self.text or self.name}, over all steps"
        data = {self.name: ((*dims, *more), found, attributes(self.units, text))}
        return data, places(scene) if at_points else {}


REDUCERS: Mapping[str, AbstractReducer] = {
    **{name: PointLoad(name) for name in LOADS},
    "rms": RMSAccelerations(),
    "extremes": Extremes(),
    "sections": SectionPoints(),
    "strobe": StrobeStates(),
}
"""Reducers by the names that lists in `sweep(..., record=...)` know them by."""
