"""Restitution and friction of a cube from recorded tosses, by least squares through `impact_step`.

    python -m tests.benchmarks.tosses

The recordings are those of DAIRLab's contact-nets, data/tosses_processed (tests/data/README.md). Used are first
impacts in which a single corner hits the board.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from slipperjax.analysis import impact_step

from ..common import DATA, QUICK
from .timing import show

HALF, MASS, INERTIA, GRAVITY = 0.0524, 0.37, 8.1e-4, 9.81
"""Half width [m], mass [kg], moment of inertia [kg m^2] and gravity [m/s^2]."""
FRAMES, RATE = 4, 148
"""Frames from the state before the impact to that after it, and their rate [1/s]."""
CORNERS = HALF * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
PLACE, ATTITUDE, VELOCITY, SPIN = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
"""Of a state; the attitude is a quaternion with the real part first, the spin is along the world's axes."""


def turned(q, vectors):
    """Vectors [..., 3] turned by a quaternion."""
    axis = jnp.broadcast_to(q[1:], vectors.shape)
    twice = 2 * jnp.cross(axis, vectors)
    return vectors + q[0] * twice + jnp.cross(axis, twice)


def field(t, s):
    """Free flight; a cube's moments of inertia are equal, so that its spin is constant."""
    w, v = s[ATTITUDE][0], s[ATTITUDE][1:]
    spin = s[SPIN]
    turn = 0.5 * jnp.append(-spin @ v, w * spin + jnp.cross(spin, v))
    return jnp.concatenate([s[VELOCITY], turn, jnp.array([0.0, 0.0, -GRAVITY]), jnp.zeros(3)])


def gap(t, s):
    """Height of the lowest corner [m]."""
    return s[2] + jnp.min(turned(s[ATTITUDE], CORNERS)[:, 2])


def rebound(restitution, friction):
    """An impact of the lowest corner: Newton's restitution along the normal, Coulomb's friction across."""

    def reset(t, s):
        arms = turned(s[ATTITUDE], CORNERS)
        arm = arms[jnp.argmin(arms[:, 2])]
        before = s[VELOCITY] + jnp.cross(s[SPIN], arm)
        answer = jnp.eye(3) / MASS + ((arm @ arm) * jnp.eye(3) - jnp.outer(arm, arm)) / INERTIA
        # the corner sticks, unless that needs more friction than there is
        sticking = jnp.linalg.solve(answer, -before.at[2].multiply(1 + restitution))
        sliding = jnp.hypot(before[0], before[1])
        along = jnp.append(-friction * before[:2] / sliding, 1.0)
        slipping = -(1 + restitution) * before[2] / (answer[2] @ along) * along
        sticks = jnp.hypot(sticking[0], sticking[1]) <= friction * sticking[2]
        impulse = jnp.where(sticks, sticking, slipping)
        return s.at[VELOCITY].add(impulse / MASS).at[SPIN].add(jnp.cross(arm, impulse) / INERTIA)

    return reset


def misses(numbers, starts, ends):
    """Velocity and spin after the impact minus the measured ones, (tosses, 6) [m/s]; spins times the half width."""
    step = impact_step(field, gap, rebound(*numbers), dt=1 / RATE, steps=FRAMES)
    found = jax.lax.map(lambda s: step(s, 0.0), starts)[:, 7:]
    return (found - ends) * jnp.array([1.0] * 3 + [HALF] * 3)


def main() -> None:
    """Print restitution and friction with their intervals."""
    record = json.loads((DATA / "cube_impacts.json").read_text())
    starts, ends = jnp.array(record["before"]), jnp.array(record["after"])
    function = lambda numbers: misses(numbers, starts, ends).reshape(-1)
    both = jax.jit(jax.jacfwd(lambda numbers: (function(numbers),) * 2, has_aux=True), compiler_options=QUICK)
    fit = least_squares(lambda x: both(x)[1], [0.3, 0.2], lambda x: both(x)[0], loss="soft_l1", f_scale=0.1)
    # tosses are independent, their numbers are not
    per_toss = (fit.jac * fit.fun[:, None]).reshape(len(starts), 6, 2).sum(axis=1)
    inverse = np.linalg.inv(fit.jac.T @ fit.jac)
    deviations = np.sqrt(np.diag(inverse @ per_toss.T @ per_toss @ inverse))
    rows = zip(("restitution", "friction"), fit.x, 1.645 * deviations, strict=True)
    show([{"number": name, "estimate": f"{x:.3f}", "90 %": f"{x - d:.3f} to {x + d:.3f}"} for name, x, d in rows])
    print(f"{len(starts)} impacts, median miss {np.median(np.abs(fit.fun)):.3f} m/s")


if __name__ == "__main__":
    main()
