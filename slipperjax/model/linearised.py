"""The linearised motion, and linear systems with its structure, for implicit solvers.

The slipper is a second-order system: positions p = (y, z, attitude) follow from velocities u = (v_y, v_z, w) by
kinematics alone. A small rotation d of the slipper in its own frame replaces the change of the quaternion, and B is
the (small) rotation of d by the spin. Then

    dp' = B dp + du,     du' = stiffness dp + damping du,

and a linear system of ten unknowns reduces to five, with stiffness and damping in closed form. For a point with
the force direction s = (n_y, n_z, lever), normal n and position a in the slipper's frame, and spin w,

    dg = s . dp,     dg' = s . du + w . (a x (n x d)),     dlever = a x (n x d) = n (a . d) - d (a . n),

These are 39 sums over the points. Ten Jacobian-vector products would cost several times as much.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tools.forms import store, sums
from ..tools.types import Real
from .kinematics import Contacts, Motion, RailFrame, cross, in_slipper_frame, rotation, scalar_part
from .scene import Scene
from .travel import Travel

Matrix = list[list[Real]]
"""Rows of scalars."""


class Linearised(NamedTuple):
    """Derivatives of the rates of a motion with respect to the motion, in SI units per `unit` of time."""

    stiffness: Matrix
    """Derivatives of the rates of (v_y, v_z, w) with respect to (y, z, rotation), 5 x 5."""
    damping: Matrix
    """Derivatives of the rates of (v_y, v_z, w) with respect to (v_y, v_z, w), 5 x 5."""
    motion: Motion
    """The motion at which the derivatives are taken."""
    unit: Real
    """The unit of time of the rates [s]."""


def contact_linearised(
    scene: Scene, travel: Travel, frame: RailFrame, now: Contacts, m: Motion, force: Callable[[Array, Array], Array]
) -> Linearised:
    """Return the slipper's linearised motion [per forcing period].

    **Arguments:** `travel`, `frame`, `now`: travel, rail and contacts at the same instant; `m`: the motion there;
    `force(gap, rate)`: normal forces [N] from gaps [m] and gap rates [m/s], all of shape (2 points,).
    """
    one = jnp.ones_like(now.gap)
    forces, by_gap = jax.jvp(lambda g: force(g, now.rate), (now.gap,), (one,))
    _, by_rate = jax.jvp(lambda r: force(now.gap, r), (now.rate,), (one,))
    arm = frame.arm
    _, n_y, n_z = frame.normal
    n = in_slipper_frame(rotation(m), frame.normal)
    s = [n_y, n_z, *now.lever]
    spin = (m.w_x, m.w_y, m.w_z)
    normal_arm = sum(n[k] * arm[k] for k in range(3))
    normal_spin = sum(n[k] * spin[k] for k in range(3))
    # change of the force per displacement along y and z, and per rotation about each axis
    answer = [by_gap * n_y, by_gap * n_z]
    answer += [by_gap * s[2 + k] + by_rate * (normal_spin * arm[k] - spin[k] * normal_arm) for k in range(3)]
    stiff = {(i, k): answer[k] * s[i] for i in range(5) for k in range(5) if (i, k) != (0, 1)}
    for i in range(3):
        for k in range(3):
            stiff[2 + i, 2 + k] += forces * (n[i] * arm[k] - (normal_arm if i == k else 0.0))
    # the damping is symmetric: only its upper triangle is summed
    damp = {(i, k): by_rate * s[i] * s[k] for i in range(5) for k in range(i, 5)}
    # all sums over the points in one pass
    total = sums(*stiff.values(), *damp.values())
    stiff = dict(zip(stiff, total[: len(stiff)], strict=True))
    damp = dict(zip(damp, total[len(stiff) :], strict=True))
    # the rest of both matrices follows by symmetry
    stiff[0, 1] = stiff[1, 0]
    damp |= {(k, i): v for (i, k), v in damp.items()}

    moments = [scene.slipper.inertia[k] for k in range(3)]
    inertia = [scene.slipper.mass, scene.slipper.mass, *moments]
    # from forces to accelerations per forcing period
    scaled = lambda entries: [[travel.period / inertia[i] * entries[i, k] for k in range(5)] for i in range(5)]
    stiffness = scaled(stiff)
    damping = scaled(damp)
    for i in range(3):
        # Euler's equation: J_i w_i' = ... - (J_k - J_j) w_j w_k
        j = (i + 1) % 3
        k = (i + 2) % 3
        gyro = travel.period * (moments[k] - moments[j]) / moments[i]
        # derivatives with respect to w_j and w_k
        damping[2 + i][2 + j] = damping[2 + i][2 + j] - gyro * spin[k]
        damping[2 + i][2 + k] = damping[2 + i][2 + k] - gyro * spin[j]
    return Linearised(stiffness, damping, m, travel.period)


def dense_linearised(rates: Callable[[Motion], Motion], m: Motion, unit: Real) -> Linearised:
    """Return the linearised motion by ten Jacobian-vector products, for any forces.

    **Arguments:** `rates(m)`: derivative of the motion per `unit`; `m`: the motion; `unit`: unit of time [s].
    """
    turned = _attitude_by_turn(m)
    tree = jax.tree.structure(m)
    half = tree.num_leaves // 2  # positions, then their velocities
    zero = jnp.zeros(2 * half)
    # along y and z, about the three axes, and along all velocities
    tangents = [zero.at[k].set(1.0) for k in range(2)]
    tangents += [jnp.stack([0.0, 0.0, *(turned[i][k] for i in range(3)), *[0.0] * half]) for k in range(3)]
    tangents += [zero.at[k].set(1.0) for k in range(half, 2 * half)]
    column = lambda v: jax.jvp(rates, (m,), (jax.tree.unflatten(tree, list(v)),))[1]
    columns = jax.tree.leaves(jax.vmap(column)(jnp.stack(tangents)))[half:]
    # each column comes from one tangent; rows of the matrices are rates of velocities
    part = lambda at: [[row[at + k] for k in range(half)] for row in columns]
    return Linearised(part(0), part(half), m, unit)


class LinearSystem(eqx.Module):
    """(1 - factor J) x = right, with J the linearised motion; factored once for many right-hand sides.

    There is no pivoting: the 5 x 5 matrix is a mass matrix with damping and stiffness added, and `factor` is small.
    """

    step: Real  # the factor in seconds
    factor: Real
    stiffness: Matrix
    matrix: Matrix  # LU factors of the equations of the five velocities
    transport: Matrix  # (1 - step B)^-1, see the module
    turn: Matrix  # the rotation that belongs to a change of the quaternion, after `transport`
    attitude: Matrix  # the change of the quaternion that belongs to a rotation

    def __init__(self, at: Linearised, factor: Real):
        m = at.motion
        self.step = factor * at.unit
        self.factor = factor
        self.stiffness = at.stiffness
        # displacements are eliminated, because over the step they follow from velocities
        transport = _inverse(_unit_minus(_spin_of_turn(m), self.step))
        by_turn = _product([row[2:] for row in at.stiffness], transport)
        reduced = []
        for damping, stiffness, turn in zip(at.damping, at.stiffness, by_turn, strict=True):
            by_place = [*stiffness[:2], *turn]
            reduced.append([d + self.step * s for d, s in zip(damping, by_place, strict=True)])
        matrix = factored(_unit_minus(reduced, factor))
        turn = _product(transport, _turn_by_attitude(m))
        self.matrix, self.transport, self.turn = store((matrix, transport, turn))
        self.attitude = _attitude_by_turn(m)

    def solve(self, right: Motion) -> Motion:
        """Return the solution x, a `Motion`, for one right-hand side."""
        leaves, tree = jax.tree.flatten(right)
        turn = _times(self.turn, leaves[2:5])
        push = _times(self.stiffness, [*leaves[:2], *turn])
        x = solved(self.matrix, [r + self.factor * p for r, p in zip(leaves[5:], push, strict=True)])
        turn = [a + self.step * b for a, b in zip(turn, _times(self.transport, x[2:]), strict=True)]
        place = [leaves[k] + self.step * x[k] for k in range(2)]
        return store(jax.tree.unflatten(tree, [*place, *_times(self.attitude, turn), *x]))


def solved(factors: Matrix, right: list[Real]) -> list[Real]:
    """Return the solution of a linear system from the LU factors of its matrix."""
    x = list(right)
    n = len(x)
    # forwards through L, then backwards through U, whose diagonal is all ones
    for i in range(n):
        for j in range(i):
            x[i] = x[i] - factors[i][j] * x[j]
        x[i] = x[i] / factors[i][i]
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            x[i] = x[i] - factors[i][j] * x[j]
    return x


def factored(a: Matrix) -> Matrix:
    """Return LU factors in one matrix, unrolled; its diagonal belongs to L, and the diagonal of U is all ones."""
    n = len(a)
    a = [list(row) for row in a]
    for k in range(n):
        for j in range(k + 1, n):
            a[k][j] = a[k][j] / a[k][k]
        for i in range(k + 1, n):
            for j in range(k + 1, n):
                a[i][j] = a[i][j] - a[i][k] * a[k][j]
    return a


def eliminated(a: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the solution of a linear system of any size by Gauss-Jordan elimination, without pivoting or LAPACK."""

    def without(system: Array, k: Array) -> tuple[Array, None]:
        """Return a system in which only the k-th equation contains the k-th unknown."""
        row = system[k] / system[k, k]
        others = system - system[:, k, None] * row[None]
        return others.at[k].set(row), None

    system = jnp.concatenate([a, right[:, None]], axis=1)
    system, _ = jax.lax.scan(without, system, jnp.arange(len(right)))
    return system[:, -1]


def _inverse(a: Matrix) -> Matrix:
    """Return the inverse of a 3 x 3 matrix by its cofactors."""
    # rows of cofactors are cross products of the other rows
    cofactors = [cross(a[1], a[2]), cross(a[2], a[0]), cross(a[0], a[1])]
    determinant = sum(a[0][j] * cofactors[0][j] for j in range(3))
    return [[cofactors[j][i] / determinant for j in range(3)] for i in range(3)]


def _unit_minus(a: Matrix, factor: Real) -> Matrix:
    return [[(1.0 if i == j else 0.0) - factor * v for j, v in enumerate(row)] for i, row in enumerate(a)]


def _times(a: Matrix, x: list[Real]) -> list[Real]:
    return [sum(v * x[j] for j, v in enumerate(row)) for row in a]


def _product(a: Matrix, b: Matrix) -> Matrix:
    return [[sum(row[k] * b[k][j] for k in range(len(b))) for j in range(len(b[0]))] for row in a]


def _cross_matrix(v) -> Matrix:
    """Return [v]x, so that [v]x u = v x u."""
    return [[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]]


def _attitude_by_turn(m: Motion) -> Matrix:
    """Return the derivative of the quaternion's vector part q with respect to a rotation: (q_0 + [q]x) / 2."""
    by_q = _cross_matrix((m.q_x, m.q_y, m.q_z))
    q_0 = scalar_part(m)
    return [[0.5 * (q_0 if i == j else by_q[i][j]) for j in range(3)] for i in range(3)]


def _turn_by_attitude(m: Motion) -> Matrix:
    """Return the inverse of `_attitude_by_turn`: 2 (q_0 - [q]x + q q^T / q_0)."""
    q = (m.q_x, m.q_y, m.q_z)
    q_0 = scalar_part(m)
    by_q = _cross_matrix(q)
    one = 1 / q_0
    return [[2 * ((q_0 if i == j else -by_q[i][j]) + one * q[i] * q[j]) for j in range(3)] for i in range(3)]


def _spin_of_turn(m: Motion) -> Matrix:
    """Return B of the module's docstring [1/s], from q' = (q_0 w + q x w) / 2.

    The change of q' with q, expressed as a rotation, is ([d]x w - (d . w) q / q_0) / 2.
    """
    q = (m.q_x, m.q_y, m.q_z)
    w = (m.w_x, m.w_y, m.w_z)
    one = 1 / scalar_part(m)
    by_w = _cross_matrix(w)
    return [[-0.5 * (by_w[i][j] + w[j] * q[i] * one) for j in range(3)] for i in range(3)]
