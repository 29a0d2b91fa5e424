"""The smallest shock after which a periodic motion of a map does not return: the basin's nearest boundary.

On rays from the motion, sections find the boundary, beyond which motions do not return. Motions that begin near a
smooth boundary follow it to a saddle, and then leave the saddle along one direction. Therefore the change of the
start that grows most is the boundary's normal, and at the nearest point ray and normal agree. On fractal boundaries,
which have no normal, only random rays remain.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, PyTree

from ..tools.checks import finite, number, positive, require, whole
from ..tools.compile import call_compiled
from .basins import last_states, recurrences
from .lyapunov import Scale, Step, checked_system, weights_of
from .shooting import Consistent

CUTS = 8
"""Shocks on each ray at once."""
ROUNDS = 9
"""Sections of a ray, after which the crossing is known to 8^-9 of the ray's length."""
FAMILIES = 4
"""Number of rays from each of which a nearest point is sought."""
APART = 0.7
"""Greatest cosine of the angle between these rays."""
SHARES = np.array([1.0, 0.5, 0.25, 0.125, 0.0])
"""Shares of the way from a ray to the normal that are tried; 0 keeps the ray."""
GENERATIONS = 12
"""Most turns of the rays towards the normals."""
AGREES = 1e-3
"""Angle between ray and normal below which they agree [rad]; lengths then agree to about a millionth."""


class Shock(NamedTuple):
    """The smallest shock found after which a motion does not return."""

    change: PyTree
    """Change of the state, in its own units."""
    length: float
    """Length, in the units of `shocks` [1]."""
    returns: float
    """Length of a slightly smaller shock in the same direction, after which the motion returns [1]."""
    angle: float
    """Angle between the shock and the normal of the basin's boundary [rad]."""
    found: str
    """"gradient" where this angle vanishes, so that no shock nearby is smaller; otherwise "rays": smaller ones may
    have been missed."""
    period: int
    """Intervals after which the other motion recurs, 0 where it does not, -1 where it is not finite."""
    state: PyTree
    """State on the other motion."""


class _Shocked(eqx.Module):
    """A map, and the starts that shocks make of a state."""

    step: Step
    consistent: Consistent | None
    state: PyTree
    weights: Array
    """Of the components of a state in distances."""
    ways: Array
    """Change of the state by a shock of length one in each direction, of shape (size, directions)."""

    def start(self, amounts: Array) -> PyTree:
        """Return the state after a shock. Pure."""
        flat, unravel = ravel_pytree(self.state)
        start = unravel(flat + self.ways @ amounts)
        return start if self.consistent is None else self.consistent(self.step, start, self.state)


def smallest_shock(
    step: Step,
    state: PyTree,
    shocks: PyTree,
    *,
    longest: float = 1.0,
    transient: int = 500,
    last: int = 20,
    rays: int = 32,
    seed: int = 0,
    scale: Scale | None = None,
    consistent: Consistent | None = None,
    tolerance: float = 0.05,
) -> Shock:
    """Return the smallest shock after which a stable periodic motion of a map does not return.

    **Arguments:**

    - `step`, `scale`, `consistent`: as for `shoot`; `state`: on the motion, where the shock changes it.
    - `shocks`: like the state, the change of each number that counts as a length of one; 0 for numbers that no shock
        changes.
    - `longest`: longest shock [1].
    - `transient`: intervals before the `last` ones, which show whether a motion has returned, as for `map_basins`, by
        `tolerance` in multiples of the scales. A motion that returns later counts as one that leaves.
    - `rays`: number of the first directions, from `seed`, rounded up to a multiple of four. Tongues of other basins
        thinner than an eighth of a ray may be missed.

    **Raises:** `ValueError` for motions that are not stable, and where no ray leaves the basin.
    """
    longest = number(positive, "longest", longest)
    tolerance = number(positive, "tolerance", tolerance)
    static = whole("transient", transient, 1), whole("last", last, 2)
    # as many rays in each family, so that one program serves the first directions and all others
    rays = -(-whole("rays", rays, FAMILIES * SHARES.size) // FAMILIES) * FAMILIES
    generator = np.random.default_rng(whole("seed", seed, 0))
    with checked_system(step, state, scale) as first:
        flat, unravel = ravel_pytree(first)
        sizes = np.asarray(ravel_pytree(jax.tree.map(finite("shocks"), shocks))[0])
        require(sizes.shape == flat.shape, "shocks", f"have {flat.size} numbers as the state has", sizes.size)
        require(np.any(sizes), "shocks", "change some number", shocks)
        ways = np.diag(sizes)[:, sizes != 0]
        weights = np.asarray(weights_of(first, scale))
        shocked = _Shocked(step, consistent, first, jnp.asarray(weights), jnp.asarray(ways))
        call = lambda fun, amounts: np.asarray(call_compiled(fun, shocked, static, jnp.asarray(amounts)))
        known = lambda ends: recurrences(ends * weights, tolerance / 10)
        directions = _directions(rays, ways.shape[1], seed)
        # shocks of almost no length lead to the motion itself, if it is stable
        still = call(_ends, np.repeat(1e-6 * longest * directions, CUTS, axis=0))
        (mark, *_), (period, *_) = known(still)
        near = np.abs((still[0] - np.asarray(flat)) * weights).max(axis=1).min()

        def leaves(ends: np.ndarray) -> np.ndarray:
            marks, periods = known(ends)
            return (periods != period) | ~(np.abs(marks - mark).max(axis=1) < tolerance)

        stays = period > 0 and near < tolerance and not np.any(leaves(still))
        require(stays, "state", "be on a stable periodic motion that lasts", state)
        # each call has as many shocks, so that one program serves all of them
        direction, low, high, angle = _nearest(
            lambda amounts: leaves(call(_ends, amounts)),
            lambda amounts: call(_grown, amounts),
            directions,
            longest,
            generator,
        )
        shock = high * direction
        end = call(_ends, np.tile(shock, (rays * CUTS, 1)))[:1]
        found = "gradient" if angle < AGREES else "rays"
        return Shock(unravel(ways @ shock), high, low, angle, found, int(known(end)[1][0]), unravel(end[0, -1]))


def _nearest(
    leaves: Callable[[np.ndarray], np.ndarray],
    grown: Callable[[np.ndarray], np.ndarray],
    directions: np.ndarray,
    longest: float,
    generator: np.random.Generator,
) -> tuple[np.ndarray, float, float, float]:
    """Return the direction of the smallest shock, lengths before and behind the boundary, and its angle to the
    boundary's normal [rad]."""
    count, size = directions.shape
    low, high = _crossings(leaves, directions, np.full(count, longest))
    best = _apart(directions, high)
    for generation in range(GENERATIONS + 1):
        directions, low, high = directions[best], low[best], high[best]
        normals = np.linalg.svd(grown(low[:, None] * directions))[0][:, :, 0]
        along = np.sum(normals * directions, axis=1)
        angles = np.arccos(np.minimum(np.abs(along), 1.0))
        # a plane boundary at a point is at least this far away
        hopeless = low * np.abs(along) > high.min()
        if generation == GENERATIONS or np.all(hopeless | (angles < AGREES)):
            break
        turn = np.sign(along)[:, None] * normals - directions
        wild = 0.5**generation * generator.standard_normal((FAMILIES, count // FAMILIES - SHARES.size, size))
        turns = np.concatenate([SHARES[:, None] * turn[:, None], wild], axis=1)
        each = turns.shape[1]
        directions = _unit(directions[:, None] + turns).reshape(-1, size)
        low, high = _crossings(leaves, directions, np.repeat(high, each))
        best = np.argmin(high.reshape(FAMILIES, each), axis=1) + each * np.arange(FAMILIES)
    k = np.argmin(high)
    return directions[k], float(low[k]), float(high[k]), float(angles[k])


def _crossings(
    leaves: Callable[[np.ndarray], np.ndarray], directions: np.ndarray, longest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths before and behind the first crossing of the boundary on each ray, infinite where none is."""
    low, width = np.zeros_like(longest), longest
    crosses = np.zeros(len(longest), bool)
    for k in range(ROUNDS):
        width = width / CUTS
        lengths = low[:, None] + width[:, None] * np.arange(1, CUTS + 1)
        gone = leaves((lengths[:, :, None] * directions[:, None]).reshape(-1, directions.shape[1]))
        gone = gone.reshape(lengths.shape)
        if k == 0:
            crosses = gone.any(axis=1)
            require(np.any(crosses), "longest", "let a shock on one of the rays leave the basin", np.max(longest))
        # the last cut is known from the round before
        gone[:, -1] = True
        low = low + width * np.argmax(gone, axis=1)
    return low, np.where(crosses, low + width, np.inf)


def _apart(directions: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the numbers of the shortest rays that are far apart, `FAMILIES` of them, with repetitions if need be."""
    order = np.argsort(lengths)
    chosen = [order[0]]
    for k in order:
        if np.isfinite(lengths[k]) and np.max(directions[chosen] @ directions[k]) < APART:
            chosen.append(k)
    return np.resize(chosen, FAMILIES)


def _directions(count: int, size: int, seed: int) -> np.ndarray:
    """Return directions that are evenly spread."""
    from scipy.stats import qmc  # here, because importing it takes long

    points = qmc.Halton(size, rng=np.random.default_rng(seed))
    return _unit(qmc.MultivariateNormalQMC(np.zeros(size), engine=points).random(count))


def _unit(directions: np.ndarray) -> np.ndarray:
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def _ends(shocked: _Shocked, static: tuple, amounts: Array) -> Array:
    """Return the last states after shocks of some amounts in each direction."""
    flat = lambda states: jax.vmap(lambda state: ravel_pytree(state)[0])(states)
    return jax.vmap(lambda amount: flat(last_states(shocked.step, shocked.start(amount), *static)))(amounts)


def _grown(shocked: _Shocked, static: tuple, amounts: Array) -> Array:
    """Return the weighted derivatives of motions by the shock, after the interval at whose end they are greatest."""
    unravel = ravel_pytree(shocked.state)[1]
    size = lambda rows: jnp.sum((rows * shocked.weights[None]) ** 2)

    def grow(amount):
        def interval(carry, k):
            x, rows, greatest = carry
            flow = lambda x: ravel_pytree(shocked.step(unravel(x), k))[0]
            x, rows = jax.vmap(lambda row: jax.jvp(flow, (x,), (row,)), out_axes=(None, 0))(rows)
            more = (size(rows) > size(greatest)) & jnp.isfinite(size(rows))
            return (x, rows, jnp.where(more, rows, greatest)), None

        start = lambda amount: ravel_pytree(shocked.start(amount))[0]
        first = jax.jacfwd(start)(amount).T
        carry = start(amount), first, first
        return jax.lax.scan(interval, carry, jnp.arange(float(static[0])))[0][-1] * shocked.weights[None]

    return jax.vmap(grow)(amounts)
