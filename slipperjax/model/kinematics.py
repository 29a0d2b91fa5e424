"""Attitude, and the gaps and gap rates of the contact points, Eqs. (1)-(8) of Dang et al. 2024.

The points of both ends have one axis: front A, B, ..., then rear A, B, ...; for a sled the points of its first
slipper, then of its second, and so on.

The attitude is the vector part q of a unit quaternion, with q_0 = sqrt(1 - q.q). Rotation matrices are polynomials
in q_0 and q, and regular for every angle below 180 degrees. Euler angles of Eq. (2) are used only for input and
output.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import brief, converted, instance, is_real, real, shown_number
from ..tools.compile import need_64_bits
from ..tools.forms import circle, spread, store, store_cotangent, store_if_differentiated, sums
from ..tools.tracing import is_traced
from ..tools.types import Real
from .beam import RailState, RailStep
from .quantities import COORDINATES, MODE_NUMBERS, MOTION_NUMBERS, PAYLOAD_NUMBERS
from .scene import Scene
from .slipper import Mounted, side_by_side, stacked
from .tracks import Irregularity


def _coordinate(name: str, unit: str) -> Any:
    """Make a field that is zero by default and converts quantities of pint."""
    return eqx.field(default=0.0, converter=converted(name, unit), metadata={"unit": unit})


def _modal(name: str, unit: str) -> Any:
    """Make a field of one number for each mode, which converts quantities of pint."""
    convert = converted(name, unit)
    return eqx.field(converter=lambda values: jnp.asarray(convert(values)))


class PayloadMotion(eqx.Module):
    """Motion of a mass on the slipper, see `slipperjax.model.Payload`."""

    y: Real = _coordinate("y", "m")
    """Lateral displacement [m]."""
    z: Real = _coordinate("z", "m")
    """Vertical displacement [m]."""
    v_y: Real = _coordinate("v_y", "m/s")
    """Lateral velocity [m/s]."""
    v_z: Real = _coordinate("v_z", "m/s")
    """Vertical velocity [m/s]."""


class ModalMotion(eqx.Module):
    """Motion of a sled's elastic modes, see `slipperjax.model.Modes`."""

    coordinate: Float[Array, " modes"] = _modal("coordinate", "m kg^0.5")
    """Coordinate of each mode [m kg^0.5]."""
    rate: Float[Array, " modes"] = _modal("rate", "m kg^0.5/s")
    """Rate of each coordinate [m kg^0.5/s]."""


class Motion(eqx.Module):
    """Position, attitude and velocities of a rigid slipper or sled, each a scalar, and the motions of its parts."""

    y: Real = _coordinate("y", "m")
    """Lateral displacement of the centre, positive to the left [m]."""
    z: Real = _coordinate("z", "m")
    """Vertical displacement of the centre, positive upwards [m]."""
    q_x: Real = 0.0
    """x of the attitude quaternion's vector part [1]."""
    q_y: Real = 0.0
    """y of the attitude quaternion's vector part [1]."""
    q_z: Real = 0.0
    """z of the attitude quaternion's vector part [1]."""
    v_y: Real = _coordinate("v_y", "m/s")
    """Lateral velocity [m/s]."""
    v_z: Real = _coordinate("v_z", "m/s")
    """Vertical velocity [m/s]."""
    w_x: Real = _coordinate("w_x", "rad/s")
    """Angular velocity about the slipper's x axis [rad/s]."""
    w_y: Real = _coordinate("w_y", "rad/s")
    """Angular velocity about the slipper's y axis [rad/s]."""
    w_z: Real = _coordinate("w_z", "rad/s")
    """Angular velocity about the slipper's z axis [rad/s]."""
    payload: PayloadMotion | None = None
    """Motion of the mass on the slipper; None where there is no mass."""
    modes: ModalMotion | None = None
    """Motion of the elastic modes; None for a rigid body."""

    def __repr__(self) -> str:
        units = {name: q.unit for name, q in COORDINATES.items()}
        values = {name: getattr(self, name) for name in MOTION_NUMBERS}
        parts = []
        for name, value in values.items():
            if is_traced(value) or np.any(np.asarray(value) != 0):
                parts.append(f"{name}={shown_number(value)} {units.get(name, '')}".rstrip())
        # numbers that are zero are left out
        if len(parts) < len(values):
            parts.append("others 0")
        for name in ("payload", "modes"):
            if getattr(self, name) is not None:
                parts.append(f"{name}={getattr(self, name)!r}")
        return f"{type(self).__name__}({', '.join(parts)})"

    @staticmethod
    def from_euler(*, roll: Real = 0.0, pitch: Real = 0.0, yaw: Real = 0.0, **others: Real) -> "Motion":
        """Return a motion from Euler angles of Eq. (2) [rad]; `others`: other fields of `Motion`."""
        q_x, q_y, q_z = quaternion_from_euler(roll, pitch, yaw)
        return Motion(q_x=q_x, q_y=q_y, q_z=q_z, **others)


def moved(m: Motion, change: Motion) -> Motion:
    """Return a motion with `change` added to the body's numbers; the motions of parts stay unchanged."""
    sums = [a + b for a, b in zip(body_numbers(m), body_numbers(change), strict=True)]
    return eqx.tree_at(body_numbers, m, sums)


def body_numbers(m: Motion) -> list[Any]:
    """Return the numbers of the body alone, in the order of `MOTION_NUMBERS`: five displacements, five velocities."""
    return [getattr(m, name) for name in MOTION_NUMBERS]


def check_motion(name: str, motion: Motion) -> Motion:
    """Return `motion`, whose coordinates must each be one finite number or traced; raises `ValueError` otherwise."""
    for part, value in vars(motion).items():
        # True and False pass, as 1 and 0
        single = part not in MOTION_NUMBERS or ((is_real(value) or isinstance(value, bool)) and not np.ndim(value))
        if is_traced(value) or (single and all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(value))):
            continue
        need = "be finite" if single else "have one finite number for each coordinate"
        raise ValueError(f"Argument `{name}` must {need}, but its {part} is {brief(value)}.")
    return motion


MOTION_SCALES = Motion(*(q.scale for q in MOTION_NUMBERS.values()))
"""Scales of the motion, equal to those of `COORDINATES`: 1 mm, 10 mrad (5e-3 of the quaternion), 1 m/s, 10 rad/s."""
PAYLOAD_SCALES = PayloadMotion(*(q.scale for q in PAYLOAD_NUMBERS.values()))
"""Scales of the motion of a mass on the slipper."""


def scales_of(motion: Motion) -> Motion:
    """Return the scales of a motion's numbers, including the numbers of its parts."""
    modes = None
    if motion.modes is not None:
        modes = ModalMotion(*(jnp.full(motion.modes.rate.shape, q.scale) for q in MODE_NUMBERS))
    return dataclasses.replace(MOTION_SCALES, payload=motion.payload and PAYLOAD_SCALES, modes=modes)


def with_parts(scales: Motion, scene: Scene) -> Motion:
    """Return scales of a body's numbers, with scales of the scene's parts where these have none.

    The scale of a mode's coordinate follows from the displacement of the mount or place that the mode moves farthest;
    for a mode that hardly moves any place, from the mean displacement of the body.
    """
    payload = scales.payload or (scene.payload and PAYLOAD_SCALES)
    modes = scales.modes
    own = scene.slipper.modes
    if modes is None and own is not None:
        # with unit modal mass, the mean square of a shape is one over the mass
        moved = [jnp.broadcast_to(1 / jnp.sqrt(scene.slipper.mass), own.frequency.shape)]
        for shapes in (own.shapes, own.place_shapes):
            if shapes is not None:
                moved.append(jnp.max(jnp.abs(shapes), axis=(-2, -1), initial=0.0))
        most = jnp.max(jnp.stack(moved), axis=0)
        modes = ModalMotion(scales.z / most, scales.v_z / most)
    return dataclasses.replace(scales, payload=payload, modes=modes)


def share_of_scale(scene: Scene) -> Float[Array, ""]:
    """Return the clearance of the tightest face with play, over 1 mm as in `MOTION_SCALES`; at most 1 [1]."""
    # faces without play do not count
    play = side_by_side([slipper.section.play for slipper in scene.mounted])
    tightest = 2 * jnp.min(jnp.where(play > 0, play, jnp.inf))
    # clearances below those that can be made and measured [m] do not narrow the scales further
    least = 5e-6
    return jnp.clip(tightest, least, MOTION_SCALES.z) / MOTION_SCALES.z


def accuracy_scales(scene: Scene) -> Motion:
    """Return the scales by which errors of a scene are judged, from `MOTION_SCALES`.

    With less play than 1 mm the scales of displacements and attitude are smaller in proportion, because an error of
    the size of the play makes all results wrong. With contact points farther than 0.1 m from the centre of mass the
    scales of attitude and spin are smaller in proportion. Scales of parts are as in `with_parts`.
    """
    share = share_of_scale(instance("scene", scene, Scene, "a slipperjax.Scene"))
    body = scene.slipper
    # the scale of the attitude moves a point by the scale of displacements; a quaternion's component is half an angle
    lever = MOTION_SCALES.z / (2 * MOTION_SCALES.q_x)
    near = jnp.minimum(1.0, lever / jnp.maximum(scene.reach, scene.half_length))
    y, z, *attitude, v_y, v_z, w_x, w_y, w_z = body_numbers(MOTION_SCALES)
    q_x, q_y, q_z = (share * near * q for q in attitude)
    body = Motion(share * y, share * z, q_x, q_y, q_z, v_y, v_z, near * w_x, near * w_y, near * w_z)
    return with_parts(body, scene)


def disturbances(
    scene: Scene, share: float, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "count numbers"]:
    """Return random changes of slippers' motions: velocities change by a share of their accuracy scales [1];
    displacements do not change, because they could leave the play."""
    changes = share * rng.normal(size=(count, len(MOTION_NUMBERS)))
    changes[:, :5] = 0.0
    return changes * np.array(body_numbers(accuracy_scales(scene)))


def scaled_size(motion: Motion, scales: Motion = MOTION_SCALES) -> Float[Array, ""]:
    """Return the largest magnitude in a difference of two motions, in multiples of `scales` [1]; parts without
    `scales` have their usual scales."""
    instance("scales", scales, Motion, "a slipperjax.Motion of sizes")
    usual = scales_of(instance("motion", motion, Motion, "a slipperjax.Motion"))
    parts = {"payload": usual.payload, "modes": usual.modes}
    of_parts = {name: part and (getattr(scales, name) or part) for name, part in parts.items()}
    scaled = jax.tree.map(lambda d, s: jnp.abs(d) / s, motion, dataclasses.replace(scales, **of_parts))
    return jnp.max(jnp.concatenate([jnp.ravel(ratio) for ratio in jax.tree.leaves(scaled)]))


def quaternion_from_euler(roll, pitch, yaw):
    """Return (q_x, q_y, q_z) of the quaternion of Rz(yaw) Ry(pitch) Rx(roll), with q_0 >= 0; angles in rad.

    **Raises:** `ValueError` for values that are not numbers.
    """
    halves = []
    for name, given in (("roll", roll), ("pitch", pitch), ("yaw", yaw)):
        halves.append(jnp.asarray(real(name, converted(name, "rad")(given)), float) / 2)
    cr, cp, cy = map(jnp.cos, halves)
    sr, sp, sy = map(jnp.sin, halves)
    # an attitude has two quaternions: the one with q_0 >= 0
    sign = jnp.where(cr * cp * cy + sr * sp * sy < 0, -1.0, 1.0)
    return (
        sign * (sr * cp * cy - cr * sp * sy),
        sign * (cr * sp * cy + sr * cp * sy),
        sign * (cr * cp * sy - sr * sp * cy),
    )


def scalar_part(m: Motion):
    """Return q_0 of the quaternion [1]; about zero from 180 degrees on, so that derailed states stay finite."""
    return store(jnp.sqrt(jnp.maximum(1 - (m.q_x * m.q_x + m.q_y * m.q_y + m.q_z * m.q_z), 1e-30)))


def rotation(m: Motion):
    """Return the rotation matrix R_S of the attitude, as rows of scalars."""
    w = scalar_part(m)
    q = (m.q_x, m.q_y, m.q_z)
    x, y, z = q
    # products that several entries use
    xx, yy, zz = (v * v for v in q)
    xy, xz, yz = (a * b for a, b in ((x, y), (x, z), (y, z)))
    wx, wy, wz = (w * v for v in q)
    return (
        (1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)),
        (2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)),
        (2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)),
    )


def euler_angles(m: Motion):
    """Return roll, pitch and yaw of Eq. (2) [rad]."""
    r = rotation(instance("m", m, Motion, "a slipperjax.Motion"))
    return jnp.arctan2(r[2][1], r[2][2]), jnp.arcsin(-r[2][0]), jnp.arctan2(r[1][0], r[0][0])


def attitude_rates(m: Motion):
    """Return rates of (q_x, q_y, q_z) [1/s] from the angular velocity in the slipper's frame."""
    w = scalar_part(m)
    return (
        0.5 * (w * m.w_x + m.q_y * m.w_z - m.q_z * m.w_y),
        0.5 * (w * m.w_y + m.q_z * m.w_x - m.q_x * m.w_z),
        0.5 * (w * m.w_z + m.q_x * m.w_y - m.q_y * m.w_x),
    )


def in_slipper_frame(r, v):
    """Return R^T v, the vectors v in the slipper's frame; `r`: rows of the slipper's `rotation`."""
    return [r[0][j] * v[0] + r[1][j] * v[1] + r[2][j] * v[2] for j in range(3)]


def cross(a, b):
    """Return a x b; the components are arrays of points."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a, b):
    """Return a . b; the components are arrays of points."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class Points(NamedTuple):
    """Constant data of the contact points of both ends during a run; for a sled of all slippers."""

    normal: Float[Array, "2 points"]
    """y and z of the faces' unit normals on a straight rail [1]."""
    track: Float[Array, "2 points"]
    """y and z of the matching points on the rail head, in the track node's frame [m]."""
    arm: tuple[Array, Array, Array]
    """x, y and z of the body's points in the body's frame, front points first, each of shape (points,) [m]."""
    length: Array
    """Length of the slipper to which each point belongs [m]; one number for a single slipper."""
    axis: tuple[Array | None, Array | None]
    """y and z of the undisturbed rail's axis at each point [m]; None for zero."""
    ahead: Float[Array, " slippers"] | None
    """How far the front end of each slipper is ahead of the counted distance [m]; None for a single slipper."""
    lengths: Float[Array, " slippers"]
    """Length of each slipper [m]."""
    shapes: tuple[Array, ...] | None
    """y and z, or x, y and z, of the modes' shapes at the slippers, each of shape (slippers, modes) [kg^-0.5]; None
    for a rigid body."""


def contact_points(scene: Scene) -> Points:
    """Return the scene's contact points; computed once per run, because they cost as much as a rail frame."""
    slippers = instance("scene", scene, Scene, "a slipperjax.Scene").mounted
    # the rear end has the section of the front one
    both = lambda a: jnp.tile(a, (2, 1)).T
    normal = side_by_side([both(slipper.section.normals) for slipper in slippers])
    track = side_by_side([both(slipper.section.track_points) for slipper in slippers])
    lengths = side_by_side([jnp.atleast_1d(slipper.length) for slipper in slippers])
    first, *others = slippers
    length = first.length
    ahead = None
    if others or first.ahead is not None:
        length = jnp.repeat(lengths, normal.shape[1] // len(slippers))
        ahead = stacked(slipper.ahead for slipper in slippers)
    modes = scene.slipper.modes
    shapes = modes and tuple(modes.shapes[..., k].T for k in range(modes.shapes.shape[-1]))
    arm_x, arm_y, arm_z = scene.arms
    return Points(normal, track, (arm_x, arm_y, arm_z), length, _rail_axis(scene, slippers), ahead, lengths, shapes)


def _rail_axis(scene: Scene, slippers: tuple[Mounted, ...]) -> tuple[Array | None, Array | None]:
    """Return y and z of the undisturbed rail's axis at each point [m], None where it is zero for all."""
    gauge = scene.track.gauge
    # a gauge gives the places of the rails; otherwise rails are where their mounts are
    side = {"left": 0.5, "right": -0.5}
    across = [slipper.place[1] if gauge is None else side[slipper.rail] * gauge for slipper in slippers]
    upwards = [slipper.place[2] for slipper in slippers]

    def at_points(places: list) -> Array | None:
        if all(place is None for place in places):
            return None
        return jnp.repeat(stacked(places), 2 * slippers[0].section.points.shape[0])

    return at_points(across), at_points(upwards)


class RailFrame(NamedTuple):
    """Geometry and velocity of the rail at one instant, independent of the slipper's state."""

    normal: tuple[Array, Array, Array]
    """Unit normals n out of the rail head, x, y and z, each of shape (points,) [1]."""
    position: Float[Array, " points"]
    """n . r_T, the rail point's position along its normal, with x counted from the body's centre [m]."""
    velocity: Float[Array, " points"]
    """n . v_T, the rail point's velocity along its normal [m/s]."""
    arm: tuple[Array, Array, Array]
    """The body's points in the body's frame, each of shape (points,) [m]."""
    shapes: tuple[Array, ...] | None = None
    """As `Points.shapes`."""
    deflection: Float[Array, "2 nodes"] | None = None
    """Deflections of the nodes of a rail that bends, see `bent`; None for a rigid rail."""


def bent(frame: RailFrame, rail: RailState | None) -> RailFrame:
    """Return the frame of rails with their deflections; normals stay those of the straight rail."""
    if rail is None:
        return frame
    n_y, n_z = frame.normal[1:]
    y, z, v_y, v_z = at_all_points(frame, (*rail.deflection, *rail.rate))
    position = frame.position + n_y * y + n_z * z
    velocity = frame.velocity + n_y * v_y + n_z * v_z
    return frame._replace(position=position, velocity=velocity, deflection=rail.deflection)


def rail_step(scene: Scene, speed: Real, seconds: Real, points: Points | None = None) -> RailStep:
    """Return what a step of some seconds needs about the rails of a scene with a beam."""
    assert scene.beam is not None  # of each caller
    points = contact_points(scene) if points is None else points
    places = points.arm[0].reshape(scene.nodes[1], -1)[:, 0]
    return scene.beam.step(nodes_on_rails(scene), places, speed, seconds)


def nodes_on_rails(scene: Scene) -> Float[np.ndarray, "rails nodes"]:
    """Return 1 where a track node is on a rail, 0 elsewhere."""
    rails = scene.track.rails or {"": None}
    on = [[len(rails) == 1 or slipper.rail == name for slipper in scene.mounted] for name in rails]
    return np.repeat(np.array(on, float), 2, axis=1)


def rail_frame(scene: Scene, phase: Real, points: Points | None = None) -> RailFrame:
    """Return the rail under the slipper after `phase` forcing periods, Eqs. (1), (4), (7), (10), (11).

    **Arguments:** `points`: `contact_points(scene)`, if already computed.
    """
    need_64_bits()  # each program of a motion calls this function, also with a plain jax.jit
    points = instance("points", contact_points(scene) if points is None else points, Points, "of `contact_points`")
    front, rear = _nodes(scene, points, real("phase", phase))
    # Eq. (4): the face goes from the front node's points to the rear node's points, which tilts its normal along x
    along_y = rear.y - front.y
    along_z = rear.z - front.z
    n_y, n_z, t_y, t_z, v_y, v_z = _each_at_its_node(scene, front, rear)
    # the part along x makes the normal perpendicular to the face
    n_x = store((n_y * along_y + n_z * along_z) / points.length)
    position = n_x * points.arm[0] + n_y * t_y + n_z * t_z
    slope = n_y * v_y + n_z * v_z  # per metre of travel, hence equal for all speeds of a sweep
    # tilted normals are longer than one, and are scaled to one
    per_norm = store(1 / jnp.sqrt(1 + n_x * n_x))
    # stored, so that the loop over cases and points does not compute these values again
    n_x, n_y, n_z, position, slope = store([v * per_norm for v in (n_x, n_y, n_z, position, slope)])
    return RailFrame((n_x, n_y, n_z), position, slope * scene.travel(phase).speed, points.arm, points.shapes)


def track_nodes(scene: Scene, phase: Real, points: Points | None = None) -> Float[Array, "3 *slippers 2"]:
    """Return x, y and z of the track nodes under both ends of each slipper [m], relative to the body's centre on a
    straight rail; a single slipper has no axis of slippers."""
    points = contact_points(scene) if points is None else points
    distance = jnp.asarray(phase, float) * scene.wavelength
    ahead = jnp.zeros(1) if points.ahead is None else points.ahead
    # the rear node is one length behind the front one
    behind = points.lengths[:, None] * jnp.array([[0.0, 1.0]])
    here, _, _ = _rails_at(scene, (distance + ahead)[None] - behind.T)
    # the body's centre is half a slipper's length behind the distance
    x = (ahead + scene.slipper.length / 2)[:, None] - behind
    each = scene.points // len(points.lengths)
    y, z = (0.0 if axis is None else axis[::each, None] for axis in points.axis)
    node = jnp.stack([x, y + here.lateral.T, z + here.vertical.T])
    return node.reshape(3, *scene.point_shape[:-1])


class _Node(NamedTuple):
    """Normals and rail points of all points, as if at their slipper's front or rear node, each of shape (points,)."""

    n_y: Array
    n_z: Array
    y: Array
    z: Array
    v_y: Array
    """Velocity of the rail points over the travelling speed [1]."""
    v_z: Array


def _nodes(scene: Scene, points: Points, phase: Real) -> list[_Node]:
    """Return all points as if at the front node, and all points as if at the rear node."""
    distance = jnp.asarray(phase, float) * scene.wavelength
    if points.ahead is None:
        return [_node(points, _rails_at(scene, at)) for at in (distance, distance - points.length)]
    front = distance + points.ahead
    rail = _rails_at(scene, jnp.stack([front, front - points.lengths]))
    # from values of each slipper to values of its points
    flat, structure = jax.tree.flatten(rail)
    values = spread(scene.points // len(points.lengths), *flat)
    ends = zip(*(value.reshape(2, -1) for value in values), strict=True)
    return [_node(points, jax.tree.unflatten(structure, end)) for end in ends]


def _each_at_its_node(scene: Scene, front: _Node, rear: _Node) -> _Node:
    """Return each point at its own node."""
    is_front = np.tile(np.repeat([True, False], len(scene.section.names)), len(scene.mounted))
    return _Node(*(jnp.where(is_front, f, r) for f, r in zip(front, rear, strict=True)))


class _Rail(NamedTuple):
    """The rail at some distances."""

    here: Irregularity
    """Displacements; a roll of None where the rail does not roll."""
    slope: Irregularity
    turn: tuple[Array, Array] | None
    """Cosine and sine of the roll."""


def _rails_at(scene: Scene, distance: Float[Array, "*ends_slippers"]) -> _Rail:
    """Return the rail of each slipper at its distances [m], (ends, slippers); of one rail at any distances."""
    rails = scene.track.rails
    if rails:
        on = [slipper.rail for slipper in scene.mounted]
        # all slippers of a rail at once, then back to their order
        index = {name: np.flatnonzero([rail == name for rail in on]) for name in dict.fromkeys(on)}
        motions = [rails[name].motion(distance[:, k]) for name, k in index.items()]
        if any(here.roll is not None for here, _ in motions):
            motions = jax.tree.map(_rolling, motions, is_leaf=lambda part: isinstance(part, Irregularity))
        order = np.argsort(np.concatenate(list(index.values())))
        motion = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1)[:, order], *motions)
    else:
        motion = scene.track.motion(distance)
    here, slope = store(motion)
    return _Rail(here, slope, None if here.roll is None else circle(here.roll))


def _rolling(rail: Irregularity) -> Irregularity:
    """Return a rail with a roll of zero where it has no roll."""
    return rail if rail.roll is not None else rail._replace(roll=jnp.zeros_like(rail.lateral))


def _node(points: Points, rail: _Rail) -> _Node:
    """Return the section at the track node where the rail is `rail`, Eqs. (7), (10), (11)."""
    here, slope, turn = rail
    n_y, n_z = points.normal
    y, z = points.track
    v_y = slope.lateral
    v_z = slope.vertical
    if turn is not None and slope.roll is not None:
        c, s = turn
        n_y, n_z = _rolled(c, s, n_y, n_z)
        y, z = _rolled(c, s, y, z)
        # where the rail rolls, its points move around the axis
        v_y = v_y - slope.roll * z
        v_z = v_z + slope.roll * y
    y = y + here.lateral
    z = z + here.vertical
    axis_y, axis_z = points.axis
    return _Node(n_y, n_z, y if axis_y is None else y + axis_y, z if axis_z is None else z + axis_z, v_y, v_z)


def _rolled(c: Array, s: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Return y and z turned about x by the angle whose cosine and sine are c and s."""
    return c * y - s * z, s * y + c * z


class Contacts(NamedTuple):
    """The contact points at one instant, each array of shape (points,)."""

    gap: Array
    """g, Eqs. (3), (5), (6); negative where slipper and rail penetrate [m]."""
    rate: Array
    """g', Eq. (8): relative velocity along the normal, without the normal's own rotation [m/s]."""
    lever: tuple[Array, Array, Array]
    """w x n in the slipper's frame: moment of a unit normal force, and derivative of the gap rate by the spin [m]."""


def contacts(frame: RailFrame, m: Motion) -> Contacts:
    """Return gaps, gap rates and levers of all points, at both ends."""
    instance("frame", frame, RailFrame, "that of slipperjax.model.rail_frame")
    instance("m", m, Motion, "a slipperjax.Motion")
    # stored, because XLA does not move this value out of the loop over the points
    r = store(rotation(m))
    n_x, n_y, n_z = frame.normal
    a_x, a_y, a_z = frame.arm
    flat = spread(n_y.shape[-1], *r[0], *r[1], *r[2], m.y, m.z, m.v_y, m.v_z, m.w_x, m.w_y, m.w_z)
    y, z, v_y, v_z, w_x, w_y, w_z = flat[9:]
    # with the normals in the slipper's frame, n_S = R^T n, n . (R a) = n_S . a and R^T ((R a) x n) = a x n_S
    s_x, s_y, s_z = own = in_slipper_frame((flat[:3], flat[3:6], flat[6:9]), frame.normal)
    lever = cross(frame.arm, own)
    x = v_x = []
    if m.modes is not None:
        here = (m.y, m.z, m.modes.coordinate), (m.v_y, m.v_z, m.modes.rate)
        (*x, y, z), (*v_x, v_y, v_z) = carried(frame, *here)
    gap = n_y * y + n_z * z + a_x * s_x + a_y * s_y + a_z * s_z - frame.position
    rate = (n_y * v_y + n_z * v_z + lever[0] * w_x + lever[1] * w_y + lever[2] * w_z) - frame.velocity
    if x:
        gap = gap + n_x * x[0]
        rate = rate + n_x * v_x[0]
    return Contacts(store_if_differentiated(gap), *store_cotangent((rate, lever)))


def carried(frame: RailFrame, *moves: tuple[Real, Real, Float[Array, " modes"]]) -> list[list[Array]]:
    """Return how far an elastic sled moves its slippers along the axes of its shapes, each of shape (points,).

    **Arguments:** `moves`: each has y and z of the centre and the modes' coordinates, or the rates of all these.
    """
    assert frame.shapes is not None  # of each elastic sled
    axes = len(frame.shapes)
    # for each slipper, the same for all its points
    of_slippers = sums(*(shape * q[None] for *_, q in moves for shape in frame.shapes))
    for k, (y, z, _) in enumerate(moves, 1):
        of_slippers[k * axes - 2] += y
        of_slippers[k * axes - 1] += z
    at_points = at_all_points(frame, of_slippers)
    return [at_points[k : k + axes] for k in range(0, len(at_points), axes)]


def at_all_points(frame: RailFrame, of_slippers: Sequence[Array]) -> list[Array]:
    """Return values of each slipper or node as values of its points, each of shape (points,)."""
    points, groups = frame.normal[0].shape[-1], len(of_slippers[0])
    each = points // groups
    if groups == 2 and frame.shapes is None:
        # a selection is faster than places in an array
        first = np.arange(points) < each
        return [jnp.where(first, *value) for value in of_slippers]
    return [value.ravel() for value in spread(each, *of_slippers)]


def modal_compliance(frame: RailFrame) -> Float[Array, " points"]:
    """Return the sum over all modes of the squares of their shapes along the points' normals [1/kg]."""
    assert frame.shapes is not None  # of each elastic sled
    normal = frame.normal[-len(frame.shapes) :]
    axes = range(len(normal))
    pairs = [(j, k) for j in axes for k in axes[j:]]
    # a symmetric matrix for each slipper, the same for all its points
    of_slippers = sums(*(frame.shapes[j] * frame.shapes[k] for j, k in pairs))
    at_points = at_all_points(frame, of_slippers)
    # entries off the diagonal count twice
    terms = [(1 + (j < k)) * normal[j] * normal[k] for j, k in pairs]
    return jnp.asarray(sum(term * entry for term, entry in zip(terms, at_points, strict=True)))


def face_offsets(scene: Scene, phase: Real, m: Motion) -> Float[Array, " points"]:
    """Return how far the slipper's points have moved along their faces, relative to the rail's points [m].

    Front points first. The displacement is in the plane of the section, along the direction from a face's first
    corner to its second. The gap is the displacement across the face; both give the place of a point on the rail
    head.
    """
    points = contact_points(scene)
    node = _each_at_its_node(scene, *_nodes(scene, points, phase))
    _, across, up = rotation(m)
    from_rail_y = m.y + sum(r * a for r, a in zip(across, points.arm, strict=True)) - node.y
    from_rail_z = m.z + sum(r * a for r, a in zip(up, points.arm, strict=True)) - node.z
    # the direction along a face is its normal, turned by 90 degrees
    return node.n_z * from_rail_y - node.n_y * from_rail_z
