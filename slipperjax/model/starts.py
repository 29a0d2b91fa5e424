"""Starts of runs: states from motions, and the equilibrium of a slipper at rest on its rail."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..tools.checks import finite, require, warn
from ..tools.compile import as_argument, jit
from ..tools.files import listed
from ..tools.tracing import is_traced
from ..tools.types import Real
from ..tools.units import STANDARD_GRAVITY
from .dynamics import Acting, State, driven_mass, motion_rates
from .excitation import warn_of_excitation
from .kinematics import (
    ModalMotion,
    Motion,
    PayloadMotion,
    bent,
    check_motion,
    contact_points,
    contacts,
    moved,
    rail_frame,
    scalar_part,
    track_nodes,
)
from .linearised import eliminated, factored, solved
from .scene import Scene, check_scene
from .step_size import contact_depth

CENTRING = 1e-6
"""Force towards the middle of the play, for a slipper that nothing else holds, in multiples of its load, at a
displacement of one play [1]."""
HOLD = 1e-3
"""Like `CENTRING`, but for the velocity; the softest support of a slipper is 100 times as stiff [1]."""
MOST_ITERATIONS = 300
"""Most iterations of the search for rest. In 2000 tests (sleds on four slippers, twisted rails, stiffnesses over four
decades) each search succeeded, after 170 iterations at most and 25 on average."""
LEAST_APPROACH = 1e-9
"""Least rate [m/s], relative to the rate of rest, at which a contact of a slipper at rest counts as approaching."""


class AtRest(Motion):
    """A start at rest on the rail: the static equilibrium under gravity and loads, plus this motion.

    The slipper follows the rail as it travels, and its contacts begin without damping. In directions in which nothing
    holds the slipper, such as sideways on a flat face, it is in the middle of its play. A sled rests on its springs.
    """


def initial_state(scene: Scene, motion: Motion | State = Motion(), epoch: Real | None = None) -> State:
    """Return the state of `motion` at the start of the period `epoch`, with the matching contact memory.

    **Arguments:** `motion`: a `Motion`, whose closed contacts begin here, by default at rest in the middle of the
    play; or a `State`, such as the end of a run, which keeps its memory; `epoch`: forcing periods travelled before,
    by default the number of periods to the beginning of the rail.

    Gives an `ImplausibleWarning` where the slipper begins far outside its play, or excites itself on its rail.

    **Raises:** `ValueError` if JAX runs with 32-bit numbers, or for coordinates that are not finite numbers.
    """
    scene = check_scene(scene)
    motion = check_start("motion", motion)
    if isinstance(motion, State) and motion.memory is not None:
        require(
            np.shape(motion.memory) == (scene.points,),
            "motion",
            f"have a memory of shape ({scene.points},), one for each point",
            shown=f"one of shape {np.shape(motion.memory)}",
        )
    epoch = scene.epoch_at(scene.track.origin) if epoch is None else finite("epoch")(epoch)
    require(np.ndim(epoch) == 0, "epoch", "be one number", epoch)
    # numbers become arrays, so that other numbers need no new compilation
    state, outside = state_and_penetration(scene, jax.tree.map(as_argument, motion), epoch)
    warn_of_start(motion, outside, lambda k: scene, epoch)
    warn_of_excitation(scene)
    return state


def check_start(name: str, start: Motion | State) -> Motion | State:
    """Return `start`, a motion or a state; raises `ValueError` unless its numbers are finite or traced."""
    motion = start.motion if isinstance(start, State) else start
    kinds = "a slipperjax.Motion, a slipperjax.State or a slipperjax.orbits.Trajectory"
    require(isinstance(motion, Motion), name, f"be {kinds}", start)
    if isinstance(start, State) and np.ndim(motion.y) and not is_traced(motion):
        raise ValueError(
            f"Argument `{name}` must be of one instant, such as `.end` of a trajectory, but has {np.size(motion.y)}."
        )
    check_motion(name, motion)
    return start


@jit  # compiled once for all calls from Python; inside a program, a part of the program
def state_and_penetration(scene: Scene, start: Motion | State, epoch: Real = 0) -> tuple[State, Float[Array, ""]]:
    """Return the state of a start, and its greatest penetration in multiples of a typical impact's [1]."""
    if not isinstance(start, State):
        start = State(start, None)
    motion = start.motion
    memory = start.memory
    place = epoch + 0.0  # a number of any kind becomes one of 64 bits
    rail = None
    if scene.beam is not None:
        straight = scene.beam.at_rest(*scene.nodes)
        rail = straight if start.rail is None else start.rail
        given, needed = ([jnp.shape(leaf) for leaf in jax.tree.leaves(of)] for of in (rail, straight))
        require(
            given == needed, "start", f"have waves of the scene's beam, of shape {needed[-1]}", shown=f"{given[-1]}"
        )
    frame = bent(rail_frame(scene, place), rail)
    rest = None
    if isinstance(motion, AtRest):
        rest = at_rest(scene, place)
        motion = moved(rest, motion)
    motion = _with_parts(scene, motion)
    now = contacts(frame, motion)
    outside = -jnp.min(now.gap) / contact_depth(scene, scene.travel(place))
    if not scene.contact.has_memory:
        memory = None
    elif memory is None:  # closed contacts of a motion begin here
        rate = now.rate
        if rest is not None:
            # contacts that carry a slipper at rest approach only by rounding errors
            approach = rate - contacts(frame, rest).rate
            rate = jnp.where(jnp.abs(approach) > LEAST_APPROACH, approach, 0.0)
        memory = scene.contact_memory.initial(now.gap, rate)
    return State(motion, memory, rail), outside


def warn_of_start(start: Motion | State, penetration: Array, scene_of: Callable[[int], Scene], epoch: Real) -> None:
    """Give an `ImplausibleWarning` for motions that penetrate more than three times as deep as typical impacts, and
    for slippers without an equilibrium.

    **Arguments:** `penetration`: from `state_and_penetration`, of shape (*cases,); `scene_of`: returns the scene of a
    case by its number; `epoch`: of all cases.
    """
    # a run may have ended deep inside a contact, so that states are not checked
    if is_traced(penetration) or isinstance(start, State):
        return
    depths = np.asarray(penetration)
    if isinstance(start, AtRest) and np.any(np.isnan(depths)):
        warn(_without_rest(scene_of(int(np.argmax(np.isnan(depths)))), epoch))
    # the number of cases is not known here: a batch is a part of the cases, filled up with copies of one case
    if np.any(depths > 3):
        warn(
            f"A start lies outside the play of slipper and rail: a point penetrates {np.nanmax(depths):.3g} times as "
            "deep as in a typical impact; plausible are 3 times at most."
        )


def _without_rest(scene: Scene, epoch: Real) -> str:
    """Return a text that says that a scene finds no rest, and which slippers touch nothing where the search ended."""
    names = scene.slipper.names
    if not names:
        return "A slipper finds no rest on the rail: start it with a motion."
    floating = [name for name, opens in zip(names, np.asarray(_floating(scene, epoch)), strict=True) if opens]
    where = f", where {listed(floating)} {'floats' if len(floating) == 1 else 'float'}" if floating else ""
    return f"A sled finds no rest on the rail{where}: start it with a motion."


@jit
def _floating(scene: Scene, epoch: Real) -> Bool[Array, " slippers"]:
    """Return whether each slipper of a sled touches nothing where the search for its rest has ended."""
    here = jnp.asarray(epoch, float)
    scales = _Scales.of(scene, here)
    motion = _pose(scene, here, scales, _equilibrium(scene, here, scales).unknown)
    gap = contacts(rail_frame(scene, here), motion).gap
    return jnp.all(gap.reshape(len(scene.slipper.names), -1) > 0, axis=1)


def at_rest(scene: Scene, epoch: Real) -> Motion:
    """Return the motion of a slipper at rest on its rail after `epoch` forcing periods; NaN where no equilibrium is
    found.

    Found by Newton's iterations with a bounded step. Derivatives are the derivatives of the equilibrium.
    """
    here = jnp.asarray(epoch, float)
    frozen, at = jax.lax.stop_gradient((scene, here))
    scales = _Scales.of(frozen, at)
    search = _equilibrium(frozen, at, scales)

    def pose(place: Array, slope: Array) -> Motion:
        """Return the equilibrium at a place nearby, to first order."""
        step = _newton_step(slope, _residual(scene, place, scales, search.unknown))
        return _pose(scene, place, scales, search.unknown - step)

    motion = pose(here, search.slope)
    # a slipper that is hardly held moves with the middle of its play, and does not follow changes of small forces
    held = search.slope - HOLD * jnp.eye(search.unknown.size)
    _, change = jax.jvp(lambda place: pose(place, held), (here,), (jnp.ones(()),))
    period = scene.travel(here).period
    # the angular velocity from the quaternion's derivative: the inverse of `attitude_rates`
    q = jnp.stack([motion.q_x, motion.q_y, motion.q_z])
    q_0, q_rate = scalar_part(motion), jnp.stack([change.q_x, change.q_y, change.q_z]) / period
    spin = 2 * (q_0 * q_rate + q * jnp.dot(q, q_rate) / q_0 - jnp.cross(q, q_rate))
    along = dict(v_y=change.y / period, v_z=change.z / period)
    modes = motion.modes
    if modes is not None:
        modes = ModalMotion(modes.coordinate, change.modes.coordinate / period)
    rest = dataclasses.replace(motion, **along, w_x=spin[0], w_y=spin[1], w_z=spin[2], modes=modes)
    found = jnp.max(jnp.abs(search.residual)) < 1e-6
    return jax.tree.map(lambda value: jnp.where(found, value, jnp.nan), rest)


class _Scales(NamedTuple):
    """Scales of a slipper at rest, which make unknowns and residuals about one."""

    pose: Float[Array, " unknowns"]
    """Scales of y and z [m], q_x, q_y, q_z [1] and elastic modes: each moves points by the play plus the depth to
    which the load presses."""
    load: Array
    """Force that the contacts carry [N]."""

    @classmethod
    def of(cls, scene: Scene, epoch: Array) -> "_Scales":
        body = scene.slipper
        half_length = scene.half_length
        load = jnp.zeros(()) if scene.gravity is None else driven_mass(scene) * jnp.abs(scene.gravity)
        if scene.load is not None:
            (_, *force), moment = scene.load.wrench(scene.travel(epoch))
            load = load + sum(map(jnp.abs, force)) + sum(map(jnp.abs, moment)) / half_length
        # without gravity and load, the weight on earth scales forces
        load = jnp.where(load > 0, load, body.mass * STANDARD_GRAVITY)
        depth = (load / scene.contact.stiffness) ** (2 / 3)
        size = jnp.max(scene.section.play) + depth
        # a quaternion's component is half an angle
        pose = size * jnp.stack([1.0, 1.0, 0.5 / scene.reach, 0.5 / half_length, 0.5 / half_length])
        if body.modes is not None:
            farthest = jnp.max(jnp.abs(body.modes.shapes), axis=(1, 2))
            pose = jnp.concatenate([pose, size / jnp.where(farthest > 0, farthest, 1.0)])
        return cls(pose, load)


def _middle(scene: Scene, epoch: Array) -> Sequence[Real]:
    """Return y, z, q_x, q_y and q_z of a body whose slippers are as near as possible to the middle of their play."""
    distance = epoch * scene.wavelength
    if len(scene.mounted) > 1:
        return _level(scene, epoch)
    length = scene.slipper.length
    front, rear = (scene.track.irregularity(at) for at in (distance, distance - length))
    # on the line through the rail at both ends; nose down is a positive pitch
    return [
        (front.lateral + rear.lateral) / 2,
        (front.vertical + rear.vertical) / 2,
        sum(at.roll for at in (front, rear) if at.roll is not None) / 4,
        -(front.vertical - rear.vertical) / length / 2,
        (front.lateral - rear.lateral) / length / 2,
    ]


def _level(scene: Scene, epoch: Array) -> list[Array]:
    """Return `_middle` on the track nodes of several slippers, by least squares."""
    points = contact_points(scene)
    x, y, z = (node.ravel() for node in track_nodes(scene, epoch, points))
    each = scene.points // len(points.lengths)
    across, up = (jnp.zeros(()) if axis is None else jnp.repeat(axis[::each], 2) for axis in points.axis)
    # from the middle of the slippers, where levels and slopes are independent
    along, side = x - jnp.mean(x), across - jnp.mean(across)
    slope = lambda arm, values: jnp.sum(arm * values) / jnp.maximum(jnp.sum(arm * arm), 1e-12)
    lateral, vertical = y - across, z - up
    roll, pitch, yaw = slope(side, vertical), -slope(along, vertical), slope(along, lateral)
    z_0 = jnp.mean(vertical) + pitch * jnp.mean(x) - roll * jnp.mean(across)
    return [jnp.mean(lateral) - yaw * jnp.mean(x), z_0, roll / 2, pitch / 2, yaw / 2]


def _pose(scene: Scene, epoch: Array, scales: _Scales, unknown: Float[Array, " unknowns"]) -> Motion:
    """Return the motion, without velocities, at the pose `unknown`, which counts from the middle of the play."""
    scaled = [size * u for size, u in zip(scales.pose, unknown, strict=True)]
    modes = None
    if scene.slipper.modes is not None:
        bent = jnp.stack(scaled[5:])
        modes = ModalMotion(bent, jnp.zeros_like(bent))
    return Motion(*(m + s for m, s in zip(_middle(scene, epoch), scaled, strict=False)), modes=modes)


def _wrench(scene: Scene, epoch: Array, motion: Motion) -> list[Array]:
    """Return force along y and z [N], moment about x, y and z [N m] and forces on modes [N kg^-0.5] of a slipper
    without motion.

    The forces of contacts are elastic, because nothing approaches.
    """
    frame = rail_frame(scene, epoch)
    now = contacts(frame, motion)
    still = jnp.zeros_like(now.gap)
    force = scene.contact.force(now.gap, still, still if scene.contact.has_memory else None)
    acting = Acting(frame, now, _with_parts(scene, motion), force)
    rates = motion_rates(scene, acting, scene.travel(epoch))
    j_x, j_y, j_z = scene.slipper.inertia
    mass = scene.slipper.mass
    modal = [] if rates.modes is None else rates.modes.rate
    return [mass * rates.v_y, mass * rates.v_z, j_x * rates.w_x, j_y * rates.w_y, j_z * rates.w_z, *modal]


def _residual(scene: Scene, epoch: Array, scales: _Scales, unknown: Array) -> Float[Array, " unknowns"]:
    """Return the work of forces and moments over the scales of a slipper's pose, divided by the load's work [1]."""
    wrench = jnp.stack(_wrench(scene, epoch, _pose(scene, epoch, scales, unknown)))
    # an angle is twice the quaternion's component
    ways = scales.pose * np.append([1.0, 1.0, 2.0, 2.0, 2.0], np.ones(unknown.size - 5))
    return wrench * ways / (scales.pose[0] * scales.load) - CENTRING * unknown


def _newton_step(slope: Array, residual: Array) -> Array:
    """Return what an iteration of Newton's method subtracts, without LAPACK, which threads must not share."""
    if residual.size == 5:
        return jnp.stack(solved(factored(list(map(list, slope))), list(residual)))
    return eliminated(slope, residual)


class _Search(NamedTuple):
    """Newton's iterations for the equilibrium, in the units of `_Scales`."""

    unknown: Float[Array, " unknowns"]
    step: Float[Array, " unknowns"]
    """The last step, which is undone where it was too long."""
    held: Float[Array, " unknowns"]
    """Unknowns before the last step, to which the residual and the slope belong."""
    residual: Float[Array, " unknowns"]
    slope: Float[Array, "unknowns unknowns"]
    damping: Array
    """Stiffness that shortens steps."""
    count: Array


def _equilibrium(scene: Scene, epoch: Array, scales: _Scales) -> _Search:
    """Return the end of the search for the equilibrium."""

    def improve(at: _Search) -> _Search:
        # one program for the residual and its derivatives
        along = lambda unknown, way: jax.jvp(lambda u: _residual(scene, epoch, scales, u), (unknown,), (way,))
        each = jnp.eye(at.unknown.size)
        residual, slope = jax.vmap(along, (None, 0), (None, 1))(at.unknown, each)
        # Forces are slopes of an energy. A step must not pass the energy's minimum so far that the slope at its end
        # is as steep as at its beginning. Steps become shorter where contacts open and close in turn.
        fell = jnp.abs(jnp.dot(at.residual, at.step))
        back = -jnp.dot(residual, at.step)
        good = (back <= 0.9 * fell) | (at.count == 0)
        stiffest = jnp.max(jnp.abs(jnp.diagonal(at.slope)))
        less = jnp.where(back <= 0.5 * fell, at.damping / 4, at.damping)
        damping = jnp.where(good, less, jnp.maximum(8 * at.damping, 1e-3 * stiffest))
        now, before = (at.unknown, residual, slope), (at.held, at.residual, at.slope)
        held, residual, slope = jax.tree.map(lambda new, old: jnp.where(good, new, old), now, before)
        full = -_newton_step(slope - damping * each, residual)
        # a slipper without contact falls by its play at most
        step = full / jnp.maximum(jnp.max(jnp.abs(full)), 1.0)
        return _Search(held + step, step, held, residual, slope, damping, at.count + 1)

    go_on = lambda at: (jnp.max(jnp.abs(at.step)) > 1e-9) & (at.count < MOST_ITERATIONS)
    one = jnp.ones_like(scales.pose)
    first = _Search(0 * one, one, 0 * one, one, jnp.eye(one.size), jnp.asarray(1e-3), jnp.zeros((), int))
    return jax.lax.while_loop(go_on, improve, first)


def _with_parts(scene: Scene, motion: Motion) -> Motion:
    """Return a motion with a part for each part of the scene: a mass at rest on its springs, modes at rest."""
    # a motion may have parts that the scene does not have
    payload = modes = None
    if scene.payload is not None:
        resting = motion.z + scene.payload.sag(scene.gravity)
        payload = motion.payload or PayloadMotion(motion.y, resting, motion.v_y, motion.v_z)
    if scene.slipper.modes is not None:
        still = jnp.zeros(scene.slipper.modes.count)
        modes = motion.modes or ModalMotion(still, still)
    return Motion(**vars(motion) | {"payload": payload, "modes": modes})
