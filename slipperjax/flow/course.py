"""Courses: one forcing period of a motion with its forces, as curves from which records are made.

Between the ends of an integration step, every quantity is a cubic with the values and slopes at both ends. Therefore
peaks and crossings inside a step are found to fourth order, as accurately as the solution; the highest of a few saved
samples would miss a peak. Slopes of coordinates come from the motion. All other slopes are central differences over
five ends of steps, also of fourth order; exact slopes would need the derivatives of rail and contacts, which cost as
much as all other work. Means use the two points of Gauss's formula in each step, which have equal weights and are
exact for cubics. Greatest values are those of the cubics.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from ..model.dynamics import (
    Acting,
    Args,
    State,
    contact_forces,
    damping_ratios,
    drive_force,
    driven_mass,
    motion_rates,
    payload_force,
    per_period,
    slipper_wrenches,
)
from ..model.kinematics import Contacts, Motion, RailFrame, bent, contacts, modal_compliance
from ..model.layout import coordinate_rows
from ..model.scene import Scene
from ..model.sliding import tractions
from ..model.travel import Travel
from ..tools.checks import require
from ..tools.forms import store, sums
from ..tools.hermite import Cubic, highest_point, sign_change
from ..tools.types import Whole

GAUSS_PLACES = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
"""Places inside a step at which curves are sampled [steps]: the two points of Gauss's formula."""
DIFFERENCE_MARGIN = 2
"""Values that a central difference needs before and after its place."""


# --- slopes by differences ------------------------------------------------------------------------------------------


def continued(values: Float[Array, "ends ..."], steps: Whole) -> Float[Array, "ends+4 ..."]:
    """Return values at the ends of steps, with two further values before the period and two after it.

    The further values are on the cubics through the nearest four values. The first `steps` + 1 of `values` count.
    """
    last = jnp.asarray(steps, int)
    few = min(len(values), 4)
    # backwards from the first values, and forwards from the last values that count
    earlier = _two_more(values[few - 1 :: -1])[::-1]
    later = _two_more(jax.lax.dynamic_slice_in_dim(values, last + 1 - few, few))
    values = jnp.concatenate([earlier, values, later])
    # where there are fewer steps than places, `later` belongs after the last value that counts
    return jax.lax.dynamic_update_slice_in_dim(values, later, last + 1 + DIFFERENCE_MARGIN, 0)


def central_difference(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the slope [per step] at a place, from two values before it (`a`, `b`) and two after it (`c`, `d`)."""
    return (8 * (c - b) + a - d) / 12


def step_slopes(values: Float[Array, "ends ..."], steps: Whole) -> Float[Array, "ends ..."]:
    """Return slopes [per step] at the ends of steps; the first `steps` + 1 ends count."""
    # for each end: the values two steps and one step before, its own value, and one and two steps after
    a, b, _, c, d = (continued(values, steps)[k : k + len(values)] for k in range(2 * DIFFERENCE_MARGIN + 1))
    return central_difference(a, b, c, d)


def _two_more(values: Array) -> Array:
    """Return the next two values of the polynomial through two to four equidistant values, along the first axis."""
    # weights of equidistant values in the next value of the polynomial through them
    weights = np.array({2: (-1, 2), 3: (1, -3, 3), 4: (-1, 4, -6, 4)}[len(values)])
    following = lambda v: jnp.tensordot(weights, v[-len(weights) :], 1)
    values = jnp.stack([*values, following(values)])
    return jnp.stack([values[-1], following(values)])


# --- loads ----------------------------------------------------------------------------------------------------------


class Loads(NamedTuple):
    """Loads of each contact point, front and rear, in one forcing period or several."""

    peak_force: Float[Array, "... 2 points"]
    """Highest normal force [N]."""
    peak_period: Float[Array, "... 2 points"]
    """Instant of the highest force [forcing periods]; NaN where the force is zero throughout."""
    impulse: Float[Array, "... 2 points"]
    """Integral of the normal force over time [N s]."""
    contact_fraction: Float[Array, "... 2 points"]
    """Share of the time in which the gap is negative [1]."""
    penetration: Float[Array, "... 2 points"]
    """Greatest penetration [m]; where the gap stays open, the smallest gap with a negative sign."""
    stability_number: Float[Array, "*cases"]
    """Greatest product of the step's length and the rate of the contacts, of oscillation or damping [1]. Explicit
    methods of fourth order are unstable above 2.8."""
    damping_ratio: Float[Array, "*cases"]
    """Highest damping force over elastic force of all points in contact [1]; zero on rails that are not rough."""


def contact_loads(force: Array, gap: Array, rate: Array, damping: Array, args: Args, steps: Whole) -> Loads:
    """Return the loads of one forcing period.

    **Arguments:** `force` [N] and `gap` [m], arrays (ends, *slippers, 2, points), and `rate`, the `contact_rate`
    [1/s], (ends,): at both ends of every step, of which the first `steps` + 1 count; `damping`: `damping_ratio`;
    `args`: scene and epoch; `steps`: integration steps per period, at least 3, may be traced.
    """
    most = len(force) - 1
    step = 1 / steps
    period = args.travel(0.5).period
    steady = args.travel(0.5).acceleration is None
    places = jnp.arange(most)
    # the pace in the middle of each step [s per period], where the pace changes
    paces = None if steady else store(args.travel((places + 0.5) * step).period)
    # steps have equal lengths of rail: where the speed changes, a step counts by its duration
    of_time = lambda share, place: share if paces is None else paces[place] * share
    fastest = jnp.max(jnp.where(jnp.arange(most + 1) <= steps, rate, 0.0)) * period
    # all points in one row, which is faster than two rows
    flat = lambda a: a.reshape(most + 1, -1)
    values = continued(jnp.stack((flat(force), flat(-gap)), axis=1), steps)

    def one(carry, place):
        """Add one step to the totals; the slope at its end is the slope at the next step's start."""
        (highest, when, impulse, contact, deepest), slope = carry
        around = jax.lax.dynamic_slice_in_dim(values, place + 1, 5)
        _, begin, end, _, _ = around
        # `end` is in the middle of the five values, so that this is the slope there
        next_slope = _slope(*around)
        (inside, _), (peak, deep) = highest_point(begin, slope, end, next_slope)
        # integral of the force's cubic over the step
        area = (begin[0] + end[0]) / 2 + (slope[0] - next_slope[0]) / 12
        new = (
            jnp.maximum(highest, peak),
            jnp.where((peak > highest) & (peak > 0), (place + inside) * step + args.epoch, when),
            impulse + of_time(area, place),
            contact + of_time(_share_closed(-begin[1], -slope[1], -end[1], -next_slope[1]), place),
            jnp.maximum(deepest, deep),
        )
        # unused places for steps change nothing
        totals = jax.tree.map(lambda n, old: jnp.where(place < steps, n, old), new, carry[0])
        return (totals, next_slope), None

    nothing = jnp.zeros(values.shape[-1])
    totals = nothing - jnp.inf, nothing + jnp.nan, nothing, nothing, nothing - jnp.inf
    # step by step, so that the values stay in the cache
    (totals, _), _ = jax.lax.scan(one, (totals, _slope(*values[:5])), places)
    highest, when, impulse, contact, depth = (a.reshape(force.shape[1:]) for a in totals)
    if paces is None:
        impulse = step * period * impulse
        contact = step * contact
    else:
        # these sums are already over seconds
        impulse = step * impulse
        contact = contact / jnp.sum(jnp.where(places < steps, paces, 0.0))
    return Loads(highest, when, impulse, contact, depth, step * fastest, damping)


def over_periods(loads: Loads, seconds: Float[Array, " periods"] | None = None) -> Loads:
    """Return loads of several periods from the loads of each, along the first axis.

    Contact fractions are means, weighted by the `seconds` of each period, which are equal at constant speed.
    """
    highest = jnp.max(loads.peak_force, 0)
    # the first instant where several periods have the same peak
    when = jnp.nanmin(jnp.where(loads.peak_force == highest[None], loads.peak_period, jnp.nan), 0)
    return Loads(
        peak_force=highest,
        peak_period=when,
        impulse=jnp.sum(loads.impulse, 0),
        contact_fraction=jnp.average(loads.contact_fraction, 0, seconds),
        penetration=jnp.max(loads.penetration, 0),
        stability_number=jnp.max(loads.stability_number, 0),
        damping_ratio=jnp.max(loads.damping_ratio, 0),
    )


def _slope(a: Array, b: Array, here: Array, c: Array, d: Array) -> Array:
    """Return slopes of force and penetration [per step] from the values of two samples before and two after.

    Where the force is zero, it begins, ends or stays zero, and its slope is zero in each case.
    """
    slope = central_difference(a, b, c, d)
    return jnp.stack([jnp.where(here[0] > 0, slope[0], 0.0), slope[1]])


def contact_rate(frame: RailFrame, now: Contacts, memory: Array | None, args: Args) -> Array:
    """Return the greatest rate of contacts and parts [1/s]: the sum of the contacts' decay rates, the frequency of
    their springs, of the highest mode, or of a sled on springs.

    For one point of effective mass m these are (dF/dg')/m and sqrt((dF/dg)/m); the sum over the points bounds the
    greatest rate of all points together.
    """
    scene = args.scene
    zero = jnp.zeros_like(now.gap)
    force = lambda gap, rate: contact_forces(scene, Contacts(gap, rate, now.lever), memory)
    # derivatives by all penetrations at once, because no force depends on another point's gap
    spring = jax.jvp(force, (now.gap, now.rate), (-jnp.ones_like(zero), zero))[1]
    damper = jax.jvp(force, (now.gap, now.rate), (zero, -jnp.ones_like(zero)))[1]
    # a point yields to a force as the slipper moves and turns; this number only judges, and needs no derivative
    turn = sum(lever**2 * (1 / j) for lever, j in zip(now.lever, scene.slipper.inertia, strict=True))
    yielding = 1 / scene.slipper.mass + turn
    modes = scene.slipper.modes
    if modes is not None:
        yielding = yielding + modal_compliance(frame)
    per_mass = jax.lax.stop_gradient(yielding)
    # one pass over the points, see `slipperjax.tools.fused`
    decay, square = sums(*(jnp.maximum(jax.lax.stop_gradient(x), 0) * per_mass for x in (damper, spring)))
    fastest = jnp.maximum(decay, jnp.sqrt(square))
    if scene.payload is not None:
        fastest = jnp.maximum(fastest, scene.payload.fastest(scene.slipper.mass))
    return fastest if modes is None else jnp.maximum(fastest, 2 * jnp.pi * modes.frequency[-1])


def _share_closed(g0: Array, d0: Array, g1: Array, d1: Array) -> Array:
    """Return the share of a step in which a gap is negative [1]."""
    # a step whose ends have the same sign counts as wholly open or wholly closed
    changes = (g0 < 0) != (g1 < 0)
    x = sign_change(Cubic.through(g0, d0, g1, d1), g1, changes)
    within = jnp.where(g0 < 0, x, 1 - x)
    return jnp.where(changes, within, jnp.where(g0 < 0, 1.0, 0.0))


# --- Poincare sections ----------------------------------------------------------------------------------------------


class Crossings(NamedTuple):
    """Upward zero crossings of each section, in the order of `slipperjax.model.SECTIONS`, in each step; or NaN."""

    time: Float[Array, "5 steps"]
    """Instant of the crossing [forcing periods]."""
    velocity: Float[Array, "5 steps"]
    """Velocity at the crossing, v_y, v_z [m/s], w_x, w_y, w_z [rad/s]."""


def crossing(q: Array, q_slope: Array, v: Array, v_slope: Array) -> tuple[Array, Array]:
    """Return where in a step a coordinate crosses zero upwards, and the velocity there.

    **Arguments:** coordinate, velocity, and their slopes per step at the ends of steps along the last axis.

    **Returns:** the place in [0, 1] and the velocity of each step, both NaN without an upward crossing.
    """
    crosses = (q[..., :-1] < 0) & (q[..., 1:] >= 0)
    x = sign_change(_cubics(q, q_slope), q[..., 1:], crosses)
    velocity = _cubics(v, v_slope).value(x)
    return jnp.where(crosses, x, jnp.nan), jnp.where(crosses, velocity, jnp.nan)


def _cubics(values: Array, slopes: Array) -> Cubic:
    """Return the cubics of steps between their ends, along the last axis."""
    return Cubic.through(values[..., :-1], slopes[..., :-1], values[..., 1:], slopes[..., 1:])


# --- the course -----------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class StepCubics:
    """A quantity over one forcing period, a cubic in each step. Each property is computed once for all records."""

    values: Float[Array, "ends ..."]
    """Values at both ends of every step."""
    slopes: Float[Array, "ends ..."]
    """Derivatives at both ends of every step [per step]."""
    course: "Course"
    """The course of the period; its number of steps says how many values count."""
    level: Float[Array, "steps ..."] | None = None
    """Value to add throughout each step, for a quantity that jumps between steps; None for other quantities."""

    @functools.cached_property
    def samples(self) -> Float[Array, "samples ..."]:
        """Values at `GAUSS_PLACES` of every step, in the order of time."""
        cubic = Cubic.through(*self._ends)
        values = jnp.stack([cubic.value(x) for x in GAUSS_PLACES], axis=1)
        return values.reshape(-1, *self.values.shape[1:])

    def at(self, places: Float[np.ndarray, " places"]) -> Float[Array, "places ..."]:
        """Return values at `places`, shares of the period from 0 to 1."""
        # the step that contains a place (the last step for the end of the period), and the place within the step
        inside = places * self.course.steps
        k = jnp.minimum(jnp.floor(inside), self.course.steps - 1).astype(int)
        x = (inside - k).reshape(-1, *[1] * (self.values.ndim - 1))
        return jnp.asarray(Cubic.through(*(end[k] for end in self._ends)).value(x))

    @functools.cached_property
    def mean(self) -> Float[Array, "..."]:
        """The mean over time; over distance where the speed changes."""
        return self.course.mean(self.samples)

    @functools.cached_property
    def integral(self) -> Float[Array, "..."]:
        """The integral over time."""
        travel = self.course.args.travel(self.course.times)
        if travel.acceleration is None:
            return self.mean * travel.period
        # samples are equidistant in travel, so that each is weighted with its own duration
        paces = store(jnp.broadcast_to(travel.period, self.course.times.shape))
        return self.course.mean(self.samples * paces.reshape(-1, *[1] * (self.values.ndim - 1)))

    @functools.cached_property
    def mean_square(self) -> Float[Array, "..."]:
        """The mean of the square over time; over distance where the speed changes."""
        return self.course.mean(self.samples**2)

    @functools.cached_property
    def greatest(self) -> Float[Array, "..."]:
        """The greatest value."""
        # Stored: the derivative of jnp.max looks for values equal to the maximum. Where XLA computes these values
        # again with other rounding, no value is equal, and the derivative is 0 / 0.
        return jnp.max(store(self.course.counted(self._tops, -jnp.inf)), axis=0)

    @functools.cached_property
    def least(self) -> Float[Array, "..."]:
        """The least value."""
        return -self._falling.greatest

    @functools.cached_property
    def extreme(self) -> Float[Array, "..."]:
        """The value of greatest magnitude, with its sign."""
        return jnp.where(self.greatest >= -self.least, self.greatest, self.least)

    @functools.cached_property
    def extreme_place(self) -> Float[Array, "..."]:
        """Place of `extreme` [forcing periods since the start of this period]; NaN where all values are zero."""
        rises = self.greatest >= -self.least
        (up, highest), (down, lowest) = self._highest, self._falling._highest
        # stored, as in `greatest`
        size = store(self.course.counted(jnp.where(rises[None], highest, lowest), -jnp.inf))
        first = jnp.arange(self.course.capacity).reshape(-1, *[1] * (size.ndim - 1))
        place = (first + jnp.where(rises[None], up, down)) / self.course.steps
        here = size == jnp.max(size, axis=0, keepdims=True)
        # the first of equal values
        return jnp.where(self.extreme != 0, jnp.min(store(jnp.where(here, place, jnp.inf)), axis=0), jnp.nan)

    @functools.cached_property
    def shallowest_turn(self) -> Float[Array, "..."]:
        """The magnitude of the extreme that is nearest to zero; infinite where there is no extreme."""
        # extremes inside a step: where the slope changes its sign between the step's ends
        rises = self.slopes >= 0
        top = rises[:-1] & ~rises[1:]
        bottom = ~rises[:-1] & rises[1:]
        sizes = jnp.abs(jnp.where(top, self._tops, -self._falling._tops))
        sizes = self.course.counted(jnp.where(top | bottom, sizes, jnp.inf), jnp.inf)
        return jnp.min(store(sizes), axis=0)  # as in `greatest`

    @functools.cached_property
    def _falling(self) -> "StepCubics":
        return StepCubics(
            -self.values,
            -self.slopes,
            self.course,
            None if self.level is None else -self.level,
        )

    @functools.cached_property
    def _highest(self) -> tuple[Array, Array]:
        """The place in every step where the value is greatest [steps], and the greatest value."""
        return highest_point(*self._ends)

    @property
    def _tops(self) -> Array:
        """The greatest value in every step."""
        return self._highest[1]

    @property
    def _ends(self) -> tuple[Array, Array, Array, Array]:
        begin = self.values[:-1]
        end = self.values[1:]
        if self.level is not None:
            begin = begin + self.level
            end = end + self.level
        return begin, self.slopes[:-1], end, self.slopes[1:]


@dataclass(eq=False)
class Course:
    """One forcing period of a motion, in the form that records get inside the compiled program.

    Each quantity is computed at its first use, once for all records; unused quantities cost nothing. Axes named
    `ends` are over both ends of every step, `points` over the contact points of the slipper's front or rear. One
    program may serve several numbers of steps: then arrays have places for more steps than are `used`, and means and
    extremes leave the unused places out.
    """

    end: State
    """The state at the end of the period."""
    inside: State | None
    """Result of `states`; None where no record needs states inside the period. Entries after the first `steps` + 1
    repeat the start."""
    args: Args
    """The scene, in this period, and its epoch."""
    steps: Whole
    """Integration steps in the period, an `int` or traced."""
    known_rates: Motion | None = None
    """Result of `rates`, where the solver has computed it; otherwise None."""

    @property
    def scene(self) -> Scene:
        """The scene, in this period."""
        return self.args.scene

    @property
    def states(self) -> State:
        """The states at both ends of every step, with a leading axis of ends."""
        if self.inside is None:
            raise ValueError("Property `inside` of a record must be True for it to see states inside periods.")
        return self.inside

    @property
    def capacity(self) -> int:
        """Number of steps for which arrays have places."""
        return self.states.motion.y.shape[0] - 1

    @property
    def used(self) -> Bool[Array, " steps"]:
        """Whether each place has a step of the period; the first places have."""
        return jnp.arange(self.capacity) < self.steps

    @property
    def times(self) -> Float[Array, " samples"]:
        """Instants of the samples of curves [forcing periods since the start of this period]."""
        return ((jnp.arange(self.capacity)[:, None] + GAUSS_PLACES[None]) / self.steps).ravel()

    @property
    def travel(self) -> Travel:
        """Speed and pace in the middle of the period."""
        return self.args.travel(0.5)

    @property
    def _instants(self) -> Array:
        """Both ends of every step [forcing periods since the start of this period]."""
        return jnp.arange(self.capacity + 1) / self.steps

    @functools.cached_property
    def _contacts(self) -> tuple[RailFrame, Contacts]:
        """Rail and contacts at both ends of every step."""

        def at(place: Array, state: State) -> tuple[RailFrame, Contacts]:
            frame = bent(self.args.frame(place / self.steps), state.rail)
            return frame, contacts(frame, state.motion)

        frame, now = jax.vmap(at)(jnp.arange(self.capacity + 1), self.states)
        # stored, so that XLA does not compute these values again in each use
        return frame, now._replace(gap=store(now.gap), rate=store(now.rate))

    @functools.cached_property
    def _forces(self) -> Float[Array, "ends all_points"]:
        of_one = functools.partial(contact_forces, self.scene)
        return store(jax.vmap(of_one)(self._contacts[1], self.states.memory))

    @functools.cached_property
    def damping_ratio(self) -> Float[Array, "ends *slippers 2 points"]:
        """Damping force over elastic force of points in contact [1] at both ends of every step; 0 for open points."""
        _, now = self._contacts
        ratio = damping_ratios(self.scene, now.rate, self.states.memory)
        return self._of_points(jnp.where(now.gap < 0, ratio, 0.0))

    @property
    def _acting(self) -> Acting:
        """Contacts and their forces at both ends of every step."""
        return Acting(*self._contacts, self.states.motion, self._forces)

    @functools.cached_property
    def rates(self) -> Motion:
        """Derivatives of the motion at both ends of every step [per forcing period]."""
        if self.known_rates is not None:
            return self.known_rates

        def of_one(place: Array, at: Acting) -> Motion:
            travel = self.args.travel(place)
            return per_period(travel, motion_rates(self.scene, at, travel))

        return jax.vmap(of_one)(self._instants, self._acting)

    @functools.cached_property
    def coordinates(self) -> StepCubics:
        """The coordinates in the order of `slipperjax.model.COORDINATES`, (ends, coordinates)."""
        # Euler angles and their slopes follow from the quaternion
        moving = jax.tree.map(lambda rate: rate / self.steps, self.rates)
        with_slopes = lambda m, rate: jax.jvp(lambda m: coordinate_rows(State(m, None)), (m,), (rate,))
        values, slopes = jax.vmap(with_slopes)(self.states.motion, moving)
        return StepCubics(store(values), store(slopes), self)

    @functools.cached_property
    def acceleration(self) -> StepCubics:
        """The accelerations in the order of `slipperjax.model.ACCELERATIONS`, (ends, accelerations)."""
        travel = self.args.travel(self._instants)
        m = self.rates
        # from rates per forcing period to rates per second
        rates = [rate / travel.period for rate in (m.v_y, m.v_z, m.w_x, m.w_y, m.w_z)]
        return self._curve(store(jnp.stack(rates, axis=-1)))

    @functools.cached_property
    def modal_acceleration(self) -> StepCubics:
        """Accelerations of the elastic modes [m kg^0.5/s^2], (ends, modes); no modes for a rigid body."""
        modes = self.rates.modes
        if modes is None:
            return self._curve(jnp.zeros((self.capacity + 1, 0)))
        period = jnp.broadcast_to(self.args.travel(self._instants).period, self._instants.shape)
        return self._curve(store(modes.rate / period[:, None]))

    @functools.cached_property
    def force(self) -> StepCubics:
        """Normal contact forces at the front and the rear points [N], (ends, *slippers, 2, points)."""
        return self._where_closed(self._curve(self._of_points(self._forces)))

    @functools.cached_property
    def slipper_load(self) -> StepCubics:
        """Net force along y and z [N], and net moment about its middle along the body's x, y and z axes [N m], of
        each slipper's contacts, (ends, *slippers, 5)."""

        def of_one(place: Array, at: Acting) -> Array:
            _, *loads = slipper_wrenches(self.scene, at, self.args.travel(place))
            return jnp.stack(loads, axis=-1)

        return self._curve(store(jax.vmap(of_one)(self._instants, self._acting)))

    @functools.cached_property
    def slipper_roll(self) -> StepCubics:
        """Moment about the body's x axis of each slipper's normal forces [N m], (ends, *slippers)."""
        _, now = self._contacts
        return self._curve(store(self._of_points(self._forces * now.lever[0]).sum((-2, -1))))

    @functools.cached_property
    def gap(self) -> StepCubics:
        """Gaps of the front and the rear points, negative where penetrating [m], (ends, *slippers, 2, points)."""
        return self._curve(self._of_points(self._contacts[1].gap))

    @functools.cached_property
    def gap_rate(self) -> Float[Array, "ends *slippers 2 points"]:
        """Rates of the gaps at both ends of every step [m/s]; negative where they close."""
        return self._of_points(self._contacts[1].rate)

    @functools.cached_property
    def power(self) -> StepCubics:
        """Power that the contacts take from the motion along the normals [W], (ends, *slippers, 2, points): force
        times closing rate."""
        return self._where_closed(self._curve(store(-self.force.values * self.gap_rate)))

    @functools.cached_property
    def drive_force(self) -> StepCubics:
        """Force along x that keeps the speed, or follows its programme [N], (ends,).

        The force of mass times acceleration, which may jump from step to step, is the `level` of the curve.
        """
        travel = self.args.travel(self._instants)

        def steady(place: Array, at: Acting) -> Array:
            return drive_force(self.scene, at, self.args.travel(place)._replace(acceleration=None))

        curve = self._curve(store(jax.vmap(steady)(self._instants, self._acting)))
        level = None
        # An acceleration that jumps inside a step does not show at the step's ends. Its mean force in the step is the
        # gain of kinetic energy over the step's length.
        if travel.acceleration is not None:
            energy = 0.5 * driven_mass(self.scene) * travel.speed**2
            level = store(jnp.diff(energy) * (self.steps / travel.wavelength))
        return StepCubics(curve.values, curve.slopes, self, level)

    @functools.cached_property
    def friction_power(self) -> StepCubics:
        """Power that friction turns into heat [W], (ends, *slippers, 2, points); zero without friction."""
        friction = self.scene.friction
        power = jnp.zeros_like(self._forces)
        if friction is not None:

            def of_one(place: Array, at: Acting) -> Array:
                speed = self.args.travel(place).speed
                _, _, heat = tractions(friction, at.frame, at.motion, at.force, speed)
                return at.force * heat

            power = store(jax.vmap(of_one)(self._instants, self._acting))
        return self._where_closed(self._curve(self._of_points(power)))

    @functools.cached_property
    def spring_force(self) -> StepCubics:
        """Lateral and vertical force of the sled's springs, dampers and stops on the slipper [N], (ends, 2)."""
        sled = self.scene.payload
        require(sled is not None, "record", "be another one where the scene has no sled", "spring_force")
        return self._curve(store(jax.vmap(lambda m: payload_force(sled, m))(self.states.motion)))

    @functools.cached_property
    def rail_deflection(self) -> StepCubics:
        """Lateral and vertical deflection of the rails at each track node [m], (ends, 2, nodes); 0 of rigid rails."""
        rail = self.states.rail
        if rail is None:
            none = jnp.zeros((self.capacity + 1, 2, self.scene.nodes[1]))
            return StepCubics(none, none, self)
        seconds = self.args.travel(self._instants).period / self.steps
        slopes = rail.rate * jnp.broadcast_to(seconds, self._instants.shape)[:, None, None]
        return StepCubics(rail.deflection, slopes, self)

    @functools.cached_property
    def rail_energy(self) -> Array:
        """Energy of all rails and their beds at the end of the period [J]; 0 of rigid rails."""
        beam, rail = self.scene.beam, self.end.rail
        if beam is None or rail is None:
            return jnp.zeros(())
        return jnp.sum(beam.energy(rail.waves, self.args.travel(1.0).speed))

    @functools.cached_property
    def loads(self) -> Loads:
        """Peak forces, impulses and other loads of each contact point."""
        of_one = functools.partial(contact_rate, args=self.args)
        rate = jax.vmap(of_one)(*self._contacts, self.states.memory)
        # judged on rough rails only
        damping = self.damping_ratio if self.scene.track.is_rough else jnp.zeros(())
        damping = jnp.max(jax.lax.stop_gradient(damping))
        return contact_loads(self.force.values, self.gap.values, store(rate), damping, self.args, self.steps)

    @functools.cached_property
    def crossings(self) -> Crossings:
        """Upward zero crossings."""
        # the first half are coordinates, the second half velocities; axes are sections, then ends of steps
        q, v = jnp.split(self.coordinates.values.T, 2)
        q_slope, v_slope = jnp.split(self.coordinates.slopes.T, 2)
        place, velocity = crossing(q, q_slope, v, v_slope)
        time = (jnp.arange(self.capacity)[None] + place) / self.steps + self.args.epoch
        used = self.used[None]
        return Crossings(jnp.where(used, time, jnp.nan), jnp.where(used, velocity, jnp.nan))

    def saved(self, saves: int) -> State:
        """Return the states at the ends of `saves` equal parts of the period, with a leading axis."""
        if saves == 1:
            return jax.tree.map(lambda a: a[None], self.end)
        # a slice where the program knows the number of steps
        if isinstance(self.steps, int):
            stride = self.steps // saves
            return jax.tree.map(lambda a: a[stride : self.steps + 1 : stride], self.states)
        # otherwise by indices, rounded because the division may have an error
        at = jnp.round(jnp.arange(1, saves + 1) * (self.steps / saves)).astype(int)
        return jax.tree.map(lambda a: a[at], self.states)

    def mean(self, samples: Float[Array, "samples ..."]) -> Float[Array, "..."]:
        """Return the mean over time of `samples`, made from samples of curves; over distance if the speed changes."""
        return jnp.sum(self.counted(samples, 0.0), axis=0) / (self.steps * len(GAUSS_PLACES))

    def counted(
        self,
        values: Shaped[Array, "samples ..."],
        filler: float,
    ) -> Shaped[Array, "samples ..."]:
        """Return values of steps, or of samples in them, with `filler` in place of those of unused steps."""
        # each step has one value, or one value for each of its samples
        used = jnp.repeat(self.used, len(values) // self.capacity)
        return jnp.where(used.reshape(-1, *[1] * (values.ndim - 1)), values, filler)

    def _of_points(self, values: Array) -> Array:
        # points at the front come first
        return values.reshape(len(values), *self.scene.point_shape)

    def _curve(self, values: Array) -> StepCubics:
        return StepCubics(values, step_slopes(values, self.steps), self)

    def _where_closed(self, curve: StepCubics) -> StepCubics:
        """Set slopes to zero where the force is zero: it begins or ends there, or is zero throughout."""
        closed = self._of_points(self._forces) > 0
        return StepCubics(curve.values, jnp.where(closed, curve.slopes, 0.0), self)
