"""State, equations of motion and reactions, Eqs. (13)-(14) and (A1)-(A6) of Dang et al. 2024.

Time is counted in forcing periods from the start of the period `epoch`, so that the phase of the forcing is the same
number for all speeds of a sweep and keeps its precision after any number of periods. Derivatives are per period.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import instance, real, require, shown_number
from ..tools.forms import store_cotangent, store_if_differentiated, sums
from ..tools.types import Real
from .beam import RailState, RailStep
from .contact import Before
from .kinematics import (
    Contacts,
    ModalMotion,
    Motion,
    PayloadMotion,
    Points,
    RailFrame,
    attitude_rates,
    bent,
    body_numbers,
    contacts,
    cross,
    in_slipper_frame,
    rail_frame,
    rail_step,
    rotation,
    track_nodes,
)
from .linearised import Linearised, contact_linearised, dense_linearised
from .modes import Modes
from .payload import Payload
from .scene import Scene
from .sliding import tractions
from .slipper import stacked
from .step_size import settle_memory
from .travel import Travel


class State(eqx.Module):
    """The state of one case."""

    motion: Motion
    """Position, attitude and velocities of the slipper or sled, in SI units."""
    memory: Float[Array, " points"] | None
    """Memory of each contact point, with the unit of `slipperjax.model.contact`; None for laws without memory."""
    rail: RailState | None = None
    """How the rails bend; None for rigid rails."""

    def at_nodes(self) -> "State":
        """The state with the rails' deflections alone, without their waves."""
        return self if self.rail is None else eqx.tree_at(lambda state: state.rail.waves, self, None)

    def __repr__(self) -> str:
        return f"State({self.motion!r}, memory={shown_number(self.memory)})"


class Acting(NamedTuple):
    """The contacts and their forces at one instant, see `forces_at`."""

    frame: RailFrame
    contacts: Contacts
    motion: Motion
    force: Float[Array, " points"]
    """Normal forces [N], Eq. (12)."""


class Args(NamedTuple):
    """Arguments of the vector field other than time and state."""

    scene: Scene
    epoch: Real = 0
    """Forcing periods travelled before time zero [1]."""
    points: Points | None = None
    """Contact points of the scene, see `contact_points`; with None they are computed in each evaluation."""
    rail_step: RailStep | None = None
    """What each step needs about rails that bend, where all steps are equal; None: computed in each step."""

    @jax.jit
    def frame(self, t: Real) -> RailFrame:
        """Return the rail under the slipper at time `t` [forcing periods]."""
        return rail_frame(self.scene, self.epoch + t, self.points)

    def travel(self, t: Real) -> Travel:
        """Return speed and pace at time `t` [forcing periods]."""
        return self.scene.travel(self.epoch + t)

    def bending(self, t: Real, step: Real) -> RailStep | None:
        """Return what a step [forcing periods] around time `t` needs about the rails; None for rigid rails."""
        if self.scene.beam is None or self.rail_step is not None:
            return self.rail_step
        travel = self.travel(t)
        return rail_step(self.scene, travel.speed, step * travel.period, self.points)


def rate_ratios(scene: Scene, rate: Array, memory: Array | None) -> Array | None:
    """Return g' / g'_0 [1] of contacts from their gap rates [m/s] and memories; None for a law without memory."""
    return None if memory is None else scene.contact_memory.rate_ratio(memory, rate)


def damping_ratios(scene: Scene, rate: Array, memory: Array | None) -> Array | float:
    """Return the damping force of contacts over the elastic force [1], from their gap rates [m/s] and memories."""
    return scene.contact.damping(rate, rate_ratios(scene, rate, memory))


def contact_forces(scene: Scene, now: Contacts, memory: Array | None) -> Float[Array, " points"]:
    """Return normal forces [N] on the slipper, Eq. (12); `memory`: shape (points,), or None."""
    return store_cotangent(scene.contact.force(now.gap, now.rate, rate_ratios(scene, now.rate, memory)))


def forces_at(scene: Scene, frame: RailFrame, now: Contacts, state: State) -> Acting:
    """Return the contacts with their normal forces, from which accelerations and loads follow."""
    return Acting(frame, now, state.motion, contact_forces(scene, now, state.memory))


def per_force(scene: Scene, at: Acting, travel: Travel) -> tuple[Array, ...]:
    """Return force along x, y and z [1] and moment about the slipper's x, y and z [m] of unit normal forces.

    Friction is included; its coefficient may depend on the forces. Shape (points,) each.
    """
    directions = (*at.frame.normal, *at.contacts.lever)
    if scene.friction is None:
        return directions
    traction, moment, _ = tractions(scene.friction, at.frame, at.motion, at.force, travel.speed)
    return tuple(d + f for d, f in zip(directions, (*traction, *moment), strict=True))


def wrench_directions(scene: Scene, at: Acting, travel: Travel) -> tuple[Array, ...]:
    """Return the parts of `per_force` that move the body: force along x only if the modes' shapes have an x."""
    every = per_force(scene, at, travel)
    return every if len(at.frame.shapes or ()) == 3 else every[1:]


def resultants(frame: RailFrame, *loads: Sequence[Array], others: Sequence[Array] = ()) -> list[list[Array]]:
    """Return the wrench of each of some loads, summed over the points in one pass.

    A wrench is the force along y and z [N] and the moment about the body's x, y and z [N m]; for an elastic body also
    an array of the force on each mode [N kg^-0.5]; for rails that bend then an array of the forces on their nodes,
    (2, nodes) [N].

    **Arguments:** `loads`: each is a force or a moment of all points along each of `wrench_directions`, (points,);
    `others`: further values to be summed over the points; their sums are the last result.
    """
    flat = [part for load in loads for part in load]
    if frame.shapes is None and frame.deflection is None:
        total = sums(*flat, *others)
        wrenches = [total[k : k + 5] for k in range(0, len(flat), 5)]
        return [*wrenches, total[len(flat) :]]
    if frame.shapes is None and frame.deflection is not None and frame.deflection.shape[-1] == 2:
        # in the same pass the forces on the front node; the rear node has the rest
        points = len(flat[0])
        front = np.arange(points) < points // 2
        total = sums(*flat, *others, *(jnp.where(front, part, 0.0) for load in loads for part in load[:2]))
        at_front = total[len(flat) + len(others) :]
        wrenches = []
        for k in range(len(loads)):
            own, push = total[5 * k : 5 * k + 5], jnp.stack(at_front[2 * k : 2 * k + 2])
            wrenches.append([*own, jnp.stack([-push, push - jnp.stack(own[:2])], axis=1)])
        return [*wrenches, total[len(flat) : len(flat) + len(others)]]
    # first the force of each slipper, which moves the modes, or of each node
    axes = len(frame.shapes or (0, 0))
    groups = len((frame.shapes or frame.normal)[0]) if frame.deflection is None else frame.deflection.shape[-1]
    of_groups = sums(*(part.reshape(groups, -1) for part in (*flat, *others)))
    total = sums(*of_groups)
    wrenches = []
    for k in range(0, len(flat), axes + 3):
        wrench = list(total[k + axes - 2 : k + axes + 3])
        if frame.shapes is not None:
            push = of_groups[k : k + axes]
            if frame.deflection is not None:
                # a slipper has two nodes
                push = sums(*(force.reshape(-1, 2) for force in push))
            wrench += sums(sum(shape.T * force[None] for force, shape in zip(push, frame.shapes, strict=True)))
        if frame.deflection is not None:
            wrench.append(-jnp.stack(of_groups[k + axes - 2 : k + axes]))
        wrenches.append(wrench)
    return [*wrenches, total[len(flat) :]]


def drive_force(scene: Scene, at: Acting, travel: Travel) -> Array:
    """Return the force along x that keeps the speed, the multiplier of Eq. (A6) [N]."""
    drive = -jnp.sum(at.force * per_force(scene, at, travel)[0], axis=-1)
    # applied loads and the acceleration of masses also act on the drive
    if scene.load is not None:
        drive = drive - scene.load.wrench(travel)[0][0]
    # constant speeds add no operations
    return drive if travel.acceleration is None else drive + driven_mass(scene) * travel.acceleration


def driven_mass(scene: Scene) -> Array:
    """Return the mass that the drive accelerates [kg]: the slipper and the sled on it."""
    return scene.slipper.mass if scene.payload is None else scene.slipper.mass + scene.payload.mass


def slipper_wrenches(scene: Scene, at: Acting, travel: Travel) -> list[Array]:
    """Return the net force of each slipper's contacts along x, y and z [N], and their net moment about the slipper's
    middle along the body's x, y and z axes [N m], friction included; shape (*slippers,) each."""
    # a single slipper has no axis of slippers
    axes = scene.point_shape[:-2]
    total = sums(*((at.force * w).reshape(*axes, -1) for w in per_force(scene, at, travel)))
    if not axes:
        return total
    force, moment = total[:3], total[3:]
    middle = list(map(stacked, zip(*(slipper.place for slipper in scene.mounted), strict=True)))
    # from the moment about the body's centre to the moment about each slipper's middle
    carried = cross(middle, in_slipper_frame(rotation(at.motion), force))
    return [*force, *(m - c for m, c in zip(moment, carried, strict=True))]


def static_loads(scene: Scene, travel: Travel) -> Array:
    """Return each slipper's static share of weight and applied load along z [N], (*slippers,); NaN without either."""
    down = 0.0 if scene.gravity is None else driven_mass(scene) * scene.gravity
    if scene.load is not None:
        down = down - scene.load.wrench(travel)[0][2]
    loads = jnp.abs(jnp.reshape(down * scene.slipper.static_shares, scene.point_shape[:-2]))
    return jnp.where(loads > 0, loads, jnp.nan)


def newton_euler(scene: Scene, m: Motion, wrench: list[Array], travel: Travel) -> Motion:
    """Return the derivative of the motion [per second] under the contacts' wrench and the scene's load.

    **Arguments:** `wrench`: as of `resultants`.
    """
    rigid, modal = wrench[:5], wrench[5:]
    if scene.load is not None:
        (_, *push), moment = scene.load.wrench(travel)
        rigid = [w + extra for w, extra in zip(rigid, (*push, *moment), strict=True)]
    f_y, f_z, t_x, t_y, t_z = rigid
    falling = lambda upwards: upwards if scene.gravity is None else upwards - scene.gravity
    payload = modes = None
    if scene.payload is not None:
        on_slipper = payload_force(scene.payload, m)
        f_y = f_y + on_slipper[0]
        f_z = f_z + on_slipper[1]
        # the mass gets the opposite force
        own_y, own_z = (-on_slipper[k] / scene.payload.mass for k in range(2))
        payload = PayloadMotion(own_sled(m).v_y, own_sled(m).v_z, own_y, falling(own_z))
    if scene.slipper.modes is not None:
        modes = modal_rates(scene.slipper.modes, m, modal[0])
    # reciprocals, because a product's derivative is shorter than a division's
    per_mass = 1 / scene.slipper.mass
    j_x, j_y, j_z = scene.slipper.inertia
    per_x, per_y, per_z = (1 / j for j in (j_x, j_y, j_z))
    a_z = f_z * per_mass
    # Euler's equations, for principal axes
    return Motion(
        m.v_y,
        m.v_z,
        *attitude_rates(m),
        f_y * per_mass,
        falling(a_z),
        (t_x - (j_z - j_y) * m.w_y * m.w_z) * per_x,
        (t_y - (j_x - j_z) * m.w_z * m.w_x) * per_y,
        (t_z - (j_y - j_x) * m.w_x * m.w_y) * per_z,
        payload,
        modes,
    )


def modal_rates(modes: Modes, m: Motion, force: Float[Array, " modes"]) -> ModalMotion:
    """Return the derivative of the modes' motion [per second] from a modal force [N kg^-0.5]."""
    now = m.modes
    if now is None:
        raise ValueError("Argument `start` must be of a scene with elastic modes: take a Motion, or a run's end.")
    circular = 2 * jnp.pi * modes.frequency
    return ModalMotion(now.rate, force - circular * (circular * now.coordinate + 2 * modes.damping * now.rate))


def own_sled(m: Motion) -> PayloadMotion:
    """Return the motion of the mass on the slipper; raises `ValueError` where there is none."""
    if m.payload is None:
        raise ValueError("Argument `start` must be of a scene with a sled: take a Motion, or a run's end.")
    return m.payload


def payload_force(sled: Payload, m: Motion) -> Array:
    """Return the sled's lateral and vertical force on the slipper [N]."""
    own = own_sled(m)
    deflection = jnp.stack([own.y - m.y, own.z - m.z])
    return sled.force(deflection, jnp.stack([own.v_y - m.v_y, own.v_z - m.v_z]))


def motion_rates(scene: Scene, at: Acting, travel: Travel) -> Motion:
    """Return the derivative of the motion [per second] from the contacts and their forces at one instant."""
    wrench, _ = resultants(at.frame, [at.force * w for w in wrench_directions(scene, at, travel)])
    return newton_euler(scene, at.motion, wrench, travel)


def per_period(travel: Travel, rates: Motion) -> Motion:
    """Return rates [per second] as rates [per forcing period]."""
    period = store_if_differentiated(travel.period)  # or else each rate would have a division
    return jax.tree.map(lambda r: period * r, rates)


class VectorField(eqx.Module):
    """The right-hand side of a scene for `diffrax.ODETerm`, with the methods that latching solvers call.

    It integrates the ten numbers of the motion and, where the contact memory is integrated, one number for each
    contact point. A latched memory is constant during a step; `close_step` changes it at the end of each step.
    Subclasses with forces of their own define `from_contacts`.
    """

    def __call__(self, t: Real, state: State, args: Args) -> State:
        """Return the derivative of the whole state [per forcing period], as an ODE for any solver.

        **Raises:** `equinox.EquinoxRuntimeError` for a latched memory, which changes only where a solver of
        `slipperjax` ends a step. Use `evaluate` for the derivative at one instant.
        """
        rates = self.evaluate(t, state, args)
        if rates.memory is not None or state.memory is None:
            return rates
        # at run time and only where the result is used, because diffrax asks each right-hand side for its shapes
        text = (
            "Argument `solver` must be one of slipperjax, or slipperjax.solvers.Latching of one of diffrax's, for a "
            "contact memory that changes between steps, such as EventLatch: no other latches touchdowns. With "
            "memory=SmoothSwitch() any solver serves."
        )
        return eqx.error_if(fill_frozen(rates, state), jnp.asarray(t) == t, text)

    @jax.jit  # traced once for all stages of all steps, which halves the time of tracing
    def evaluate(self, t: Real, state: State, args: Args, frame: RailFrame | None = None) -> State:
        """Return the derivative [per forcing period], with None for parts that are constant over a step.

        **Arguments:** `frame`: `args.frame(t)`, if already computed.
        """
        frame = args.frame(t) if frame is None else frame
        return self.from_contacts(t, frame, contacts(frame, state.motion), state, args)

    def from_contacts(self, t: Real, frame: RailFrame, now: Contacts, state: State, args: Args) -> State:
        """Return the derivative [per forcing period] from known rail and contacts."""
        scene = args.scene
        travel = args.travel(t)
        rates = per_period(travel, motion_rates(scene, forces_at(scene, frame, now, state), travel))
        if not scene.integrates_memory:
            return State(rates, None)
        scene = settle_memory(scene)  # without effect where the period map has already done this
        # d(g')/dt along the flow, from the motions of rail and slipper
        gap_rate = lambda t, motion: contacts(args.frame(t), motion).rate
        _, acceleration = jax.jvp(gap_rate, (jnp.asarray(t, float), state.motion), (jnp.ones(()), rates))
        memory = scene.contact_memory.derivative(state.memory, now.gap, now.rate, acceleration / travel.period)
        return State(rates, travel.period * memory)

    def linearised(self, t: Real, state: State, args: Args) -> Linearised:
        """Return the motion's derivative, linearised [per forcing period]; the memory is frozen.

        **Raises:** `ValueError` for a scene with a sled on springs, or with elastic modes.
        """
        scene = args.scene
        require(
            scene.payload is None and scene.slipper.modes is None,
            "solver",
            "be an explicit one for a scene with a sled on springs or elastic modes, such as RK4, or Latching of one "
            "of diffrax's implicit ones with a root finder of optimistix",
            shown="implicit",
        )
        if scene.friction is not None:  # friction has no closed form here
            rates = lambda m: self.evaluate(t, State(m, state.memory), args).motion
            return dense_linearised(rates, state.motion, args.travel(t).period)
        frame = args.frame(t)
        now = contacts(frame, state.motion)
        force = lambda gap, rate: contact_forces(scene, Contacts(gap, rate, now.lever), state.memory)
        return contact_linearised(scene, args.travel(t), frame, now, state.motion, force)

    def memory_decay(self, t: Real, state: State, args: Args) -> Float[Array, " points"] | None:
        """Return the derivative of the memory's rate by the memory [per forcing period]; None unless integrated."""
        if not args.scene.integrates_memory:
            return None
        now = contacts(args.frame(t), state.motion)
        return args.travel(t).period * settle_memory(args.scene).contact_memory.decay(now.gap)

    def open_step(self, t0: Real, state: State, args: Args) -> Before | None:
        """Return what `close_step` needs about the time before the first step; None where nothing is latched."""
        if not args.scene.latches_memory:
            return None
        now = contacts(args.frame(t0), state.motion)
        # an infinite earlier step means that there was none
        return Before(now.gap, now.rate, now.rate, jnp.asarray(jnp.inf))

    def inside_step(self, t: Real, state: State, args: Args) -> State:
        """Return an interpolated state with the memory that fits its gaps."""
        if not args.scene.latches_memory:
            return state
        # in a step in which a contact opens, the memory is that of the closed contact
        gap = contacts(args.frame(t), state.motion).gap
        return State(state.motion, jnp.where(gap >= 0, 0.0, state.memory))

    def close_step(
        self,
        before: Before | None,
        t0: Real,
        t1: Real,
        state: State,
        args: Args,
        frame: RailFrame | None = None,
    ) -> tuple[State, State, Before | None]:
        """End a step at `state`, and latch touchdowns.

        **Arguments:** `before`: of the previous step or `open_step`; `frame`: `args.frame(t1)`, if already computed.

        **Returns:** the state with latched memory, its derivative, and `before` of the next step.
        """
        if before is None:  # nothing is latched
            return state, self.evaluate(t1, state, args, frame), None
        frame = args.frame(t1) if frame is None else frame
        now = contacts(frame, state.motion)
        step = t1 - t0
        # with the pace in the middle of the step
        seconds = step * args.travel(t1 - 0.5 * step).period
        memory = args.scene.contact_memory.latch(state.memory, before, now.gap, now.rate, seconds, step / before.step)
        # the derivative has the new memory
        state = State(state.motion, memory)
        rates = self.from_contacts(t1, frame, now, state, args)
        return state, rates, Before(now.gap, now.rate, before.rate, step)


def vector_field(scene: Scene) -> VectorField:
    """Return the right-hand side for a scene, as a term of diffrax.

    Time counts forcing periods, not seconds: one period of the scene is an interval of 1. Solve with
    `args=slipperjax.model.Args(scene)`.
    """
    instance("scene", scene, Scene, "a slipperjax.Scene")
    return VectorField()


def fill_frozen(rates: State, state: State) -> State:
    """Replace a derivative of None, of a memory that is constant over a step, by zeros."""
    if rates.memory is not None:
        return rates
    return State(rates.motion, jax.tree.map(jnp.zeros_like, state.memory))


class Reactions(NamedTuple):
    """Forces at one instant."""

    contact_force: Float[Array, "*slippers 2 points"]
    """Normal force at each point, front and rear [N]; for a sled with a first axis of slippers."""
    gap: Float[Array, "*slippers 2 points"]
    """Gap at each point, front and rear [m]."""
    drive_force: Float[Array, ""]
    """Force along x that keeps the speed constant, the multiplier of Eq. (A6) [N]."""
    node_force: Float[Array, "*slippers 2 3"]
    """Force of the slipper on the front and the rear track node, x, y, z [N]."""
    node_moment: Float[Array, "*slippers 2 3"]
    """Moment of the slipper on the front and the rear track node, about the node, x, y, z [N m]."""
    acceleration: Float[Array, "5"]
    """v_y', v_z' [m/s^2], w_x', w_y', w_z' [rad/s^2]."""


def reactions(t: Real, state: State, args: Args) -> Reactions:
    """Return contact forces, Eq. (13)'s reactions (drive force, loads on the track nodes), and accelerations.

    **Arguments:** `t`: [forcing periods], from the epoch of `args`.

    **Raises:** `ValueError` for an argument of a wrong kind.
    """
    instance("state", state, State, "a slipperjax.State")
    instance("args", args, Args, "slipperjax.model.Args")
    require(np.ndim(real("t", t)) == 0, "t", "be one number", t)
    return _reactions(t, state, args)


@jax.jit
def _reactions(t: Real, state: State, args: Args) -> Reactions:
    scene = args.scene
    m = state.motion
    travel = args.travel(t)
    frame = bent(args.frame(t), state.rail)
    now = contacts(frame, m)
    at = forces_at(scene, frame, now, state)
    rates = motion_rates(scene, at, travel)
    # points of the front end and of the rear end, of each slipper
    ends = lambda a: a.reshape(*a.shape[:-1], *scene.point_shape)
    # the track feels the opposite force
    on_track = ends(-at.force[None] * jnp.stack(per_force(scene, at, travel)[:3]))
    # places of the points, and of the nodes under both ends, relative to the body's centre on a straight rail
    arm = jnp.array(rotation(m)) @ jnp.stack(frame.arm)
    point = ends(arm + jnp.stack([0 * m.y, m.y, m.z])[:, None])
    node = track_nodes(scene, args.epoch + t, args.points)
    return Reactions(
        contact_force=ends(at.force),
        gap=ends(now.gap),
        drive_force=drive_force(scene, at, travel),
        node_force=jnp.moveaxis(jnp.sum(on_track, axis=-1), 0, -1),
        node_moment=jnp.moveaxis(jnp.sum(jnp.cross(point - node[..., None], on_track, axis=0), axis=-1), 0, -1),
        acceleration=jnp.stack(body_numbers(rates)[5:]),
    )
