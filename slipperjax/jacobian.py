"""The Jacobian of the motion's derivative in closed form, in one pass over the contact points.

With w_i = (n_y, n_z, lever) the direction of a point's force among the five coordinates, a turn d of the slipper
(in its own frame) and v its spin there,

    dg = w . (dy, dz, d),     dg' = w . du + v . (a x (s x d)),     dlever = a x (s x d) = s (a . d) - d (a . s),

where a is the point in the slipper's frame and s the normal in it. So all that is needed are 39 sums over the
points; ten Jacobian-vector products cost several times that.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .kinematics import Contacts, Motion, RailFrame, rotation, scalar_part
from .reduction import sums
from .scene import Scene

Matrix = list[list[Any]]
"""Rows of scalars; the number 0.0 where an entry is zero whatever the state."""


def contact_jacobian(
    scene: Scene, frame: RailFrame, now: Contacts, m: Motion, force: Callable[[Array, Array], Array]
) -> Matrix:
    """Derivative of the motion's rates [per second] with respect to the motion, 10 x 10 in the order of `Motion`.

    **Arguments:** rail and contacts of the same instant; `force(gap, rate)`: the points' normal forces [N].
    """
    one = jnp.ones_like(now.gap)
    forces, by_gap = jax.jvp(lambda g: force(g, now.rate), (now.gap,), (one,))
    _, by_rate = jax.jvp(lambda r: force(now.gap, r), (now.rate,), (one,))
    (n_x, n_y, n_z), arm, r = frame.normal, frame.arm, rotation(m)
    s = [r[0][j] * n_x + r[1][j] * n_y + r[2][j] * n_z for j in range(3)]
    w = [n_y, n_z, *now.lever]
    spin = (m.w_x, m.w_y, m.w_z)
    lever_arm = sum(s[k] * arm[k] for k in range(3))
    normal_spin = sum(s[k] * spin[k] for k in range(3))
    # how the force answers to a displacement along y and z, and to a turn about each axis
    answer = [by_gap * n_y, by_gap * n_z]
    answer += [by_gap * w[2 + k] + by_rate * (normal_spin * arm[k] - spin[k] * lever_arm) for k in range(3)]
    stiffness = {(0, 0): answer[0] * n_y, (0, 1): answer[0] * n_z, (1, 1): answer[1] * n_z}
    for i in range(5):
        for k in range(3):
            stiffness[i, 2 + k] = answer[2 + k] * w[i]
            if i >= 2:
                stiffness[i, 2 + k] += forces * (s[i - 2] * arm[k] - (lever_arm if i - 2 == k else 0.0))
    for i in range(2, 5):
        for k in range(2):
            stiffness[i, k] = answer[k] * w[i]
    damping = {(i, k): by_rate * w[i] * w[k] for i in range(5) for k in range(i, 5)}
    total = sums(*stiffness.values(), *damping.values())
    stiff = dict(zip(stiffness, total[: len(stiffness)], strict=True))
    damp = dict(zip(damping, total[len(stiffness) :], strict=True))
    stiff[1, 0] = stiff[0, 1]
    damp |= {(k, i): v for (i, k), v in damp.items()}

    q, q_0 = (m.q_x, m.q_y, m.q_z), scalar_part(m)
    turn = _turn_of_attitude(q, q_0)
    j_x, j_y, j_z = (scene.slipper.inertia[k] for k in range(3))
    inertia = (scene.slipper.mass, scene.slipper.mass, j_x, j_y, j_z)
    rows = [[0.0] * 5 + [1.0 if k == i else 0.0 for k in range(5)] for i in range(2)]
    rows += _attitude_rows(q, q_0, spin)
    for i in range(5):
        by_turn = [stiff[i, 2 + k] / inertia[i] for k in range(3)]
        by_attitude = [sum(by_turn[k] * turn[k][j] for k in range(3)) for j in range(3)]
        rows.append(
            [stiff[i, 0] / inertia[i], stiff[i, 1] / inertia[i], *by_attitude]
            + [damp[i, k] / inertia[i] for k in range(5)]
        )
    moments = (j_x, j_y, j_z)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3  # Euler's equation: J_i w_i' = ... - (J_k - J_j) w_j w_k
        gyro = (moments[k] - moments[j]) / moments[i]
        rows[7 + i][7 + j] = rows[7 + i][7 + j] - gyro * spin[k]
        rows[7 + i][7 + k] = rows[7 + i][7 + k] - gyro * spin[j]
    return rows


def _turn_of_attitude(q, q_0) -> Matrix:
    """The turn in the slipper's frame per change of the quaternion's vector part: 2 (q_0 - [q]x + q q^T / q_0)."""
    cross = _cross_matrix(q)
    return [
        [2 * ((q_0 if i == j else 0.0) - cross[i][j] + q[i] * q[j] / q_0) for j in range(3)] for i in range(3)
    ]


def _attitude_rows(q, q_0, spin) -> Matrix:
    """Derivatives of q' = (q_0 w + q x w) / 2 with respect to the ten states."""
    by_q, by_w = _cross_matrix(spin), _cross_matrix(q)
    rows = []
    for i in range(3):
        attitude = [0.5 * (-q[j] / q_0 * spin[i] - by_q[i][j]) for j in range(3)]
        rates = [0.5 * (q_0 if i == j else by_w[i][j]) for j in range(3)]
        rows.append([0.0, 0.0, *attitude, 0.0, 0.0, *rates])
    return rows


def _cross_matrix(v) -> Matrix:
    """[v]x, so that [v]x u = v x u."""
    return [[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]]


def dense_jacobian(rates: Callable[[Motion], Motion], m: Motion) -> Matrix:
    """The same by ten Jacobian-vector products, for a right-hand side of which nothing is known."""
    leaves, tree = jax.tree.flatten(m)
    ones = jnp.eye(len(leaves))
    column = lambda tangent: jax.jvp(rates, (m,), (jax.tree.unflatten(tree, list(tangent)),))[1]
    columns = jax.vmap(column)(ones)
    return [[leaf[j] for j in range(len(leaves))] for leaf in jax.tree.leaves(columns)]


def shifted(matrix: Matrix, factor: Any) -> Matrix:
    """1 - factor * matrix, its zeros kept."""
    return [
        [
            (1.0 if i == j else 0.0) if is_zero(a) else ((1.0 if i == j else 0.0) - factor * a)
            for j, a in enumerate(row)
        ]
        for i, row in enumerate(matrix)
    ]


def is_zero(entry: Any) -> bool:
    """Whether an entry is zero whatever the state."""
    return isinstance(entry, float) and entry == 0.0


class Factors:
    """LU factors of a small matrix of scalars, elementwise over the batch, and without pivoting.

    Unrolled, because XLA solves batches of small systems one by one: 310 ns against 17 for five unknowns. Without
    pivoting, because the matrices here are 1 - h J with J that of a damped oscillator: their leading minors are
    positive.
    """

    def __init__(self, matrix: Matrix):
        n = len(matrix)
        a = [list(row) for row in matrix]
        self.inverse = []
        for k in range(n):
            unit = isinstance(a[k][k], float) and a[k][k] == 1.0
            self.inverse.append(1.0 if unit else 1 / a[k][k])
            for i in range(k + 1, n):
                if is_zero(a[i][k]):
                    continue
                a[i][k] = a[i][k] if unit else a[i][k] * self.inverse[k]
                for j in range(k + 1, n):
                    if not is_zero(a[k][j]):
                        product = a[i][k] * a[k][j]
                        a[i][j] = -product if is_zero(a[i][j]) else a[i][j] - product
        self.lu = a

    def solve(self, right: list[Any]) -> list[Any]:
        """The solution for one right-hand side."""
        n = len(right)
        x = list(right)
        for i in range(n):
            for j in range(i):
                if not is_zero(self.lu[i][j]):
                    x[i] = x[i] - self.lu[i][j] * x[j]
        for i in reversed(range(n)):
            for j in range(i + 1, n):
                if not is_zero(self.lu[i][j]):
                    x[i] = x[i] - self.lu[i][j] * x[j]
            x[i] = x[i] * self.inverse[i]
        return x
