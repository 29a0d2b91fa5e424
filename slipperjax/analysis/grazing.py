"""Curves of grazing motions over two parameters, and the points where folds and flips of one-impact motions leave.

A motion with one impact in its period is followed from just before the impact to just before the next one. The time
between them is the period, so that no crossing is sought, and the equations stay smooth where the rate of the impact
is zero: there the motion grazes. Their linearisation with the multiplier mu,

    (A - mu) v + (a + mu b) s = 0,    gradient v + slope s = 0

for a change v of the state and s of the instant, is regular there, too, although one multiplier is infinite.
Simpson and Ghosh 2026 (arXiv 2602.22797) treat the points at which it has a solution for mu = 1 or -1.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, PyTree

from ..tools.checks import instance, one_of, require
from ..tools.compile import call_compiled
from ..tools.types import Real
from .arclength import Node, Pace, checked_bounds, correct
from .continuation import Branch, check_found, followed
from .critical import CRITICAL_MULTIPLIERS, AbstractExtended
from .events import Event, NoSearch, observed
from .hybrid import ImpactStep, along, rk4
from .newton import AbstractEquations, Linearisation
from .shooting import PeriodicMotions

LEAVING = "LP", "PD"
"""Curves of one-impact motions that leave a curve of grazings."""
TOUCH = -1e-9
"""Least gap in flight, as a share of the greatest gap; below it the motion touches once more."""
SLOWEST = 1e-12
"""Least rate of an impact for a finite multiplier."""


FREE = -np.inf, np.inf
"""Bounds of unknowns without bounds."""


class GrazingMotions(AbstractExtended):
    """Motions that graze. The unknowns are the state at the touch, the parameters, the instant of the touch, and the
    rate with which the gap falls there."""

    label: str = eqx.field(static=True, default="GR")
    """"GR", or one of `LEAVING`."""

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
        rate = z[self.motions.size + 3]
        # an impact without a rate has no finite multipliers
        fall = jnp.where(rate > SLOWEST, rate, jnp.nan)
        gradient = jax.grad(lambda y: step.surface(begin, y))(y)

        # a change at a fixed instant before the impact moves the impact
        def push(v):
            s = gradient @ v / fall
            return jax.jvp(lambda begin, y: self.returned(z, begin, end, y), (begin, y), (s, v + field * s))[1]

        return jax.vmap(push, out_axes=1)(jnp.eye(y.size))


class OneTouch(NoSearch):
    """No search for events, on curves that end where the motion touches the stop a second time."""

    def ends(self, node: Node) -> str:
        # the last gap is that of the touch
        gaps = np.asarray(call_compiled(_gaps, self.equations, (), jnp.asarray(node.z)))[:-1]
        return "second touch" if gaps.min() < TOUCH * np.abs(gaps).max() else ""


class LeavingSearch(OneTouch):
    """Search for the points of a curve of grazings where curves of folds and flips of one-impact motions leave."""

    def between(self, a: Node, b: Node) -> list[Event]:
        chord = (b.z - a.z) * a.weights**2
        # the points of both curves may be one, apart from rounding: then they keep the order of their labels
        share = lambda event: round(float(chord @ (event.node.z - a.z) / (chord @ (b.z - a.z))), 6)
        found = [event for label in LEAVING if (event := self.leaving(label, a, b)) is not None]
        # Newton's method may end at a point of another step
        return sorted((event for event in found if 0 <= share(event) <= 1), key=share)

    def leaving(self, label: str, a: Node, b: Node) -> Event | None:
        """Return the point between two grazings where a curve leaves, if any."""
        before, after = (np.linalg.det(_pencil(self.equations, node.z, label)) for node in (a, b))
        if before * after > 0:
            return None
        near = a.z + before / (before - after) * (b.z - a.z)
        equations, first = _left(self.equations, near, label, self.tolerance)
        if not first.residual <= self.tolerance:
            return None
        node = correct(self.equations, first.z[: near.size], a.row, tolerance=self.tolerance, iterations=0)
        size = equations.motions.size
        ahead = first.tangent[size]
        coefficients = {
            "quadratic": (_bend(equations, first) - _bend(self.equations, node)) / 2,
            "rate": float(first.tangent[size + 3] / ahead) if ahead else np.inf,
        }
        name = f"GR{label}"
        value = float(node.z[size + 1])
        mu = complex(CRITICAL_MULTIPLIERS[label])
        named = observed(node, None)._replace(label=name)
        return Event(name, named, value, value, True, mu, "", (), (size, size + 1), coefficients)


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

    **Returns:** a `Branch`, whose states are those at the touch, and whose multipliers are those of the motion that
    does not quite touch. It ends with "second touch" where the motion touches the stop at another instant, too. At
    its `events` "GRLP" and "GRPD" folds and flips leave, see `leave_grazing`, with the `coefficients`

    - `quadratic`: c in p2 - p2 of the grazings = c (p1 - p1 of this point)^2 for the parameters p1 and p2 along the
        leaving curve.
    - `rate`: rate of the impact per change of p1 along it; its sign tells the side of p1 on which the curve exists,
        because the rate is positive.

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
    once = not LeavingSearch(equations, None, tolerance).ends(first)
    require(once, "state", "lead to a motion that touches the stop once", "one that touches it twice")
    options = dict(tolerance=tolerance, pace=pace, points=points)
    return followed(equations, first, *limits, FREE, FREE, search=LeavingSearch, **options)


def leave_grazing(
    curve: Branch,
    event: Event,
    bounds: tuple[tuple[float, float], tuple[float, float]],
    *,
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    points: int = 400,
) -> Branch:
    """Follow the folds or flips of one-impact motions that leave a curve of grazings.

    **Arguments:** `curve`: of `continue_grazing`; `event`: one of its "GRLP" and "GRPD"; the others as there.

    **Returns:** a `Branch` from the point in the direction in which the rate of the impact grows. It ends with
    "grazing" where this rate falls to zero again, and with "second touch" where another impact begins. Multipliers
    are NaN where the rate is zero.
    """
    need = "a curve of slipperjax.analysis.continue_grazing"
    instance("curve", curve, Branch, need)
    require(isinstance(curve.equations, GrazingMotions), "curve", f"be {need}", type(curve.equations).__name__)
    instance("event", event, Event, "one of the curve's events")
    one_of("event", event.label, tuple(f"GR{label}" for label in LEAVING))
    limits = [checked_bounds(pair) for pair in bounds]
    equations, first = _left(curve.equations, event.node.z, event.label[2:], tolerance)
    check_found("event", "a point where a curve leaves", first, tolerance)
    further = [FREE, (0.0, np.inf), *[FREE] * (equations.further - 2)]
    options = dict(ways=(1,), tolerance=tolerance, pace=pace, points=points)
    leaving = followed(equations, first, *limits, *further, search=OneTouch, **options)
    back, ahead = leaving.ends
    # the bound of the rate
    if ahead.reason == "bound" and leaving.nodes[-1].z[equations.motions.size + 3] <= SLOWEST:
        ahead = ahead._replace(reason="grazing")
    return dataclasses.replace(leaving, ends=(back, ahead))


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


def _pencil(equations: AbstractEquations, z: np.ndarray, label: str) -> np.ndarray:
    """Return the matrix of the module's equations for one of `LEAVING`."""
    mu = jnp.asarray(CRITICAL_MULTIPLIERS[label])
    return np.asarray(call_compiled(_matrix, equations, (), jnp.asarray(z), mu))


def _matrix(equations: GrazingMotions, static: tuple, z: Array, mu: Array) -> Array:
    return jax.vmap(lambda v: equations.linearised(z, mu, v), out_axes=1)(jnp.eye(equations.motions.size + 1))


def _left(equations: GrazingMotions, near: np.ndarray, label: str, tolerance: float) -> tuple[LeavingMotions, Node]:
    """Return the equations and first point of a curve that leaves near some unknowns, with a tangent towards impacts.

    At this point the rate of the impact is zero.
    """
    leaving = LeavingMotions(equations.motions, label)
    z = np.append(near, np.linalg.svd(_pencil(equations, near, label))[2][-1])
    row = np.eye(z.size)[leaving.motions.size + 3]
    return leaving, correct(leaving, z, row, tolerance=tolerance, iterations=20)


def _second(equations: GrazingMotions, static: tuple, z: Array, tangent: Array) -> tuple[Array, Array]:
    """Return the derivative of the equations by all unknowns, and the second derivative along a direction."""
    slope = lambda z: jax.jvp(equations.defect, (z,), (tangent,))[1]
    return jax.jacfwd(equations.defect)(z), jax.jvp(slope, (z,), (tangent,))[1]


def _bend(equations: AbstractEquations, node: Node) -> float:
    """Return the second derivative of the second parameter by the first along a curve."""
    arrays = jnp.asarray(node.z), jnp.asarray(node.tangent)
    jacobian, second = map(np.asarray, call_compiled(_second, equations, (), *arrays))
    # the second derivatives of the unknowns, up to a multiple of the tangent, which does not count
    bent = np.linalg.lstsq(jacobian, -second)[0]
    size = equations.motions.size
    (p, q), (bent_p, bent_q) = node.tangent[size : size + 2], bent[size : size + 2]
    return float((bent_q * p - q * bent_p) / p**3)
