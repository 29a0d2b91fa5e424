"""Events between two points of a branch of periodic motions, detected by multipliers and located."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex

from .curves import Spot, correct, evaluated
from .floquet import CONSERVED, is_conservative, multipliers, rounding_errors
from .newton import AbstractEquations, weighted_size

MEANINGS = {
    "LP": "fold: a multiplier +1 where the branch turns back",
    "BP": "branch point: a multiplier +1 where branches cross",
    "PD": "flip: a multiplier -1, where motions of twice the period branch off",
    "NS": "Neimark-Sacker: a complex pair of multipliers of modulus 1",
    "GR": "grazing: the order of events within a period changes",
    "EP": "end point on a bound of the parameter",
    "MX": "end: no convergence at the least step",
}
"""Labels of events, as AUTO's and COCO's users know them."""
NARROWEST = 1e-10
"""Share of a step to which an event is located."""
BRACKET = 1e-9
"""Share of a step on both sides of a smooth event at which its sign is confirmed."""
SPREADS = 0.2, 0.3, 0.5
"""Shares of a step on both sides of a branch point from which it is interpolated; the next where one fails."""
SAME_BRANCH = 0.95
"""Least cosine between the tangent at a point and the chord on which it was looked for, near a branch point."""
TOUCHING = 1e-5
"""Greatest distance and slope of a multiplier at +1 that counts as touching, over its distance nearby."""
POLISH = 1e-3
"""Residual aimed at near events, over the tolerance."""
CRITICAL_DISTANCE = 1e-6
"""Greatest distance of a critical multiplier's modulus from 1."""


STRONG = {"1:1": 0.0, "1:2": np.pi, "1:3": 2 * np.pi / 3, "1:4": np.pi / 2}
"""Angles of multipliers at strong resonances, where no torus needs to leave a Neimark-Sacker (Kuznetsov, Elements of
Applied Bifurcation Theory, chapter 9)."""
RESONANT = 0.05
"""Greatest distance from such an angle that counts as near it: the phase drifts by a turn in 126 periods."""


def resonance(angle: float) -> str:
    """Names the strong resonance that a multiplier of this angle is near, such as "1:3"; empty for none."""
    angle = float(np.abs(np.angle(np.exp(1j * angle))))
    name = min(STRONG, key=lambda name: abs(angle - STRONG[name]))
    return name if abs(angle - STRONG[name]) <= RESONANT else ""


class Observation(NamedTuple):
    """A user's view of a point, by which grazings are detected."""

    counts: tuple[int, ...] = ()
    """Numbers of events in a period, by kind, such as the touchdowns of each point. Where one changes, there is a
    grazing."""
    margins: tuple[float, ...] = ()
    """Distance of the orbit from such a change, for each kind: zero there, and continuous in its neighbourhood."""
    data: Any = None
    """Anything else to keep."""


Observe = Callable[[Spot], Observation]


class Node(NamedTuple):
    """A point of a branch with its multipliers and the user's view of it."""

    spot: Spot
    multipliers: Complex[np.ndarray, " size"]
    """The largest modulus first."""
    view: Observation
    label: str = ""
    """Of the event that it is, empty for others."""
    errors: Any = 0.0
    """Of the multipliers by rounding, see `rounding_errors`."""

    @property
    def conserved(self) -> bool:
        """Whether the map is conservative here, so that multipliers on the unit circle are neutral."""
        return bool(is_conservative(self.multipliers))

    @property
    def margins(self) -> np.ndarray:
        """Distances from the unit circle within which multipliers are neutral, where this point is seen alone."""
        return np.maximum(self.errors, margin(self.conserved))

    @property
    def outside(self) -> int:
        """Number of multipliers outside the unit circle, without neutral ones."""
        return self.beyond(np.abs(self.multipliers), self.conserved)

    def beyond(self, sizes: np.ndarray, conserved: bool) -> int:
        """Counts sizes of multipliers above one by more than their errors."""
        return int(np.sum(sizes > 1 + np.maximum(self.errors, margin(conserved))))

    def real_beyond(self, sign: int, conserved: bool) -> int:
        """Counts the real multipliers beyond +1 or -1, without neutral ones."""
        real = np.where(self.multipliers.imag == 0, sign * self.multipliers.real, 0.0)
        return self.beyond(real, conserved)


def margin(conserved: bool) -> float:
    """Gives the distance from the unit circle within which multipliers are neutral, rounding apart."""
    return CONSERVED if conserved else 0.0


class Event(NamedTuple):
    """A bifurcation, grazing or end point of a branch."""

    label: str
    """One of `MEANINGS`."""
    node: Node
    low: float
    """The parameter's values between which it lies."""
    high: float
    multiplier: complex
    """The critical multiplier, NaN where there is none."""
    converged: bool
    note: str
    change: tuple[int, ...] = ()
    """Changes of `Observation.counts` at a grazing, in the direction of the branch."""


def as_node(spot: Spot, observe: Observe | None) -> Node:
    """Makes a node with the multipliers and the observation of a point."""
    view = Observation() if observe is None else observe(spot)
    mu = np.asarray(multipliers(np.asarray(spot.matrices)))
    return Node(spot, mu, view, errors=rounding_errors(mu, spot.matrices))


def changes(one: Node, other: Node, conserved: bool = False) -> list[str]:
    """Gives the labels of events between two near points of a branch; a pair that comes and goes again is missed.

    A real multiplier passes +1 where the parity of those beyond changes: at a fold where the parameter turns, else at
    a branch point. Likewise for -1. What is left of the change in the number outside are pairs: complex ones, unless
    the real ones beyond changed by two.
    """
    beyond = lambda sign: abs(one.real_beyond(sign, conserved) - other.real_beyond(sign, conserved))
    parity = lambda sign: beyond(sign) % 2
    turns = int(one.spot.tangent[-1] * other.spot.tangent[-1] < 0)
    labels = [] if one.view.counts == other.view.counts else ["GR"]
    labels += ["LP"] * turns + ["BP"] * (parity(1) != turns) + ["PD"] * parity(-1)
    outside = [node.beyond(np.abs(node.multipliers), conserved) for node in (one, other)]
    left = abs(outside[0] - outside[1]) - parity(1) - parity(-1)
    pairs = max(-(-left // 2), 0)
    flips = min(beyond(-1) // 2, pairs)
    folds = min(beyond(1) // 2, pairs - flips)
    return labels + ["PD", "PD"] * flips + ["BP", "BP"] * folds + ["NS"] * (pairs - flips - folds)


class _Lost(Exception):
    """There is no point of the branch between two of its points."""


class EventSearch(NamedTuple):
    """Search for events between points of a branch."""

    equations: AbstractEquations
    observe: Observe | None
    tolerance: float
    conserved: bool = False
    """Whether the map is conservative at both ends of the step of the branch. One end may also be an event at which
    the product of all multipliers passes one."""

    def between(self, a: Node, b: Node) -> list[Event]:
        """Locates the events in the step of a branch from a to b, in their order."""
        return self._replace(conserved=a.conserved and b.conserved).events(a, b)

    def at(self, share: float, a: Node, b: Node) -> Node | None:
        """Gives the branch's point in the plane across the chord at a share of the way from a to b.

        None where none is found nearby.
        """
        chord, near = b.spot.z - a.spot.z, a.spot if share < 0.5 else b.spot
        guess, row = a.spot.z + share * chord, near.weights**2 * chord
        spot = correct(self.equations, guess, row, near.z, tolerance=self.tolerance * POLISH)
        length, strayed = (np.linalg.norm(spot.weights * way) for way in (chord, spot.z - guess))
        return as_node(spot, self.observe) if spot.residual <= self.tolerance and strayed <= length else None

    def events(self, a: Node, b: Node, width: float = 1.0) -> list[Event]:
        """Locates the events between a and b: halves the step until each is alone.

        **Arguments:** `width`: share of the step between two consecutive points of the branch.
        """
        labels = changes(a, b, self.conserved)
        if not labels:
            return []
        if labels == ["BP"]:
            return [self.crossing(a, b) or self.inseparable(labels, a, b, width)]
        if labels == ["LP", "BP"] and (event := self.crossing(a, b, turning=True)) is not None:
            return [event]
        if labels in (["LP"], ["PD"], ["NS"]):
            event = self.located(labels[0], a, b)
            # what looks like a flip from both ends may be a Neimark-Sacker and a flip
            if event.converged or width <= NARROWEST:
                return [event]
        if labels == ["GR"] and (event := self.grazing(a, b)) is not None:
            return [event]
        middle = self.at(0.5, a, b) if width > NARROWEST else None
        if middle is None:
            return [self.inseparable(labels, a, b, width)]
        return self.events(a, middle, width / 2) + self.events(middle, b, width / 2)

    def bracketed(
        self, test: Callable[[Node], float], a: Node, b: Node, xtol: float
    ) -> tuple[dict[float, Node], float | None]:
        """Looks for a zero of `test` between a and b by Brent's method.

        **Returns:** the points on the way, by their share of it, and the zero's share, None where it is not found.
        """
        from scipy.optimize import brentq  # here, because importing it takes time that most runs need not spend

        nodes = {0.0: a, 1.0: b}

        def value(share: float) -> float:
            if share not in nodes:
                node = self.at(share, a, b)
                if node is None:
                    raise _Lost
                nodes[share] = node
            return test(nodes[share])

        try:
            # where the test jumps, the bracket may still be wide at the end
            options: dict[str, Any] = dict(xtol=xtol, rtol=1e-14, maxiter=60, full_output=True, disp=False)
            root = cast(float, brentq(value, 0.0, 1.0, **options)[0])
            for share in (root, max(root - BRACKET, 0.0), min(root + BRACKET, 1.0)):
                value(share)
        except (_Lost, ValueError):
            return nodes, None
        return nodes, root

    def located(self, label: str, a: Node, b: Node) -> Event:
        """Locates a fold, flip or Neimark-Sacker by the sign of its test function."""
        test = self.test(label, a, b)
        nodes, root = self.bracketed(test, a, b, NARROWEST / 100)
        if root is None:
            root = min(nodes, key=lambda share: abs(test(nodes[share])))
        positive = {share: test(node) > 0 for share, node in nodes.items()}
        low = max((s for s in nodes if positive[s] == positive[0.0] and s <= root), default=0.0)
        high = min((s for s in nodes if positive[s] == positive[1.0] and s >= root), default=1.0)
        values = [float(nodes[share].spot.z[-1]) for share in (low, high, root)]
        critical = _critical(label, nodes[root], self.index(a, b))
        on_circle = complex(np.exp(1j * np.angle(critical)))
        near = abs(critical - {"LP": 1.0, "PD": -1.0}.get(label, on_circle)) < CRITICAL_DISTANCE + margin(
            self.conserved
        )
        converged = high - low <= 4 * BRACKET and near and (label != "NS" or critical.imag != 0)
        node = nodes[root]._replace(label=label)
        near_to = resonance(np.angle(critical)) if label == "NS" else ""
        note = f"near the strong resonance {near_to}: a torus need not branch off" if near_to else ""
        return Event(label, node, min(values), max(values), critical, bool(converged), note)

    def crossing(self, a: Node, b: Node, turning: bool = False) -> Event | None:
        """Locates a branch point by interpolation from both sides: there itself Newton's method is singular.

        With `turning` that of a pitchfork, on the branch that turns back there; None where the fold is elsewhere.
        """
        test, index = self.test("LP" if turning else "BP", a, b), self.index(a, b)
        rough = test(a) / (test(a) - test(b))
        for spread in SPREADS:
            shares = rough + spread * np.linspace(-1, 1, 8)  # also beyond a or b where these are the branch point
            nodes = [self.at(share, a, b) for share in shares]
            nodes = [node for node in nodes if node is not None and _along(node, a, b)]
            tests = np.array([test(node) for node in nodes])
            if len(nodes) < 4 or np.all(tests > 0) or np.all(tests < 0):
                continue
            beyond = np.array([[_critical("BP", node, index).real - 1] for node in nodes])
            touches = np.abs(_polynomials(tests, beyond)[:2]).max() < TOUCHING * np.abs(beyond).max()
            if np.abs(tests).min() > 1e-3 * np.abs(tests).max() and (touches or not turning):
                break
        else:
            return None
        unknowns, tangents = (np.array([getattr(node.spot, name) for node in nodes]) for name in ("z", "tangent"))
        z, fewer = _polynomials(tests, unknowns)[0], _polynomials(tests[1:-1], unknowns[1:-1])[0]
        # the point there without Newton's method
        now = evaluated(self.equations, z)
        size = np.asarray(weighted_size(now.residual, self.equations.weights(jnp.asarray(z))[0]))
        tangent = _polynomials(tests, tangents)[0]
        spot = nodes[len(nodes) // 2].spot._replace(z=z, tangent=tangent, residual=size, matrices=now.matrices)
        node = as_node(spot, self.observe)._replace(label="BP")
        error = float(abs(z[-1] - fewer[-1]))
        return Event("BP", node, float(z[-1] - error), float(z[-1] + error), _critical("BP", node, index), True, "")

    def grazing(self, a: Node, b: Node) -> Event | None:
        """Locates a single grazing; None where there are several, or other events near it."""
        kinds = [k for k, (m, n) in enumerate(zip(a.view.counts, b.view.counts, strict=True)) if m != n]
        before = lambda node: node.view.counts == a.view.counts

        def test(node: Node) -> float:
            if not before(node) and node.view.counts != b.view.counts and changes(a, node, self.conserved):
                raise _Lost
            # the margin has no sign: that is whether the counts are still those of a
            return (1.0 if before(node) else -1.0) * min(node.view.margins[k] for k in kinds)

        nodes, root = self.bracketed(test, a, b, NARROWEST)
        if root is None:
            return None
        low = max(share for share, node in nodes.items() if test(node) > 0)
        high = min(share for share, node in nodes.items() if test(node) < 0)
        if high - low > 4 * BRACKET or changes(nodes[low], nodes[high], self.conserved) != ["GR"]:
            return None
        return self.inseparable(["GR"], nodes[low], nodes[high], NARROWEST)

    def index(self, a: Node, b: Node) -> int:
        """Gives the place of the critical multiplier among those sorted by their moduli, which are continuous."""
        return min(node.beyond(np.abs(node.multipliers), self.conserved) for node in (a, b))

    def test(self, label: str, a: Node, b: Node) -> Callable[[Node], float]:
        """Gives a continuous function of a point that is zero at the event."""
        if label == "LP":
            return lambda node: float(node.spot.tangent[-1] * node.spot.weights[-1])
        if label == "BP":  # which is smooth where a pair meets at +1, too
            return lambda node: float(np.prod(node.multipliers - 1).real)
        index = self.index(a, b)
        return lambda node: float(np.abs(node.multipliers[index]) - 1 - margin(self.conserved))

    def inseparable(self, labels: list[str], a: Node, b: Node, width: float) -> Event:
        """Makes one event of several, or of a grazing, that no further point of the branch separates."""
        others = [label for label in labels if label != "GR"]
        label = "GR" if "GR" in labels else labels[0]
        leading = lambda node: ", ".join(f"{m:.4g}" for m in node.multipliers[:2])
        notes = [f"multipliers jump from {leading(a)} to {leading(b)}"] if others else []
        notes += [f"{width:.1g} of a step could not be divided"] if width > NARROWEST else []
        low, high = sorted((float(a.spot.z[-1]), float(b.spot.z[-1])))
        critical = complex(np.nan) if label == "GR" else _critical(label, a, self.index(a, b))
        change = tuple(n - m for m, n in zip(a.view.counts, b.view.counts, strict=True))
        return Event(
            label, a._replace(label=label), low, high, critical, width <= NARROWEST, "; ".join(notes), change
        )


def _along(node: Node, a: Node, b: Node) -> bool:
    """Tells whether a point lies on the branch from a to b, and not on one that crosses it."""
    chord = a.spot.weights * (b.spot.z - a.spot.z)
    return bool(abs(chord @ (node.spot.weights * node.spot.tangent)) > SAME_BRANCH * np.linalg.norm(chord))


def _polynomials(tests: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gives the coefficients of polynomials in `tests` (count,), over its greatest, through `values` (count, more).
    The first row has their values where the test is zero."""
    return np.linalg.solve(np.vander(tests / np.abs(tests).max(), increasing=True), values)


def _critical(label: str, node: Node, index: int) -> complex:
    """Gives the multiplier that is critical at an event; `index`: of a pair among the multipliers."""
    mu = node.multipliers
    if label == "NS":
        return complex(mu[index].real, abs(mu[index].imag))
    return complex(mu[np.argmin(np.abs(mu - (-1.0 if label == "PD" else 1.0)))])
