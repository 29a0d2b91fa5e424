"""Runge-Kutta steps that find where contacts begin and end, and integrate the impulse of each contact.

The second derivative of Eq. (12)'s force has a kink where a contact begins or ends. The stages of a Runge-Kutta
method do not find this place, so that the method loses one order in values and a further order in derivatives. The
stages of this solver only predict the gap of each contact over the step, as a cubic. The force is then integrated
over the part of the step in which the cubic is negative, and the impulses give the motion at the end of the step.

A prediction of third order in velocities and fourth order in positions is enough for impulses of fourth order.
Therefore the contacts are evaluated in the middle of the step alone, and not in the stage at its end.
"""

import dataclasses
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from diffrax import RESULTS
from jaxtyping import Array

from ..model.contact import EventLatch, PeakRateLatch, Rates
from ..model.dynamics import (
    Args,
    State,
    VectorField,
    contact_forces,
    damping_ratios,
    forces_at,
    newton_euler,
    per_period,
    resultants,
    wrench_directions,
)
from ..model.kinematics import (
    Contacts,
    ModalMotion,
    Motion,
    RailFrame,
    attitude_rates,
    bent,
    carried,
    contacts,
    modal_compliance,
    moved,
)
from ..model.scene import Scene
from ..tools.forms import store, store_cotangent, store_if_differentiated
from ..tools.hermite import Cubic, sign_change
from .bending import RigidRails, rails_in_step
from .latching import AbstractLatchingSolver, dense_info, field_of


class Quadrature(NamedTuple):
    """A rule for the mean of a force over the part of a step in which the force acts, with one node in this part."""

    node: float
    """Distance of the node from the place where the force begins or ends, over the length of the part."""
    weight: float
    """Weight of the node."""
    end: float
    """Weight of each end of the step; at an end that is not in the part the force is zero."""


THROUGH = Quadrature(1 / 2, 2 / 3, 1 / 6)
"""Simpson's rule, where a force acts in the whole step, or where its damping ends or begins it."""
CROSSING = Quadrature(5 / 9, (0.4 - 1 / 7) / (5 / 9) ** 1.5, 1 / 7)
"""Where a gap closes or opens: exact for powers 1.5, 2.5 and 3.5 of the distance from there."""


def knows_contacts(scene: Scene) -> bool:
    """Return whether `ImpulseRK4` can integrate a scene's contacts: with a latch of the package, or without memory.

    With `SmoothSwitch` the force has no kinks.
    """
    return not scene.contact.has_memory or type(scene.contact_memory) in (EventLatch, PeakRateLatch)


class Ends(NamedTuple):
    """The contacts at the end of a step; arrays of shape (points,)."""

    gap: Array  # [m]
    rate: Array  # Eq. (8)'s rate of the gap [m/s]
    turning: Array  # the gap's true rate minus Eq. (8)'s rate: the part from the rotation of the normals [m/s]
    force: Array  # [N]
    wrench: list[Array]  # wrench of all contacts together, see `resultants`


class Middle(NamedTuple):
    """The contacts in the middle of a step."""

    directions: tuple[Array, ...]  # `wrench_directions` of a unit normal force
    wrench: list[Array]


class ImpulseRK4(AbstractLatchingSolver):
    """England's RK4 with the event latch; the impulses of contacts are integrated along cubics of their gaps.

    The rate at a touchdown is the rate of the gap's cubic without the contact's own impulse. There is no error
    estimate: constant steps only. Source of the stages: England 1969, doi:10.1093/comjnl/12.2.166.

    **Raises:** `ValueError` for contacts for which `knows_contacts` is False, and for a user's own vector field,
    whose forces the solver does not know.
    """

    explicit: ClassVar = True
    restarts_each_period: ClassVar = True  # the values kept from a step include its correction to first order only

    def order(self, terms):
        return 4

    def rates(self, solver_state):
        return solver_state[0]

    def init(self, terms, t0, t1, y0, args):
        field = field_of(terms)
        if type(field) is not VectorField or not knows_contacts(args.scene):
            raise ValueError(
                "Argument `solver` must be another one than ImpulseRK4, which knows contacts with a latch of "
                f"slipperjax or without memory, for a {type(field).__name__} with memory "
                f"{type(args.scene.contact_memory).__name__}."
            )
        t0 = jnp.asarray(t0, float)
        rail = _moving(args, t0)
        frame = bent(rail[0], y0.rail)
        now = contacts(frame, y0.motion)
        turning = _turning(args, t0, rail, y0)
        return _ended(args, t0, frame, now, turning, y0)

    @jax.jit  # diffrax traces it more than once
    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        k1, before = solver_state
        scene = args.scene
        m0 = y0.motion
        dt = t1 - t0
        half = t0 + 0.5 * dt
        middle = args.frame(half)
        rail = _moving(args, t1)
        rails = rails_in_step(args, half, dt, y0.rail)

        def stage(pressed, *rates):
            """Return the contacts and the motion's derivative in the middle of the step.

            **Arguments:** `pressed`: wrench that bent the rails since the start; `rates`: the motion has their mean.
            """
            frame = rails.halfway(middle, pressed)
            m = store(jax.tree.map(lambda a, *k: a + 0.5 * dt / len(rates) * sum(k), m0, *rates))
            at = forces_at(scene, frame, contacts(frame, m), State(m, y0.memory))
            directions = wrench_directions(scene, at, args.travel(half))
            wrench, _ = resultants(frame, [at.force * d for d in directions])
            return Middle(directions, wrench), _rates(args, half, m, wrench)

        second, k2 = stage(before.wrench, k1)
        third, k3 = stage([(a + b) / 2 for a, b in zip(before.wrench, second.wrench, strict=True)], k1, k2)
        y4 = store(jax.tree.map(lambda a, q, r: a + dt * (2 * r - q), m0, k2, k3))
        # the contacts' wrench at the end is on a line through those at the start and in the middle
        k4 = _rates(args, t1, y4, [2 * b - a for a, b in zip(before.wrench, third.wrench, strict=True)])
        predicted = jax.tree.map(lambda a, p, r, k: a + (dt / 6) * (p + 4 * r + k), m0, k1, k3, k4)
        state = State(store(predicted), y0.memory)
        y1, rates, after = _corrected(args, rail, rails, before, third, t1, dt, state)
        rates = store(rates)
        dense = dense_info(dt, y0, y1, State(k1, None), State(rates, None))
        return y1, None, dense, (rates, after), RESULTS.successful


def _corrected(
    args: Args,
    rail: tuple,
    rails: RigidRails,
    before: Ends,
    middle: Middle,
    t1,
    dt,
    state: State,
) -> tuple[State, Motion, Ends]:
    """Return the state, its derivative and the contacts at the end of a step, for which the stages predict `state`.

    **Arguments:** `rail`: `_moving` at the end of the step; `rails`: those of the step; `middle`: of the last stage
    in the middle of the step.
    """
    scene = args.scene
    m = state.motion
    memory = state.memory
    travel = args.travel(t1)
    seconds = dt * args.travel(t1 - 0.5 * dt).period
    straight, _ = rail
    # the prediction has these means of the wrench over the step, from which velocities follow, and of the wrench
    # times the part of the step that is left, from which positions follow
    predicted = middle.wrench, [(a + 2 * b) / 6 for a, b in zip(before.wrench, middle.wrench, strict=True)]
    frame, bending = rails.end(straight, *predicted)
    now = contacts(frame, m)
    lever = store(now.lever)
    gap, turning = store((now.gap, _turning(args, t1, rail, State(m, memory, bending))))

    def along(y: Array, z: Array, *turn: Array) -> Array:
        """Return how far, or how fast, the points move along their normals; `turn`: rotations, then modes if any."""
        moves = [y, z]
        if m.modes is not None:
            (moves,) = carried(frame, (y, z, turn[3]))
        # mode shapes along the rail have three axes, others two
        parts = zip((*frame.normal[-len(moves) :], *lever), (*moves, *turn[:3]), strict=True)
        return jnp.asarray(sum(d * part for d, part in parts))

    modal_rate = [] if m.modes is None else [m.modes.rate]
    rate = along(m.v_y, m.v_z, m.w_x, m.w_y, m.w_z, *modal_rate) - frame.velocity
    compliance = [seconds / scene.slipper.mass] * 2 + [seconds / j for j in scene.slipper.inertia]
    if m.modes is not None:
        # modes have unit mass
        compliance = [*compliance, seconds]
    # in the step of a touchdown the memory is still zero, and the damping is that at the touchdown
    last = forces_at(scene, frame, Contacts(gap, rate, lever), State(m, memory))
    rate, force = store((rate, last.force))
    last = last._replace(force=force)

    path = _path(before, gap, rate, turning, seconds)
    place, length, touches, bends = _edge(scene, path, gap, rate, memory)
    rule = Quadrature(*(jnp.where(bends, *pair) for pair in zip(CROSSING, THROUGH, strict=True)))
    x = store_cotangent(place + length * rule.node)
    at_node = contact_forces(scene, Contacts(path.gap.value(x), path.rate_at(x), lever), memory)
    inside = store(jnp.abs(length) * rule.weight * at_node)
    # The directions of forces turn in the step. Forces act along the directions of the middle, but as by Simpson's
    # rule a sixth of the forces at the ends acts along the directions there.
    at_ends = jnp.abs(length) * rule.end - 1 / 6
    along_middle = inside + at_ends * (before.force + last.force)
    early = (1 - x) * inside + at_ends * before.force
    sixth = last.force * (1 / 6)
    directions = zip(middle.directions, wrench_directions(scene, last, travel), strict=True)
    *impulses, _ = resultants(
        frame,
        [along_middle * d + sixth * end for d, end in directions],
        [early * d for d in middle.directions],
    )
    found = [[a + b / 6 for a, b in zip(impulse, before.wrench, strict=True)] for impulse in impulses]
    # changes of velocities and of positions; the wrench may end with forces on rails, which do not move the body
    kick, move = (
        [c * (new - old) for c, new, old in zip(compliance, *means, strict=False)]
        for means in zip(found, predicted, strict=True)
    )
    move = [seconds * v for v in move]
    # rotation of the attitude, at the predicted attitude
    turn = attitude_rates(dataclasses.replace(m, w_x=move[2], w_y=move[3], w_z=move[4]))
    after = moved(m, Motion(move[0], move[1], *turn, *kick[:5]))
    if m.modes is not None:
        modes = ModalMotion(m.modes.coordinate + move[5], m.modes.rate + kick[5])
        after = dataclasses.replace(after, modes=modes)
    m, kick, move = store((after, kick, move))
    end = Contacts(gap + along(*move), rate + along(*kick), lever)
    settled, bending = rails.end(straight, *found)
    end = rails.moved(frame, settled, end)
    if memory is not None:
        # compliance of each point along its normal
        own = sum(c * d**2 for c, d in zip(compliance, (*frame.normal[1:], *lever), strict=False))
        if m.modes is not None:
            own = own + seconds * modal_compliance(frame)
        own = rails.compliance(frame, own)
        faster = end.rate - rate
        nearer = (end.gap - gap) / seconds
        at = _touchdown_rate(path, place, faster, nearer, own * last.force)
        slowest = -scene.contact_memory.slowest
        at = jnp.where(touches & (at < slowest), at, slowest)
        memory = store_if_differentiated(jnp.where(touches, 1 / at, memory))
        rates = Rates(path.rate, path.rise, path.bend, end.rate)
        memory = jnp.where(end.gap >= 0, 0.0, scene.contact_memory.kept(memory, rates, touches))
    state = State(m, memory, bending)
    return state, *_ended(args, t1, settled, end, turning, state)


def _rates(args: Args, t, m: Motion, wrench: list[Array]) -> Motion:
    """Return the derivative of the motion [per forcing period] under the contacts' wrench."""
    travel = args.travel(t)
    return per_period(travel, newton_euler(args.scene, m, wrench, travel))


def _ended(
    args: Args,
    t,
    frame: RailFrame,
    now: Contacts,
    turning: Array,
    state: State,
) -> tuple[Motion, Ends]:
    """Return the derivative [per forcing period] and the contacts at the end of a step."""
    at = forces_at(args.scene, frame, now, state)
    directions = wrench_directions(args.scene, at, args.travel(t))
    wrench, _ = resultants(frame, [at.force * d for d in directions])
    return _rates(args, t, state.motion, wrench), Ends(now.gap, now.rate, turning, at.force, wrench)


class _Path(NamedTuple):
    """Gaps over a step, of x from 0 to 1; arrays of shape (points,)."""

    gap: Cubic  # [m]
    rate: Array  # Eq. (8)'s rate of the gap [m/s] is rate + rise x + bend x^2
    rise: Array
    bend: Array

    def rate_at(self, x) -> Array:
        return (self.bend * x + self.rise) * x + self.rate


def _path(before: Ends, gap: Array, rate: Array, turning: Array, seconds) -> _Path:
    """Return the gaps over a step of some seconds, from values at both ends; `turning` is assumed to be linear."""
    rise = gap - before.gap
    slope = seconds * (before.rate + before.turning)
    per_second = 1 / seconds
    a = slope + seconds * (rate + turning) - 2 * rise
    b = rise - slope - a
    more = 2 * per_second * b + before.turning - turning
    return _Path(Cubic(before.gap, slope, b, a), before.rate, more, 3 * per_second * a)


def _edge(
    scene: Scene,
    path: _Path,
    gap: Array,
    rate: Array,
    memory: Array | None,
) -> tuple[Array, ...]:
    """Return where each force begins or ends in a step, and over which part of the step the force acts.

    **Returns:** the place, from 0 to 1, or 0 where the force neither begins nor ends; the length from this place over
    which the force acts, negative if the force acts before the place; whether the contact begins; whether the force
    has the kink of a gap that opens or closes.
    """
    start = path.gap.start
    touches = (gap < 0) & ((start >= 0) if memory is None else (memory == 0))
    opens = (gap >= 0) & (start < 0)
    # 1 where the force begins, -1 where it ends, 0 where it does neither: numbers, because XLA handles truth values
    # of arrays one at a time
    kind = jnp.where(touches, 1.0, jnp.where(opens, -1.0, 0.0))
    limit = 0.0
    if scene.contact.clamp:
        # twice these numbers where damping ends the force of a closed contact, or lets the force begin again: there
        # 1 + damping ratio is zero
        one, other = (1 + damping_ratios(scene, v, memory) for v in (path.rate, rate))
        limited = (start < 0) & (one * other < 0)
        kind = jnp.where(limited, jnp.where(other < 0, -2.0, 2.0), kind)
        limit = jnp.where(limited, one / jnp.where(limited, one - other, 1.0), 0.0)
    kind = store(kind)
    bends = kind * kind == 1
    place = store(jnp.where(bends, sign_change(path.gap, gap, bends), limit))
    return place, jnp.where(kind < 0, -place, 1 - place), kind == 1, bends


def _touchdown_rate(path: _Path, x: Array, faster: Array, nearer: Array, pressed: Array) -> Array:
    """Return the rate [m/s] of a gap at x, where a contact begins, without the effect of the contact's own force.

    **Arguments:** `faster`, `nearer`: what the impulses add to the predicted rate at the end of the step, and to the
    mean rate over the step [m/s]; `pressed`: change of the rate if the force at the end acted over the step [m/s].
    """
    left = 1 - x
    # means of a force that grows with the power 1.5 of the distance from x, and of the force times what is left
    faster = faster - 0.4 * left * pressed
    nearer = nearer - (0.4 - 2 / 7) * left * left * pressed
    return path.rate_at(x) + x * ((3 * x - 2) * faster + 6 * left * nearer)


def _moving(args: Args, t) -> tuple[RailFrame, RailFrame]:
    """Return the rail, and its derivative with respect to time [per forcing period]."""
    return jax.jvp(args.frame, (t,), (jnp.ones_like(t),))


def _turning(args: Args, t, rail: tuple[RailFrame, RailFrame], y: State) -> Array:
    """Return the gap's true rate minus Eq. (8)'s rate [m/s]; `rail`: from `_moving`."""
    frame, change = rail
    # deflections turn with the normals
    change = bent(change._replace(arm=frame.arm, shapes=frame.shapes), y.rail)
    return contacts(change, y.motion).gap * (1 / args.travel(t).period) + frame.velocity
