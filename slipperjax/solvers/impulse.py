"""RK4 that integrates the impulse of each contact anew: a step that knows where contacts begin and end.

Eq. (12)'s force has a kink in its second derivative where a contact begins or ends. The stages of a Runge-Kutta
method do not see where that is, which costs it an order in values and another one in derivatives. Here the force of
each contact is integrated again after the stages, along the cubic of its gap over the step, over the part of the step
in which that cubic is closed. The motion gets the difference of the two impulses.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import RESULTS
from jaxtyping import Array

from ..model.dynamics import Args, LatchedField, MemorylessField, State, motion_rates
from ..model.kinematics import Contacts, Motion, RailFrame, attitude_rates, contacts
from ..model.scene import Scene
from ..tools.fused import kept, materialise, sums
from .explicit import RK4
from .latching import AbstractLatchingSolver, dense_info, field_of

THROUGH = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))
"""Nodes of steps through which a contact is closed: Gauss's, of equal weights."""
CROSSING = ((0.40746008687889573, 0.5), (0.8620943387027721, 0.33725413294672596))
"""Nodes and weights from where a contact begins or ends: exact for powers 1.5, 2.5 and 3.5 of that distance."""
STIFFEST = 0.3
"""Square of the step times a contact's frequency, about which its impulse fades to RK4's: its cubic tells nothing."""


class Ends(NamedTuple):
    """The contacts at the end of a step; arrays of shape (points,)."""

    gap: Array
    rate: Array
    """Eq. (8)'s rate of the gap [m/s]."""
    turning: Array
    """The gap's true rate less Eq. (8)'s: that of the normals' own rotation [m/s]."""
    force: Array
    """Normal forces [N]."""


class ImpulseRK4(AbstractLatchingSolver):
    """RK4 with the event latch whose contact impulses are integrated on the cubics of their gaps.

    Contacts too stiff for the step, see `STIFFEST`, keep RK4's impulse. The rate at a touchdown is that of the gap's
    cubic without the contact's own impulse. No error estimate: constant steps only.

    **Raises:** `ValueError` for other fields than those of contacts that are latched or have no memory: with
    `SmoothSwitch` there are no kinks to know, and of a field of one's own it would not see the forces.
    """

    a_lower: ClassVar = RK4.a_lower
    b_error: ClassVar = None

    def order(self, terms):
        del terms
        return 4

    def init(self, terms, t0, t1, y0, args):
        field = field_of(terms)
        if not isinstance(field, LatchedField | MemorylessField):
            raise ValueError(
                f"Argument `solver` must be another one than ImpulseRK4 for a {type(field).__name__}, as scenes with "
                "memory=SmoothSwitch() have: it knows contacts that are latched or have no memory."
            )
        t0 = jnp.asarray(t0, float)
        frame = args.frame(t0)
        now = contacts(frame, y0.motion)
        force = _forces(args.scene, now, y0.memory)
        turning = _turning(args, t0, frame, y0.motion)
        return _rates(args.scene, frame, now, y0.motion, force), Ends(now.gap, now.rate, turning, force)

    @jax.jit  # diffrax traces it more than once
    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del terms, made_jump
        k1, before = solver_state
        scene, m0, memory, dt = args.scene, y0.motion, y0.memory, t1 - t0
        middle, last = args.frame(t0 + 0.5 * dt), args.frame(t1)

        def stage(frame, rates, share):
            m = materialise(jax.tree.map(lambda a, k: a + share * dt * k, m0, rates))
            now = contacts(frame, m)
            force = kept(_forces(scene, now, memory))
            return m, _rates(scene, frame, now, m, force), force

        y2, k2, f2 = stage(middle, k1, 0.5)
        y3, k3, f3 = stage(middle, k2, 0.5)
        y4, k4, f4 = stage(last, k3, 1.0)
        # m0 + dt (k1 + 2 k2 + 2 k3 + k4) / 6
        end = jax.tree.map(lambda a, p, q, r, k: (p + 2 * q + r - a) * (1 / 3) + (dt / 6) * k, m0, y2, y3, y4, k4)
        mean, mean_shift = kept(((before.force + 2 * (f2 + f3) + f4) / 6, (before.force + f2 + f3) / 6))
        y1, rates, after = _corrected(args, last, before, t1, dt, materialise(end), memory, mean, mean_shift)
        rates = materialise(rates)
        dense = dense_info(dt, y0, y1, State(k1, None), State(rates, None))
        return y1, None, dense, (rates, after), RESULTS.successful


def _corrected(
    args: Args, frame: RailFrame, before: Ends, t1: Any, dt: Any, m: Motion, memory: Array | None, mean, mean_shift
) -> tuple[State, Motion, Ends]:
    """The state, its derivative and the contacts at the end of a step that RK4 ends at `m`.

    **Arguments:** `mean` and `mean_shift`: forces [N] in the means of which over the step RK4's change of velocity
    and, beyond that at a constant velocity, of position consist, of shape (points,).
    """
    scene, seconds = args.scene, dt * args.scene.period
    now = contacts(frame, m)
    lever = materialise(now.lever)
    gap, turning = materialise((now.gap, _turning(args, t1, frame, m)))
    directions = (*frame.normal[1:], *lever)
    along = lambda c: sum(d * part for d, part in zip(directions, c, strict=True))
    rate = materialise(along((m.v_y, m.v_z, m.w_x, m.w_y, m.w_z)) - frame.velocity)
    compliance = [seconds / scene.slipper.mass] * 2 + [seconds / j for j in scene.slipper.inertia]
    own = kept(sum(c * d**2 for c, d in zip(compliance, directions, strict=True)))

    # the gap over the step, before.gap + s x + b x^2 + a x^3
    rise = gap - before.gap
    s = seconds * (before.rate + before.turning)
    a = s + seconds * (rate + turning) - 2 * rise
    b = rise - s - a
    a, b = kept((a, b))
    enter = (gap < 0) & ((before.gap >= 0) if memory is None else (memory == 0))
    leave = (gap >= 0) & (before.gap < 0)
    cross = enter | leave
    x = _zero(cross, before.gap, s, b, a, -rise)
    per_second = 1 / seconds

    def eq_8_rate(place):
        return before.rate + place * ((3 * per_second * a * place + 2 * per_second * b) + before.turning - turning)

    if memory is None:
        began = None
    else:
        # the rate at which the contact would begin without its own impulse
        less = own * (6 * mean_shift - 2 * mean + 3 * x * (mean - 2 * mean_shift))
        at, slowest = eq_8_rate(x) - x * less, -scene.memory.slowest
        began = jnp.where(enter, 1 / jnp.where(enter & (at < slowest), at, slowest), memory)

    # means of the force over the step, and of the force times the distance from the step's start
    way = jnp.where(leave, -x, 1 - x)  # from where the contact begins or ends, or from the step's start
    impulse = shift = 0.0
    for through, (crossing, weight) in zip(THROUGH, CROSSING, strict=True):
        place = x + way * jnp.where(cross, crossing, through)
        at_gap = ((a * place + b) * place + s) * place + before.gap
        part = jnp.where(cross, weight, 0.5) * _forces(scene, Contacts(at_gap, eq_8_rate(place), lever), began)
        impulse, shift = impulse + part, shift + part * place
    width = jnp.where(leave, x, 1 - x)
    # fourth power of the step times the contact's frequency, whose square is 3/2 K d^(1/2) over the mass at the point
    deepest = jnp.where(gap < before.gap, gap, before.gap)
    stiffness = (1.5 / STIFFEST * scene.contact.stiffness * seconds) * own
    share = 1 / (1 + jnp.square(jnp.square(stiffness)) * jnp.square(deepest))
    more, more_shift = share * (width * impulse - mean), share * (width * (impulse - shift) - mean_shift)

    total = sums(*(more * d for d in directions), *(more_shift * d for d in directions))
    kick = [c * v for c, v in zip(compliance, total[:5], strict=True)]
    move = [seconds * c * v for c, v in zip(compliance, total[5:], strict=True)]
    turn = attitude_rates(Motion(m.y, m.z, m.q_x, m.q_y, m.q_z, 0.0, 0.0, *move[2:]))
    m, kick, move = materialise((jax.tree.map(jnp.add, m, Motion(move[0], move[1], *turn, *kick)), kick, move))
    end = Contacts(gap + along(move), rate + along(kick), lever)
    memory = None if memory is None else jnp.where(end.gap >= 0, 0.0, began)
    force = _forces(scene, end, memory)
    return State(m, memory), _rates(scene, frame, end, m, force), Ends(end.gap, end.rate, turning, force)


@jax.custom_jvp
def _zero(asked: Array, start: Array, s: Array, b: Array, a: Array, fall: Array) -> Array:
    """Where start + s x + b x^2 + a x^3, which falls by `fall` from 0 to 1, is zero [1]; 0 where not `asked`.

    A step of Newton's method from the chord, with both divisions in one.
    """
    curve, turn, slope = a * start * start, b * start * fall, s * fall * fall
    steep = 3 * curve + 2 * turn + slope
    good = asked & (steep * fall < 0)
    over = jnp.where(good, start * (2 * curve + turn - fall * fall * fall), jnp.where(asked, start, 0.0))
    under = jnp.where(good, fall * steep, jnp.where(asked, fall, 1.0))
    return jnp.minimum(jnp.maximum(over / under, 0.0), 1.0)


@_zero.defjvp
def _zero_jvp(primals, tangents):
    """The derivative of the zero itself, not of the way to it."""
    asked, _, s, b, a, fall = primals
    _, d_start, d_s, d_b, d_a, _ = tangents
    x = _zero(*primals)
    steep = (3 * a * x + 2 * b) * x + s
    good = asked & (steep * fall < 0) & (x > 0) & (x < 1)
    change = ((d_a * x + d_b) * x + d_s) * x + d_start
    return x, jnp.where(good, -change, 0.0) / jnp.where(good, steep, 1.0)


def _forces(scene: Scene, now: Contacts, memory: Array | None) -> Array:
    """Normal forces [N] on the slipper, stored."""
    ratio = None if memory is None else scene.memory.rate_ratio(memory, now.rate)
    return scene.contact.stored_force(now.gap, now.rate, ratio)


def _rates(scene: Scene, frame: RailFrame, now: Contacts, m: Motion, force: Array) -> Motion:
    """Derivative of the motion [per forcing period]."""
    return jax.tree.map(lambda r: scene.period * r, motion_rates(scene, frame, now, m, force))


def _turning(args: Args, t: Any, frame: RailFrame, m: Motion) -> Array:
    """The gap's true rate less Eq. (8)'s [m/s]."""
    _, change = jax.jvp(args.frame, (t,), (jnp.ones_like(t),))
    return contacts(change._replace(arm=frame.arm), m).gap * (1 / args.scene.period) + frame.velocity
