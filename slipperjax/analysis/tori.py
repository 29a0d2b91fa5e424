"""Invariant curves of maps, the sections of tori, followed over a parameter with their rotation number.

The unknowns are the states x(theta) at equal shares theta of the curve, of which trigonometric polynomials make a
curve. The map turns it by the rotation number: P(x(theta)) = x(theta + rotation) (Schilder, Osinga and Vogt 2005,
doi:10.1137/040611240). Where the rotation locks on to a fraction p/q, no such curve exists, but a motion that recurs
after q intervals does.
"""

import dataclasses
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import instance, numbers, require, whole
from ..tools.compile import call_compiled
from ..tools.types import Numbers, Real
from .arclength import Node, Pace, Walk, checked_bounds, correct
from .attractor import rotation_number
from .continuation import Branch, End, check_found, continue_motion
from .events import Event
from .floquet import eigenvector
from .lyapunov import weighted_mean
from .newton import AbstractEquations, Linearisation, NullVectors
from .shooting import PeriodicMotions

TURNS = 1000
"""Iterations of the map along a curve for its Lyapunov exponents."""
HALF = 0.5
"""Where between two states of a curve its error is greatest, as a share of their distance."""
LOCKING = 12
"""Greatest period of a motion on which a torus is sought to be locked."""
AHEAD = 0.02
"""Greatest distance of a fraction from a rotation number near which the rotation may lock on to it."""
STARTS = 8
"""States of a curve from which a motion that recurs is sought; it lies within this part of the curve's extent."""
BEYOND = 0.1, 0.3, 1.0, 3.0
"""Distances behind a locked interval at which the torus is sought, as shares of its width."""


class InvariantCurves(AbstractEquations):
    """Invariant curves of a map. The unknowns are the states, the parameter and the rotation number."""

    motions: PeriodicMotions
    reference: Array
    """States of a near curve, of shape (points, size), which fix the start of theta; the number of points is odd."""

    def rotation(self, z: Array) -> Array:
        """Return the rotation number."""
        return jnp.asarray(z)[-1]

    def states(self, z: Array) -> Array:
        """Return the states, of shape (points, size)."""
        return jnp.reshape(jnp.asarray(z)[: self.reference.size], self.reference.shape)

    def values(self, z: Array) -> Array:
        """Return the values of the parameters."""
        return jnp.asarray(z)[self.reference.size :][: jnp.size(self.motions.reach)]

    def at_share(self, states: Array, theta: Array) -> Array:
        """Return the value at one share of a curve, from values at equal shares. Pure."""
        count = len(states)
        # the trigonometric polynomial that is one at one of the points
        waves = jnp.cos(2 * jnp.pi * jnp.outer(theta - jnp.arange(count) / count, jnp.arange(1, count // 2 + 1)))
        return (1 + 2 * waves.sum(axis=-1)) @ states / count

    def turned(self, states: Array, turn: Array) -> Array:
        """Return values on a curve, of shape (points, more), further along the curve by a share of a turn. Pure."""
        return jax.vmap(lambda theta: self.at_share(states, theta))(jnp.arange(len(states)) / len(states) + turn)

    def slope(self, states: Array, turn: Array) -> Array:
        """Return the derivative of `turned` by the turn. Pure."""
        return jax.jvp(lambda turn: self.turned(states, turn), (turn,), (jnp.ones_like(turn),))[1]

    def evaluate(self, z: Array) -> Linearisation:
        states = self.states(z)
        values = self.values(z)
        rotation = self.rotation(z)
        count, size = states.shape
        # P(x) - x with its derivatives at all points
        mapped = jax.vmap(lambda x: self.motions.evaluate(jnp.append(x, values)))(states)
        residual = mapped.residual + states - self.turned(states, rotation)
        own = mapped.jacobian[..., :size] + jnp.eye(size)[None]
        blocks = jnp.einsum("jl,jab->jalb", jnp.eye(count), own)
        blocks = blocks - jnp.einsum("jl,ab->jalb", self.turned(jnp.eye(count), rotation), jnp.eye(size))
        columns = [blocks.reshape(z[: states.size].size, -1), mapped.jacobian[..., size:].reshape(states.size, -1)]
        if z.size > states.size + values.size:
            columns.append(-self.slope(states, rotation).reshape(-1, 1))
        jacobian = jnp.concatenate(columns, axis=1)
        along = self.along(z)
        return Linearisation(
            jnp.append(residual.ravel(), along @ z[: states.size]),
            jnp.concatenate([jacobian, jnp.pad(along, (0, z.size - along.size))[None]]),
        )

    def along(self, z: Array) -> Array:
        """Return the direction along the reference curve, whose product with the states is zero. Pure."""
        way = self.slope(self.reference, jnp.zeros(())) * self._of_motion(z)[0][None] ** 2
        return way.ravel() / jnp.sqrt(jnp.sum(way**2))

    def _of_motion(self, z: Array) -> tuple[Array, Array]:
        """Return the weights of one state and the parameters."""
        return self.motions.weights(jnp.append(self.states(z)[0], self.values(z)))

    def weights(self, z: Array) -> tuple[Array, Array]:
        count = len(self.reference)
        scale, lengths = self._of_motion(z)
        size = self.motions.size
        rest = jnp.zeros(z.size - self.reference.size).at[: lengths.size - size].set(lengths[size:])
        columns = jnp.append(jnp.tile(lengths[:size], count) / np.sqrt(count), rest)
        return jnp.append(jnp.tile(scale, count), 1.0), columns

    def update(self, z: Array | np.ndarray, null_vectors: NullVectors) -> "InvariantCurves":
        return dataclasses.replace(self, reference=self.states(jnp.asarray(z)))


class TurningCurves(InvariantCurves):
    """Invariant curves of a map of two parameters, of one rotation number."""

    fixed: Array
    """The rotation number."""

    def rotation(self, z: Array) -> Array:
        return self.fixed


@dataclasses.dataclass(frozen=True)
class Tori(Branch):
    """Invariant curves along a parameter. The moduli of the `multipliers` of a node are exp(Lyapunov exponent per
    interval); one of them is 1, along the curve. Nodes may have different numbers of unknowns."""

    @property
    def parameters(self) -> np.ndarray:
        return np.array([self.at(node).values(node.z) for node in self.nodes])

    @property
    def rotation(self) -> Float[np.ndarray, " points"]:
        """Rotation numbers [turns per interval]."""
        return np.array([self.at(node).rotation(node.z) for node in self.nodes])

    @property
    def exponents(self) -> Float[np.ndarray, "points size"]:
        """Lyapunov exponents per interval, the largest first."""
        return np.log(np.array([node.multipliers.real for node in self.nodes]))

    def at(self, node: Node) -> InvariantCurves:
        """Return the equations of a node, whose `states` are on its curve."""
        assert isinstance(self.equations, InvariantCurves)
        return _sized(self.equations, node.z)

    def __repr__(self) -> str:
        locked = "; ".join(f"{event.note} from {event.low:.6g} to {event.high:.6g}" for event in self.events)
        over = " and ".join(self.names)
        return f"Tori({len(self.nodes)} points over {over}; from {' to '.join(self.ended)}; {locked})"


def _sized(equations: InvariantCurves, z: Array | np.ndarray) -> InvariantCurves:
    """Return the equations for the number of points of some unknowns."""
    size = equations.motions.size
    free = 0 if isinstance(equations, TurningCurves) else 1
    count = (len(z) - free - np.size(equations.motions.reach)) // size
    return dataclasses.replace(equations, reference=jnp.asarray(z[: count * size]).reshape(count, size))


def continue_torus(
    motions: PeriodicMotions,
    start: Event | tuple[Numbers, Real],
    bounds: tuple[float, float] | tuple[tuple[float, float], tuple[float, float]],
    *,
    points: int = 31,
    most: int = 127,
    accuracy: float = 1e-8,
    tolerance: float = 1e-11,
    pace: Pace = Pace(),
    count: int = 100,
) -> Tori:
    """Follow an invariant curve of a map, the section of a torus, over a parameter.

    **Arguments:**

    - `motions`: of one parameter, along which the rotation number is an unknown; or of two parameters, in whose plane
        the rotation number is fixed.
    - `start`: a Neimark-Sacker of a branch of `motions`, for one parameter; or states on a torus once per interval,
        of shape (intervals, size), and the parameters' values.
    - `bounds`: of the parameter, or of both.
    - `points`: states on the curve at the start, made odd; they are doubled up to `most` where the error of the curve
        between them exceeds `accuracy` of its size.
    - `tolerance`: greatest weighted residual; `pace`: of the steps, the first of which leads from the
        Neimark-Sacker to the first curve; `count`: most curves in each direction.

    **Returns:** `Tori`. They end with "bound", "count", "Neimark-Sacker" where the curve shrinks to a point,
    "resolution" where `most` states are too few, as where a torus breaks down, "locked p:q" or "no convergence".
    Events "LK" are intervals of the parameter in which the rotation is locked, between two folds of a motion that
    recurs; beyond them the curve is followed further,
    if it is found there.

    **Raises:** `ValueError` that names the wrong argument, and where no torus is near the start.
    """
    instance("motions", motions, PeriodicMotions, "slipperjax.analysis.PeriodicMotions")
    limits = [checked_bounds(pair) for pair in np.reshape(np.asarray(bounds, float), (-1, 2))]
    need = f"be one pair for each of {np.size(motions.reach)} parameters"
    require(len(limits) == np.size(motions.reach) <= 2, "bounds", need, bounds)
    points = whole("points", points, 5) // 2 * 2 + 1
    born = isinstance(start, Event)
    first = _born(motions, start, points, pace.first) if born else _fitted(motions, start, points)
    check_found("start", "a torus", _on_plane(*first, tolerance), tolerance)
    search = _Search(limits, accuracy, tolerance, pace, whole("most", most, points), whole("count", count, 1))
    found = search.resolved(*first)
    require(found, "most", "be enough states for the accuracy at the start", most)
    assert found is not None
    equations, node = found
    parts = [search.followed(equations, node._replace(tangent=way * node.tangent)) for way in (-1, 1)]
    (before, back, low), (after, ahead, high) = parts
    nodes = (*reversed(before), node, *after)
    return Tori(equations, nodes, (*reversed(low), *high), (back, ahead))


def _born(
    motions: PeriodicMotions, event: Event, points: int, length: float
) -> tuple[InvariantCurves, np.ndarray, np.ndarray]:
    """Return equations, guess and direction across its plane for the curve that begins at a Neimark-Sacker."""
    require(event.label == "NS", "start", "be a Neimark-Sacker (NS) or states of a torus", event.label)
    require(np.size(motions.reach) == 1, "motions", "have one parameter at a Neimark-Sacker", np.size(motions.reach))
    vector = eigenvector(np.asarray(event.node.matrices), event.multiplier)
    circle = np.exp(2j * np.pi * np.arange(points) / points)
    ring = np.real(circle[:, None] * vector)
    z = np.append(
        np.tile(event.node.z[: motions.size], points), [event.value, np.angle(event.multiplier) / (2 * np.pi)]
    )
    equations = InvariantCurves(motions, jnp.asarray(ring))
    way = np.append(ring.ravel(), [0.0, 0.0])
    weights = np.asarray(equations.weights(jnp.asarray(z))[1])
    way = way / np.linalg.norm(weights * way)
    return equations, z + length * way, way


def _fitted(motions: PeriodicMotions, start: tuple, points: int) -> tuple[InvariantCurves, np.ndarray, np.ndarray]:
    """Return equations, guess and direction across its plane for the curve on which states lie."""
    states, *values = start
    states = numbers("start", states, 2)
    need = f"begin with {3 * points} states or more of {motions.size} numbers"
    fits = states.ndim == 2 and len(states) >= 3 * points and states.shape[1] == motions.size
    require(fits, "start", need, shown=f"of shape {states.shape}")
    require(len(values) == np.size(motions.reach), "start", "end with a value of each parameter", values)
    weights = np.asarray(motions.weights(motions.unknowns(states[0], *values))[0])
    turn = float(rotation_number(states * weights))
    require(np.isfinite(turn), "start", "be states on a closed curve", shown="not states on a closed curve")
    waves = np.arange(-(points // 2), points // 2 + 1)
    wave = lambda theta: np.exp(2j * np.pi * theta[:, None] * waves)
    fit = np.linalg.lstsq(wave(turn * np.arange(len(states))), states.astype(complex))[0]
    ring = jnp.asarray((wave(np.arange(points) / points) @ fit).real)
    if len(values) == 1:
        equations = InvariantCurves(motions, ring)
        return equations, np.concatenate([ring.ravel(), values, [turn]]), np.eye(ring.size + 2)[ring.size]
    z = np.concatenate([ring.ravel(), values])
    return TurningCurves(motions, ring, jnp.asarray(turn)), z, np.eye(z.size)[-1]


def _error(equations: InvariantCurves, static: tuple, z: Array) -> tuple[Array, Array]:
    """Return the greatest weighted error of a curve between its states, and its weighted size."""
    states, values, turn = equations.states(z), equations.values(z), equations.rotation(z)
    half = HALF / len(states)
    between = equations.turned(states, jnp.asarray(half))
    mapped = jax.vmap(lambda x: equations.motions.mapped(jnp.append(x, values)))(between)
    weights = equations.weights(z)[0][: states.size].reshape(states.shape)
    missed = weights * (mapped - equations.turned(states, turn + half))
    return jnp.max(jnp.abs(missed)), jnp.max(jnp.abs(weights * (states - states.mean(axis=0, keepdims=True))))


def _growth(equations: InvariantCurves, static: tuple, z: Array) -> Array:
    """Return the logarithms of the growth of orthogonal tangents in each interval, of shape (intervals, size)."""
    states, values, turn = equations.states(z), equations.values(z), equations.rotation(z)
    count, size = states.shape
    scale = equations.weights(z)[0][:size]
    scale = jnp.where(scale > 0, scale, 1.0)
    slopes = jax.vmap(lambda x: equations.motions.evaluate(jnp.append(x, values)).jacobian[:, :size])(states)
    slopes = ((slopes + jnp.eye(size)[None]) * (scale[:, None] / scale[None])[None]).reshape(count, -1)

    def push(frame, k):
        frame, r = jnp.linalg.qr(equations.at_share(slopes, k * turn).reshape(size, size) @ frame)
        return frame, jnp.log(jnp.maximum(jnp.abs(jnp.diag(r)), 1e-300))

    return jax.lax.scan(push, jnp.eye(size), jnp.arange(float(TURNS)))[1]


def _observed(equations: InvariantCurves, node: Node) -> Node:
    """Return a node with multipliers whose logarithms are the Lyapunov exponents."""
    growth = np.asarray(call_compiled(_growth, equations, (), jnp.asarray(node.z)))
    exponents = np.sort(weighted_mean(growth[TURNS // 10 :]))[::-1]
    return node._replace(multipliers=np.exp(exponents).astype(complex), errors=np.full(len(exponents), 1e-6))


@dataclasses.dataclass(frozen=True)
class _Search:
    """How invariant curves are followed: the arguments of `continue_torus`."""

    limits: list[tuple[float, float]]
    accuracy: float
    tolerance: float
    pace: Pace
    most: int
    count: int

    def walk(self, equations: InvariantCurves, last: Node, step: float) -> Walk:
        low, high = (np.full(len(last.z), side * np.inf) for side in (-1, 1))
        own = equations.reference.size
        bounded = slice(own, own + len(self.limits))
        low[bounded], high[bounded] = np.transpose(self.limits)
        return Walk(equations.update(last.z, None), last, low, high, self.pace, self.tolerance, step)

    def resolved(self, equations: InvariantCurves, z: Numbers, way: Numbers) -> tuple[InvariantCurves, Node] | None:
        """Return equations and node on the plane through `z` across `way`, with as many states as the accuracy needs;
        None where `most` are too few, or without convergence."""
        while len(equations.reference) <= self.most:
            node = _on_plane(equations, z, way, self.tolerance)
            if not node.residual <= self.tolerance:
                break
            error, size = call_compiled(_error, equations, (), jnp.asarray(node.z))
            if error <= self.accuracy * size:
                return equations, _observed(equations, node)
            z, way = (_resampled(equations, a) for a in (node.z, way))
            equations = _sized(equations, z)
        return None

    def followed(self, equations: InvariantCurves, last: Node) -> tuple[list[Node], End, list[Event]]:
        """Return the nodes and events beyond a node along its tangent, and why they end."""
        nodes: list[Node] = []
        events: list[Event] = []
        step = self.pace.first
        reason = ""
        while not reason:
            walk = self.walk(equations, last, step)
            point = next(iter(walk), None)
            step = walk.step
            if point is not None and _collapsed(equations, last, point):
                reason = "Neimark-Sacker"
                break
            reason = walk.ended
            found = None
            if point is not None:
                # a point on a bound stays there
                edges = (point.z == walk.low) | (point.z == walk.high)
                found = self.resolved(equations, point.z, edges if np.any(edges) else point.tangent)
            if found is None and reason != "bound":
                reason = reason or "resolution"
                if (event := self.locked(equations, last)) is not None:
                    events.append(event)
                    reason = event.note
                    if (found := self.beyond(equations, last, event)) is not None:
                        reason = ""
                        step = self.pace.first
            if found is not None:
                equations, last = found
                nodes.append(last)
                reason = reason or "count" * (len(nodes) >= self.count)
        return nodes, End(reason, step), events

    def locked(self, equations: InvariantCurves, last: Node) -> Event | None:
        """Return the interval of the parameter beyond a node in which the rotation is locked, if it is."""
        if isinstance(equations, TurningCurves):
            return None
        value, turn = last.z[-2:]
        way, slope = last.tangent[-2:]
        # the simplest fraction close ahead, and where the rotation number would reach it without locking
        shares = (Fraction(round(turn * n), n) for n in range(1, LOCKING + 1))
        share = next((share for share in shares if 0 <= (share - turn) * np.sign(slope) < AHEAD), None)
        if share is None:
            return None
        there = value + (share - turn) * way / slope
        motions = equations.motions
        periodic = dataclasses.replace(motions, intervals=motions.intervals * share.denominator)
        states = np.asarray(equations.states(last.z))
        for state in states[:: max(len(states) // STARTS, 1)]:
            guess = np.append(state, there)
            node = correct(periodic, guess, np.eye(guess.size)[-1], tolerance=self.tolerance, iterations=30)
            # on the curve, not inside
            near = np.abs(states - node.z[:-1]) <= np.ptp(states, axis=0) / STARTS
            (low, high) = self.limits[0]
            if node.residual <= self.tolerance and np.any(np.all(near, axis=1)) and low <= there <= high:
                recurring = continue_motion(periodic, (node.z[:-1], there), self.limits[0], points=100).values
                low, high = float(recurring.min()), float(recurring.max())
                # a motion that also recurs where the torus is does not lock it
                if not low <= value <= high:
                    note = f"locked {share.numerator}:{share.denominator}"
                    return Event("LK", last, low, high, True, note=note, places=(len(last.z) - 2,))
        return None

    def beyond(self, equations: InvariantCurves, last: Node, lock: Event) -> tuple[InvariantCurves, Node] | None:
        """Return equations and first node beyond a locked interval."""
        (place,) = lock.places
        way = np.sign(last.tangent[place])
        edge = lock.high if way > 0 else lock.low
        for share in BEYOND:
            z = np.array(last.z)
            z[place] = edge + share * way * (lock.high - lock.low)
            low, high = self.limits[0]
            if low < z[place] < high:
                found = self.resolved(equations, z, way * np.eye(len(z))[place])
                if found is not None:
                    return found
        return None


def _on_plane(equations: InvariantCurves, z: Numbers, way: Numbers, tolerance: float) -> Node:
    """Return the node on the plane through `z` across `way`."""
    weights = np.asarray(equations.weights(jnp.asarray(z))[1])
    return correct(equations, z, weights**2 * way, tolerance=tolerance, iterations=20)


def _resampled(equations: InvariantCurves, unknowns: Numbers) -> np.ndarray:
    """Return unknowns with twice as many states on the curve."""
    states = np.asarray(equations.states(unknowns))
    count = 2 * len(states) + 1
    waves = np.fft.rfft(states, axis=0) * count / len(states)
    return np.append(np.fft.irfft(waves, count, axis=0), unknowns[states.size :])


def _collapsed(equations: InvariantCurves, last: Node, node: Node) -> bool:
    """Return whether a curve has shrunk to a point between two nodes, and grows on the other side."""
    one, other = (np.asarray(equations.states(a.z)) for a in (last, node))
    return bool(np.sum((one - one.mean(axis=0)) * (other - other.mean(axis=0))) <= 0)
