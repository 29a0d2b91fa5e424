"""Courses: one forcing period of a motion with its forces, as curves that records are made of.

Every quantity is a cubic in each integration step, through both ends with its slopes: fourth order in the step, like
the solution. Slopes of coordinates are the motion's own, all others those of `slipperjax.flow.loads`. Means
are taken over the two points of Gauss's formula in each step, which have equal weights and are exact for cubics;
greatest values are those of the cubics.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from ..model.dynamics import Args, State, contact_forces, motion_rates, per_period
from ..model.kinematics import Contacts, Motion, contacts
from ..model.layout import coordinate_rows
from ..model.scene import Scene
from ..model.travel import Travel
from ..tools.fused import materialise
from .loads import Loads, contact_loads, contact_rate, step_slopes
from .poincare import Crossings, hermite, highest_point, section_crossings

GAUSS_PLACES = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
"""Places inside a step at which curves are sampled [steps]: those of Gauss's formula with two points."""


class Curve:
    """A quantity over a period, a cubic in each step. Each property is computed once for all records."""

    def __init__(self, values: Float[Array, "ends ..."], slopes: Float[Array, "ends ..."], course: "Course"):
        """**Arguments:** values, and derivatives per step, at both ends of every step."""
        self.values, self.slopes, self._course = values, slopes, course

    @functools.cached_property
    def samples(self) -> Float[Array, "samples ..."]:
        """Values at `GAUSS_PLACES` of every step, in the order of time."""
        values = jnp.stack([hermite(x, *self._ends) for x in GAUSS_PLACES], axis=1)
        return values.reshape(-1, *self.values.shape[1:])

    @functools.cached_property
    def mean(self) -> Float[Array, "..."]:
        """The mean over time."""
        return self._course.mean(self.samples)

    @functools.cached_property
    def mean_square(self) -> Float[Array, "..."]:
        """The mean of the square over time."""
        return self._course.mean(self.samples**2)

    @functools.cached_property
    def greatest(self) -> Float[Array, "..."]:
        """The greatest value."""
        # Stored, because the derivative of jnp.max looks for the values that equal the maximum: where XLA computes
        # them again and rounds otherwise, none does, and the derivative is 0 / 0.
        return jnp.max(materialise(self._course.counted(self._tops, -jnp.inf)), axis=0)

    @functools.cached_property
    def least(self) -> Float[Array, "..."]:
        """The least value."""
        return -self._falling.greatest

    @functools.cached_property
    def shallowest_turn(self) -> Float[Array, "..."]:
        """The magnitude of the extreme that is nearest to zero; infinite where there is none."""
        rises = self.slopes >= 0
        top, bottom = rises[:-1] & ~rises[1:], ~rises[:-1] & rises[1:]
        sizes = jnp.abs(jnp.where(top, self._tops, -self._falling._tops))
        sizes = self._course.counted(jnp.where(top | bottom, sizes, jnp.inf), jnp.inf)
        return jnp.min(materialise(sizes), axis=0)  # as in `greatest`

    @functools.cached_property
    def _falling(self) -> "Curve":
        return Curve(-self.values, -self.slopes, self._course)

    @functools.cached_property
    def _tops(self) -> Array:
        """The greatest value in every step."""
        return highest_point(*self._ends)[1]

    @property
    def _ends(self) -> tuple[Array, Array, Array, Array]:
        return self.values[:-1], self.slopes[:-1], self.values[1:], self.slopes[1:]


class Course:
    """One forcing period of a motion, as records see it inside the compiled program.

    Each quantity is computed at its first use, once for all records: one that none of them uses costs nothing. Arrays
    over steps have a capacity for more steps than are `used`; means and extremes leave the others out.
    """

    def __init__(self, end: State, inside: State | None, args: Args, steps: Any, rates: Motion | None = None):
        """**Arguments:** `end`: the state at the end of the period; `inside`: at both ends of every step, of which
        the first `steps` + 1 count (the others repeat the start), None where all records do without; `args`: scene
        and epoch; `steps`: integration steps per period, an `int` or traced; `rates`: derivatives of the motion at
        the same instants [per forcing period], where they are known."""
        self.end, self.args, self.steps, self._inside, self._rates = end, args, steps, inside, rates

    @property
    def scene(self) -> Scene:
        """The case."""
        return self.args.scene

    @property
    def states(self) -> State:
        """The states at both ends of every step, with a leading axis."""
        if self._inside is None:
            raise ValueError("Property `inside` of a record must be True for it to see states inside periods.")
        return self._inside

    @property
    def capacity(self) -> int:
        """Number of steps that arrays have room for."""
        return self.states.motion.y.shape[0] - 1

    @property
    def used(self) -> Bool[Array, " steps"]:
        """Whether each step is one of the period's, which are the first ones."""
        return jnp.arange(self.capacity) < self.steps

    @property
    def times(self) -> Float[Array, " samples"]:
        """Instants of the samples of curves [forcing periods since the start of this one]."""
        return ((jnp.arange(self.capacity)[:, None] + GAUSS_PLACES[None]) / self.steps).ravel()

    @property
    def travel(self) -> Travel:
        """Speed and pace in the middle of the period."""
        return self.args.travel(0.5)

    @property
    def _instants(self) -> Array:
        """Both ends of every step [forcing periods since the start of this one]."""
        return jnp.arange(self.capacity + 1) / self.steps

    @functools.cached_property
    def _contacts(self) -> tuple[Any, Contacts]:
        """Rail and contacts at both ends of every step."""

        def at(place, m):
            frame = self.args.frame(place / self.steps)
            return frame, contacts(frame, m)

        frame, now = jax.vmap(at)(jnp.arange(self.capacity + 1), self.states.motion)
        # stored, so that XLA does not compute them again wherever they are used
        return frame, now._replace(gap=materialise(now.gap), rate=materialise(now.rate))

    @functools.cached_property
    def _forces(self) -> Float[Array, "ends all_points"]:
        of_one = functools.partial(contact_forces, self.scene)
        return materialise(jax.vmap(of_one)(self._contacts[1], self.states.memory))

    @functools.cached_property
    def rates(self) -> Motion:
        """Derivatives of the motion at both ends of every step [per forcing period]."""
        if self._rates is not None:
            return self._rates
        frame, now = self._contacts
        of_one = lambda frame, now, m, force: motion_rates(self.scene, frame, now, m, force)
        travel = self.args.travel(self._instants)
        return per_period(travel, jax.vmap(of_one)(frame, now, self.states.motion, self._forces))

    @functools.cached_property
    def coordinates(self) -> Curve:
        """(ends, coordinates), in the order of `slipperjax.model.COORDINATES`."""
        moving = jax.tree.map(lambda rate: rate / self.steps, self.rates)
        with_slopes = lambda m, rate: jax.jvp(lambda m: coordinate_rows(State(m, None)), (m,), (rate,))
        values, slopes = jax.vmap(with_slopes)(self.states.motion, moving)
        return Curve(materialise(values), materialise(slopes), self)

    @functools.cached_property
    def acceleration(self) -> Curve:
        """(ends, accelerations), in the order of `slipperjax.model.ACCELERATIONS`."""
        travel = self.args.travel(self._instants)
        m = jax.tree.map(lambda rate: rate / travel.period, self.rates)
        return self._curve(materialise(jnp.stack([m.v_y, m.v_z, m.w_x, m.w_y, m.w_z], axis=-1)))

    @functools.cached_property
    def force(self) -> Curve:
        """Normal contact forces at the front and the rear points [N], (ends, 2, points)."""
        return self._where_closed(self._curve(self._of_points(self._forces)))

    @functools.cached_property
    def gap(self) -> Curve:
        """Gaps there, negative where penetrating [m], (ends, 2, points)."""
        return self._curve(self._of_points(self._contacts[1].gap))

    @functools.cached_property
    def gap_rate(self) -> Float[Array, "ends 2 points"]:
        """Rates of the gaps at both ends of every step [m/s]."""
        return self._of_points(self._contacts[1].rate)

    @functools.cached_property
    def power(self) -> Curve:
        """Power that the contacts take from the motion along the normals [W], (ends, 2, points): force times closing
        rate."""
        return self._where_closed(self._curve(materialise(-self.force.values * self.gap_rate)))

    @functools.cached_property
    def drive_force(self) -> Curve:
        """Force along x that keeps the speed constant [N], (ends,)."""
        frame, _ = self._contacts
        return self._curve(materialise(-jnp.sum(self._forces * frame.normal[0], axis=-1)))

    @functools.cached_property
    def loads(self) -> Loads:
        """Peak forces, impulses and other loads of each contact point."""
        of_one = functools.partial(contact_rate, args=self.args)
        rate = jax.vmap(of_one)(self._contacts[1], self.states.memory)
        return contact_loads(self.force.values, self.gap.values, materialise(rate), self.args, self.steps)

    @functools.cached_property
    def crossings(self) -> Crossings:
        """Upward zero crossings."""
        return section_crossings(self.states.motion, self.rates, self.args, self.steps)

    def saved(self, saves: int) -> State:
        """Returns the states at the ends of `saves` equal parts of the period, with a leading axis."""
        if saves == 1:
            return jax.tree.map(lambda a: a[None], self.end)
        if isinstance(self.steps, int):
            stride = self.steps // saves
            return jax.tree.map(lambda a: a[stride : self.steps + 1 : stride], self.states)
        at = jnp.round(jnp.arange(1, saves + 1) * (self.steps / saves)).astype(int)
        return jax.tree.map(lambda a: a[at], self.states)

    def mean(self, samples: Float[Array, "samples ..."]) -> Float[Array, "..."]:
        """Returns the mean over time of what was computed from samples of curves."""
        return jnp.sum(self.counted(samples, 0.0), axis=0) / (self.steps * len(GAUSS_PLACES))

    def counted(self, values: Shaped[Array, "samples ..."], filler: float) -> Shaped[Array, "samples ..."]:
        """Returns values of steps, or samples, with `filler` in place of those of unused steps."""
        used = jnp.repeat(self.used, len(values) // self.capacity)
        return jnp.where(used.reshape(-1, *[1] * (values.ndim - 1)), values, filler)

    def _of_points(self, values: Array) -> Array:
        return values.reshape(len(values), 2, -1)

    def _curve(self, values: Array) -> Curve:
        return Curve(values, step_slopes(values, self.steps), self)

    def _where_closed(self, curve: Curve) -> Curve:
        """Sets slopes to zero where the force is zero: it begins or ends there, or is zero throughout."""
        closed = self._of_points(self._forces) > 0
        return Curve(curve.values, jnp.where(closed, curve.slopes, 0.0), self)
