"""Reducing periods to a few numbers per case while they are integrated: what reducers are, and several as one."""

import abc
import functools
import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.dynamics import Args, State, contact_forces
from ..model.kinematics import Motion, contacts
from ..model.scene import Scene
from .loads import Loads, contact_loads, over_periods
from .poincare import Crossings, motion_rates_at, section_crossings
from .recorders import STROBE_VALUES, AbstractRecorder, Labelled, coordinates, joined_in_time, stacked
from .status import first_problem

INSIDE = 1.05
"""What a period costs whose states inside are stored, in plain ones, before anything is made of them: measured."""
LOADS_COST = 1.3
"""What the contact loads of a period cost beside, in plain ones: measured."""


class PeriodView:
    """One integrated forcing period, as reducers see it, inside the compiled program.

    What follows from its states is computed where it is first asked for, once for all who ask. Arrays over steps have
    room for more of them than there are, see `taken`.
    """

    def __init__(self, states: State, args: Args, steps: Any, rates: Motion | None = None):
        """**Arguments:** as of a recorder's call: states and rates at both ends of every step."""
        self.states, self.args, self.steps, self._rates = states, args, steps, rates

    @functools.cached_property
    def room(self) -> int:
        """Number of steps that there is room for."""
        return self.states.motion.y.shape[0] - 1

    @functools.cached_property
    def taken(self) -> Bool[Array, " steps"]:
        """Which steps there are: the first ones."""
        return jnp.arange(self.room) < self.steps

    @functools.cached_property
    def times(self) -> Float[Array, " steps"]:
        """Instants at which the steps end [forcing periods since the start of this one]."""
        return jnp.arange(1, self.room + 1) / self.steps

    @functools.cached_property
    def ends(self) -> State:
        """The states at which the steps end, with a leading axis of steps."""
        return jax.tree.map(lambda a: a[1:], self.states)

    @functools.cached_property
    def rates(self) -> Motion:
        """Derivatives of the motion at both ends of every step [per forcing period], leading axis of steps + 1."""
        known, places = self._rates, jnp.arange(self.room + 1)
        return motion_rates_at(places / self.steps, self.states, self.args) if known is None else known

    @functools.cached_property
    def coordinates(self) -> Float[Array, "steps 10"]:
        """Coordinates and velocities where steps end, in the order of `slipperjax.model.COORDINATES`."""
        return stacked(self.ends)

    @functools.cached_property
    def acceleration(self) -> Float[Array, "steps 5"]:
        """Accelerations where steps end, in the order of `slipperjax.model.ACCELERATIONS`."""
        m = jax.tree.map(lambda a: a[1:] / self.args.scene.period, self.rates)
        return jnp.stack([m.v_y, m.v_z, m.w_x, m.w_y, m.w_z], axis=-1)

    @functools.cached_property
    def contact_force(self) -> Float[Array, "steps 2 points"]:
        """Normal contact forces where steps end [N]."""

        def at(t, state):
            now = contacts(self.args.frame(t), state.motion)
            return contact_forces(self.args.scene, now, state.memory).reshape(2, -1)

        return jax.vmap(at)(self.times, self.ends)

    @functools.cached_property
    def loads(self) -> Loads:
        """Contact loads of the period."""
        return contact_loads(self.states, self.args, self.steps)

    @functools.cached_property
    def crossings(self) -> Crossings:
        """Upward zero crossings in the period."""
        return section_crossings(self.states, self.args, self.steps, self._rates)

    def over_steps(self, values: Array, rest: float) -> Array:
        """Values (steps, ...), with `rest` in place of those of steps that there is only room for."""
        return jnp.where(self.taken.reshape(-1, *[1] * (values.ndim - 1)), values, rest)


class Stretch(NamedTuple):
    """What is known of a recorded stretch after it, for all cases of a chunk."""

    periods: int
    """Forcing periods."""
    steps: int
    """Integration steps in each."""
    start: float
    """Forcing periods before the run; the times that it reports count from there."""
    begin: float
    """Forcing periods before the stretch, those before the run included."""
    status: Int[np.ndarray, " cases"]
    """`slipperjax.Status` codes."""
    strobe: Float[np.ndarray, "cases last 10"] | None
    """States at the ends of the last periods; None where no reducer asked for them."""
    loads: Loads | None
    """Contact loads of the whole stretch, arrays (cases, ...); None where no reducer asked for them."""

    @property
    def samples(self) -> int:
        """Number of steps in all."""
        return self.periods * self.steps


class AbstractReducer(abc.ABC):
    """Makes a few numbers per case of all recorded periods, while they are integrated.

    Subclasses are frozen dataclasses: equal ones share a compiled program. One is used by `sweep(..., record=...)`,
    alone or in a list.
    """

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """The name in the attribute `record` of datasets."""

    @property
    @abc.abstractmethod
    def variables(self) -> tuple[str, ...]:
        """The data variables that it makes."""

    @property
    def inside(self) -> bool:
        """Whether states inside periods are needed."""
        return True

    @property
    def loads(self) -> bool:
        """Whether contact loads are needed."""
        return False

    def strobes(self, periods: int) -> int:
        """At the ends of how many of the last periods states are needed."""
        return 0

    @property
    def cost(self) -> float:
        """What it costs in each period beside storing states and finding loads, in plain periods: measured."""
        return 0.0

    @abc.abstractmethod
    def values(self, periods: int) -> int:
        """How many numbers are kept of a case, about."""

    def check(self, scene: Scene, periods: int, steps: int) -> None:  # noqa: B027
        """Raises `ValueError` where a run of so many recorded periods, of `steps` at least, does not suit."""

    def begin(self, scene: Scene, state: State) -> Any:
        """What is carried through the periods, of no period: NumPy arrays of one case. None where nothing is."""
        return None

    def add(self, carried: Any, period: PeriodView) -> Any:
        """What is carried after one period more, inside the compiled program."""
        return carried

    @property
    def tangents(self) -> bool:
        """Whether derivatives are taken after the recorded stretch."""
        return False

    def later(self, periods: int) -> float:
        """What follows after a stretch of so many periods costs, in plain ones."""
        return 0.0

    def after(self, carried: Any, run: Any) -> tuple[Any, Any]:
        """What is carried, and `Status` codes or None, after a run of its own from the end of the recorded stretch.

        **Arguments:** `run`: what it needs, a `slipperjax.sweeps.reducers.Further`.
        """
        return carried, None

    @abc.abstractmethod
    def finish(self, carried: Any, stretch: Stretch) -> Any:
        """What is kept: arrays of numbers with a leading axis of cases, from what was carried, with the same."""

    @abc.abstractmethod
    def label(self, scene: Scene, dims: tuple[str, ...], found: Any) -> Labelled:
        """Data variables and coordinates of a dataset, from what is kept in arrays (*grid, ...)."""


class Carried(NamedTuple):
    """What `Combined` carries through the periods."""

    loads: Loads | None
    each: tuple[Any, ...]
    """What each reducer does."""


@dataclass(frozen=True)
class Combined(AbstractRecorder):
    """Several reducers, which share one pass over the states, one look for loads and one dataset.

    Nothing is computed that none of them asks for.
    """

    reducers: tuple[AbstractReducer, ...]

    @property
    def inside(self) -> bool:
        return any(r.inside for r in self.reducers)

    @property
    def loads(self) -> bool:
        """Whether contact loads are found, from which some statuses follow."""
        return any(r.loads for r in self.reducers)

    @property
    def name(self) -> str:
        return ", ".join(r.name for r in self.reducers)

    @property
    def cost(self) -> float:
        return (INSIDE if self.inside else 1.0) + self.loads * LOADS_COST + sum(r.cost for r in self.reducers)

    @property
    def values(self) -> int:
        return STROBE_VALUES if self.strobes(1) else 0

    def strobes(self, periods: int) -> int:
        """At the ends of how many of the last periods states are needed."""
        return max(r.strobes(periods) for r in self.reducers)

    @property
    def tangents(self) -> bool:
        return any(r.tangents for r in self.reducers)

    def later(self, periods: int) -> float:
        return sum(r.later(periods) for r in self.reducers)

    def kept(self, periods: int) -> int:
        return sum(r.values(periods) for r in self.reducers)

    def check(self, scene: Scene, periods: int, steps: int, taken: Collection[str] = ()) -> None:
        names = Counter(name for r in self.reducers for name in r.variables)
        for name, count in names.items():
            if count > 1:
                raise ValueError(f"Argument `record` must give each variable once, but gives `{name}` {count} times.")
            if name in taken:
                raise ValueError(f"Argument `record` must not give `{name}`, a name which the dataset has already.")
        for r in self.reducers:
            r.check(scene, periods, steps)

    def begin(self, scene: Scene, state: State) -> Carried:
        return Carried(_no_loads(scene) if self.loads else None, tuple(r.begin(scene, state) for r in self.reducers))

    def __call__(self, states: State, args: Args, steps: Any, rates: Motion | None = None) -> State | None:
        if not self.strobes(1):
            return None
        return jax.tree.map(lambda a: a[steps if isinstance(steps, int) else jnp.asarray(steps, int)], states)

    def add(self, carried: Carried, states: State, args: Args, steps: Any, rates: Motion | None = None) -> Carried:
        period, loads = PeriodView(states, args, steps, rates), carried.loads
        if loads is not None:
            both = jax.tree.map(lambda *parts: jnp.stack(parts), loads, period.loads)
            # a sum, of which the mean is taken at the end
            loads = over_periods(both)._replace(contact_fraction=jnp.sum(both.contact_fraction, axis=0))
        each = zip(self.reducers, carried.each, strict=True)
        return Carried(loads, tuple(r.add(mine, period) for r, mine in each))

    def collect(self, kept: State | None) -> Float[np.ndarray, "cases periods 10"] | None:
        return coordinates(kept) if self.strobes(1) else None

    def latest(self, strobes: Sequence[Any], periods: int) -> Any:
        """The states of successive calls, as far as a run of so many periods needs them at its end."""
        last = self.strobes(periods)
        return joined_in_time(strobes)[:, -last:] if last else None

    def calls(self, length: int, periods: int) -> int:
        """In how many of the last calls of so many periods states are needed."""
        return math.ceil(self.strobes(periods) / length)

    def stretch_loads(self, carried: Carried, periods: int) -> Loads | None:
        """The contact loads of a whole stretch, arrays (cases, ...)."""
        loads = carried.loads
        return None if loads is None else loads._replace(contact_fraction=loads.contact_fraction / periods)

    def after(self, carried: Carried, status: Any, run: Any) -> tuple[Carried, Any]:
        """What is carried and the statuses, after what reducers do when the recorded stretch is over."""
        each = []
        for r, mine in zip(self.reducers, carried.each, strict=True):
            mine, codes = r.after(mine, run)
            each.append(mine)
            status = status if codes is None else first_problem(status, codes)
        return carried._replace(each=tuple(each)), status

    def finish(self, carried: Carried, stretch: Stretch) -> tuple[Any, ...]:
        """What each reducer keeps, arrays with a leading axis of cases."""
        return tuple(r.finish(mine, stretch) for r, mine in zip(self.reducers, carried.each, strict=True))

    def label(self, scene: Scene, dims: tuple[str, ...], record: tuple[Any, ...]) -> Labelled:
        data, coords = {}, {}
        for r, found in zip(self.reducers, record, strict=True):
            more, places = r.label(scene, dims, found)
            data, coords = data | more, coords | places
        return data, coords


def _no_loads(scene: Scene) -> Loads:
    """The loads of no period."""
    at_points = np.zeros((2, scene.points // 2))
    least, never = np.full_like(at_points, -np.inf), np.full_like(at_points, np.nan)
    return Loads(least, never, at_points, at_points, least, np.zeros(()))
