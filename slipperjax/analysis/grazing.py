"""Curves of grazing motions over two parameters, and the points where folds and flips of one-impact motions leave.

A motion with one impact in its period is followed from just before the impact to just before the next one. The time
between them is the period, so that no crossing is sought, and the equations stay smooth where the rate of the impact
is zero: there the motion grazes. Their linearisation with the multiplier mu,

    (A - mu) v + (a + mu b) s = 0,    gradient v + slope s = 0

for a change v of the state and s of the instant, is regular there, too, although one multiplier is infinite.
Simpson and Ghosh 2026 (arXiv 2602.22797) treat the points at which it has a solution for mu = 1 or -1.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, PyTree

from ..tools.checks import instance, require
from ..tools.compile import call_compiled
from ..tools.types import Real
from .arclength import Node, Pace, checked_bounds, correct
from .continuation import Branch, End, begun, check_found, extend
from .critical import CRITICAL_MULTIPLIERS, AbstractExtended
from .events import NoSearch, observed
from .hybrid import ImpactStep, along, rk4
from .newton import Linearisation
from .shooting import PeriodicMotions

LEAVING = "LP", "PD"
"""Curves of one-impact motions that leave a curve of grazings."""
TOUCH = -1e-9
"""Least gap in flight, as a share of the greatest gap; below it the motion touches once more."""
SLOWEST = 1e-12
"""Least rate of an impact for a finite multiplier."""


class GrazingMotions(AbstractExtended):
    """Motions that graze. The unknowns are the state at the touch, the parameters, the instant of the touch, and the
    rate with which the gap falls there."""

    @property
    def further(self) -> int:
        return 2

    def closing(self, z: Array) -> Array:
        """Return equations that only these motions fulfil. Pure."""
        return z[self.motions.size + 3 :]

    def flight(self, z: Array, begin: Array, end: Array, y: Array) -> tuple[Array, Array]:
        """Return the state after a flight from `begin` to `end`, and the gaps in between. Pure."""
        step = self.motions.step(z)
        count = step.steps * self.motions.intervals
        h = (end - begin) / count

        def advance(y, k):
            y = rk4(step.field, begin + k * h, y, h)
            return y, step.surface(begin + (k + 1) * h, y)

        return jax.lax.scan(advance, y, jnp.arange(float(count)))

    def returned(self, z: Array, begin: Array, end: Array, y: Array) -> Array:
        """Return the state at `end` after an impact at `begin`. Pure."""
        return self.flight(z, begin, end, self.motions.step(z).reset(begin, y))[0]

    def span(self, z: Array) -> tuple[Array, Array, Array]:
        """Return state and instant of the touch, and the instant of the next touch."""
        step = self.motions.step(z)
        size = self.motions.size
        begin = z[size + 2]
        return z[:size], begin, begin + step.dt * step.steps * self.motions.intervals

    def linearised(self, z: Array, mu: Real, vector: Array) -> Array:
        """Return the module's equations for a multiplier and a change of state and instant. Pure."""
        y, begin, end = self.span(z)
        v, s = vector[:-1], vector[-1]
        moved = jax.jvp(lambda *at: self.returned(z, *at), (begin, end, y), (s, mu * s, v))[1]
        surface = self.motions.step(z).surface
        return jnp.append(moved - mu * v, jax.jvp(surface, (begin, y), (s, v))[1])

    def defect(self, z: Array) -> Array:
        """Return the residual. Pure."""
        y, begin, end = self.span(z)
        step = self.motions.step(z)
        rate = along(step.field, step.surface)(begin, y)
        touch = jnp.stack([step.surface(begin, y), rate + z[self.motions.size + 3]])
        return jnp.concatenate([self.returned(z, begin, end, y) - y, touch, self.closing(z)])

    def evaluate(self, z: Array) -> Linearisation:
        return Linearisation(self.defect(z), jax.jacfwd(self.defect)(z), self.jacobian(z)[None])

    def jacobian(self, z: Array) -> Array:
        """Return the Jacobian over the period, of the motion that does not quite touch. Pure."""
        y, begin, end = self.span(z)
        return jax.jacfwd(lambda y: self.flight(z, begin, end, y)[0])(y)


class LeavingMotions(GrazingMotions):
    """Folds and flips of motions with one impact. Further unknowns are a null vector of the linearised equations."""

    label: str = eqx.field(static=True)
    """One of `LEAVING`."""

    @property
    def further(self) -> int:
        return self.motions.size + 3

    def closing(self, z: Array) -> Array:
        vector = z[self.motions.size + 4 :]
        return jnp.append(self.linearised(z, CRITICAL_MULTIPLIERS[self.label], vector), vector @ vector - 1)

    def jacobian(self, z: Array) -> Array:
        y, begin, end = self.span(z)
        step = self.motions.step(z)
        field = step.field(begin, y)
        fall = jnp.maximum(jnp.abs(z[self.motions.size + 3]), SLOWEST)
        gradient = jax.grad(lambda y: step.surface(begin, y))(y)

        # a change at a fixed instant before the impact moves the impact
        def push(v):
            s = gradient @ v / fall
            return jax.jvp(lambda begin, y: self.returned(z, begin, end, y), (begin, y), (s, v + field * s))[1]

        return jax.vmap(push, out_axes=1)(jnp.eye(y.size))


class GrazingPoint(NamedTuple):
    """A point of a curve of grazings where a curve of folds or flips of one-impact motions leaves."""

    label: str
    """"GRLP" or "GRPD"."""
    values: np.ndarray
    """Values of both parameters."""
    state: np.ndarray
    """State at the touch."""
    coefficients: dict[str, float]
    """`quadratic`: c in p2 - p2 of the grazings = c (p1 - p1 of this point)^2 for the parameters p1 and p2 along the
    leaving curve. `rate`: rate of the impact per change of p1 along it; its sign tells the side of p1 on which the
    curve exists, because the rate is positive."""
    node: Node
    """First point of the leaving curve, whose tangent points along it."""
    equations: LeavingMotions


def continue_grazing(
    motions: PeriodicMotions,
    state: PyTree,
    values: tuple[Real, Real],
    bounds: tuple[tuple[float, float], tuple[float, float]],
    *,
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    points: int = 400,
) -> Branch:
    """Follow motions that just touch a stop once in their period, in the plane of two parameters.

    **Arguments:** `motions`: of two parameters, whose family returns an `impact_step`; `state`: of a motion without
    impacts near the start, at the strobe; `values`: first guess of the
    parameters; `bounds`: of both parameters; `tolerance`, `pace`, `points`: as for `continue_motion`.

    **Returns:** a `Branch`, whose multipliers are those of the motion that does not quite touch. Its `events` are
    `GrazingPoint`s, from which `leave_grazing` follows folds and flips. It ends with "second touch" where the motion
    touches the stop at another instant, too.

    **Raises:** `ValueError` for maps without a rigid stop, and where no motion grazes near the start.
    """
    instance("motions", motions, PeriodicMotions, "slipperjax.analysis.PeriodicMotions")
    step = motions.family(*values)
    need = "be a family of maps of `impact_step`: only at a rigid stop do folds and flips leave grazings"
    require(isinstance(step, ImpactStep), "motions", need, type(step).__name__)
    require(np.size(motions.reach) == 2, "motions", "have two parameters", np.size(motions.reach))
    limits = [checked_bounds(pair) for pair in bounds]
    equations = GrazingMotions(motions)
    begin = ravel_pytree(state)[0]
    z = call_compiled(_least, equations, (), motions.unknowns(begin, *values, float(step.t0), 0.0))
    # across both parameters, because the curve may run along either of them
    row = equations.weights(z)[1].at[: motions.size].set(0.0) ** 2
    first = correct(equations, z, row, tolerance=tolerance, iterations=20)
    check_found("state", "a motion that grazes the stop", first, tolerance)
    start = begun(equations, observed(first, None), pace)
    free = (-np.inf, np.inf)
    curve = extend(start, *limits, free, free, tolerance=tolerance, pace=pace, search=NoSearch, points=points)
    curve = _cut(curve, first)
    pairs = zip(curve.nodes, curve.nodes[1:], strict=False)
    found = [point for pair in pairs for label in LEAVING for point in _leaving(equations, *pair, label, tolerance)]
    return dataclasses.replace(curve, events=tuple(found))


def leave_grazing(
    point: GrazingPoint,
    bounds: tuple[tuple[float, float], tuple[float, float]],
    *,
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    points: int = 400,
) -> Branch:
    """Follow the folds or flips of one-impact motions that leave a curve of grazings.

    **Arguments:** `point`: an event of `continue_grazing`; the others as there.

    **Returns:** a `Branch` from the point in the direction in which the rate of the impact grows. It ends with
    "grazing" where this rate falls to zero again, and with "second touch" where another impact begins.
    """
    instance("point", point, GrazingPoint, "an event of slipperjax.analysis.continue_grazing")
    limits = [checked_bounds(pair) for pair in bounds]
    free = (-np.inf, np.inf)
    further = [free, (0.0, np.inf), *[free] * (point.equations.further - 2)]
    start = begun(point.equations, observed(point.node, None), pace, ways=(1,))
    curve = extend(start, *limits, *further, tolerance=tolerance, pace=pace, search=NoSearch, points=points)
    return _cut(curve, point.node)


def _least(equations: GrazingMotions, static: tuple, z: Array) -> Array:
    """Return the unknowns at the instant of the least gap in the period after a state."""
    size = equations.motions.size
    y, begin, end = equations.span(z)
    gaps = equations.flight(z, begin, end, y)[1]
    least = begin + (jnp.argmin(gaps) + 1) / gaps.size * (end - begin)
    return z.at[:size].set(equations.flight(z, begin, least, y)[0]).at[size + 2].set(least)


def _gaps(equations: GrazingMotions, static: tuple, z: Array) -> Array:
    y, begin, end = equations.span(z)
    return equations.flight(z, begin, end, equations.motions.step(z).reset(begin, y))[1]


def _cut(curve: Branch, start: Node) -> Branch:
    """Return the part of a curve around its start in which the motion touches the stop only once."""
    assert isinstance(curve.equations, GrazingMotions)
    rate = curve.equations.motions.size + 3

    def twice(node: Node) -> bool:
        # the last gap is that of the touch
        gaps = np.asarray(call_compiled(_gaps, curve.equations, (), jnp.asarray(node.z)))[:-1]
        return bool(gaps.min() < TOUCH * np.abs(gaps).max())

    nodes = curve.nodes
    begin = next(k for k, node in enumerate(nodes) if np.array_equal(node.z, start.z))
    others = np.flatnonzero([twice(node) for node in nodes])
    require(begin not in others, "state", "lead to a motion that touches the stop once", "one that touches it twice")
    low, high = max(others[others < begin], default=-1), min(others[others > begin], default=len(nodes))

    def end(known: End, node: Node, lost: bool) -> End:
        # a curve of impacts ends where their rate is at its bound
        grazes = curve.equations.further > 2 and node.z[rate] == 0 and known.reason == "bound"
        return known._replace(reason="second touch" if lost else "grazing" if grazes else known.reason)

    ends = end(curve.ends[0], nodes[0], low >= 0), end(curve.ends[1], nodes[-1], high < len(nodes))
    return dataclasses.replace(curve, nodes=nodes[low + 1 : high], ends=ends, events=())


def _pencils(equations: GrazingMotions, static: tuple, z: Array) -> Array:
    """Return the matrices of the module's equations for the multipliers of `LEAVING`."""
    of = lambda label: jax.vmap(lambda v: equations.linearised(z, CRITICAL_MULTIPLIERS[label], v), out_axes=1)
    return jnp.stack([of(label)(jnp.eye(equations.motions.size + 1)) for label in LEAVING])


def _leaving(equations: GrazingMotions, one: Node, other: Node, label: str, tolerance: float) -> list[GrazingPoint]:
    """Return the point between two grazings where a curve of folds or flips leaves, if any."""
    at = lambda node: np.asarray(call_compiled(_pencils, equations, (), jnp.asarray(node.z)))[LEAVING.index(label)]
    before, after = np.linalg.det(at(one)), np.linalg.det(at(other))
    if before * after > 0:
        return []
    share = before / (before - after)
    near = one.z + share * (other.z - one.z)
    vector = np.linalg.svd(at(one._replace(z=near)))[2][-1]
    leaving = LeavingMotions(equations.motions, label)
    size = equations.motions.size
    # at the rate zero, with a tangent towards impacts
    z = np.append(near, vector)
    node = correct(leaving, z, np.eye(z.size)[size + 3], tolerance=tolerance, iterations=20)
    if not node.residual <= tolerance:
        return []
    grazing = correct(equations, node.z[: near.size], one.row, tolerance=tolerance, iterations=0)
    bend = [_bend(eq, a) for eq, a in ((leaving, node), (equations, grazing))]
    first = node.tangent[size]
    coefficients = {
        "quadratic": float(bend[0] - bend[1]) / 2,
        "rate": float(node.tangent[size + 3] / first) if first else np.inf,
    }
    return [GrazingPoint(f"GR{label}", node.z[size : size + 2], node.z[:size], coefficients, node, leaving)]


def _second(equations: GrazingMotions, static: tuple, z: Array, tangent: Array) -> tuple[Array, Array]:
    """Return the derivative of the equations by all unknowns, and the second derivative along a direction."""
    slope = lambda z: jax.jvp(equations.defect, (z,), (tangent,))[1]
    return jax.jacfwd(equations.defect)(z), jax.jvp(slope, (z,), (tangent,))[1]


def _bend(equations: GrazingMotions, node: Node) -> float:
    """Return the second derivative of the second parameter by the first along a curve."""
    arrays = jnp.asarray(node.z), jnp.asarray(node.tangent)
    jacobian, second = map(np.asarray, call_compiled(_second, equations, (), *arrays))
    # the second derivatives of the unknowns, up to a multiple of the tangent, which does not count
    bent = np.linalg.lstsq(jacobian, -second)[0]
    size = equations.motions.size
    (p, q), (bent_p, bent_q) = node.tangent[size : size + 2], bent[size : size + 2]
    return (bent_q * p - q * bent_p) / p**3
