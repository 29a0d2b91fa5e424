"""Events between two points of a branch of periodic motions: the multipliers show them, and a search locates them."""

import contextlib
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from .arclength import CRITICAL_DISTANCE, Node, Observation, correct
from .floquet import CONSERVED, multipliers, rounding_errors
from .newton import AbstractEquations

MEANINGS = {
    "LP": "fold: a multiplier +1 where the branch turns back",
    "BP": "branch point: a multiplier +1 where branches cross",
    "PD": "flip: a multiplier -1, where motions of twice the period branch off",
    "NS": "Neimark-Sacker: a complex pair of multipliers of modulus 1",
    "GR": "grazing: the order of events within a period changes",
    "EP": "end point on a bound of the parameter",
    "MX": "end: no convergence at the least step",
    "ST": "strobe: an impact falls on the instant of the strobe, where the state jumps; no bifurcation",
}
"""Labels of events, as in AUTO and COCO, with their meanings."""
NARROWEST = 1e-10
"""Share of a step at which the halving of steps ends."""
BRACKET = 1e-9
"""Share of a step before and after a root of a test function at which its sign is confirmed."""


def resonance(angle: float) -> str:
    """Return the strong resonance near the angle [rad] of a multiplier, such as "1:3"; empty where there is none.

    At a strong resonance a Neimark-Sacker need not create a torus (Kuznetsov, Elements of Applied Bifurcation Theory,
    chapter 9). Near means within 0.05 rad: the phase drifts by a turn in 126 periods.
    """
    strong = {"1:1": 0.0, "1:2": np.pi, "1:3": 2 * np.pi / 3, "1:4": np.pi / 2}
    angle = float(np.abs(np.angle(np.exp(1j * angle))))
    name = min(strong, key=lambda name: abs(angle - strong[name]))
    return name if abs(angle - strong[name]) <= 0.05 else ""


Observe = Callable[[Node], Observation]


class Event(NamedTuple):
    """A bifurcation, grazing or end point of a branch."""

    label: str
    """One of `MEANINGS`; on curves over two parameters also of `slipperjax.analysis.degenerate.POINTS`."""
    node: Node
    low: float
    """Lower bound of the parameter's value at the event; `high`: upper bound."""
    high: float
    converged: bool
    multiplier: complex = complex(np.nan)
    """Critical multiplier; NaN where there is none."""
    note: str = ""
    change: tuple[int, ...] = ()
    """Changes of `Observation.counts` at a grazing, along the branch."""
    places: tuple[int, ...] = (-1,)
    """Places of the parameters among the unknowns."""
    coefficients: Mapping[str, complex | float] = {}
    """Coefficients of the normal form, by the names of the field; empty where they are not computed."""
    stderr: Mapping[str, float] = {}
    """Errors by the steps of an integration: of the values, by the parameters' names, and of the coefficients; empty
    for maps."""

    @property
    def values(self) -> tuple[float, ...]:
        """Values of all parameters at the event."""
        return tuple(float(self.node.z[place]) for place in self.places)

    @property
    def value(self) -> float:
        """Value of the parameter at the event, of several parameters the last."""
        return self.values[-1]

    @property
    def state(self) -> np.ndarray:
        """Numbers of the state at the event."""
        return np.asarray(self.node.z[: self.places[0]])


def observed(node: Node, observe: Observe | None) -> Node:
    """Return a point of a branch with its multipliers, their errors, and the result of `observe`."""
    matrices = np.asarray(node.matrices)
    mu = np.asarray(multipliers(matrices))
    view = Observation() if observe is None else observe(node)
    return node._replace(multipliers=mu, errors=rounding_errors(mu, matrices), view=view)


def changes(one: Node, other: Node, conserved: bool = False) -> list[str]:
    """Return the labels of events between two near points of a branch; events that cancel each other are missed.

    Where the number of real multipliers above +1 changes by an odd number, one multiplier has passed +1: at a fold if
    the parameter turns back, otherwise at a branch point. An odd change below -1 is a flip. All other changes in the
    number of multipliers outside the unit circle come in pairs: complex pairs at a Neimark-Sacker, unless the number
    of real multipliers above +1 or below -1 changed by two.
    """
    above, below, outside = (abs(one.beyond(conserved, sign) - other.beyond(conserved, sign)) for sign in (1, -1, 0))
    # the parameter turns back between both points
    turns = int(one.tangent[-1] * other.tangent[-1] < 0)
    labels = [] if one.view.counts == other.view.counts else ["GR"]
    labels += ["LP"] * turns + ["BP"] * (above % 2 != turns) + ["PD"] * (below % 2)
    # rounded up: a single remaining multiplier counts as a pair
    pairs = max(-(-(outside - above % 2 - below % 2) // 2), 0)
    flips = min(below // 2, pairs)
    folds = min(above // 2, pairs - flips)
    return labels + ["PD", "PD"] * flips + ["BP", "BP"] * folds + ["NS"] * (pairs - flips - folds)


class EventSearch(NamedTuple):
    """Search for events between two points of a branch, by halving the step between them."""

    smooth = True
    """Whether the equations have smooth derivatives, see `Walk`."""

    equations: AbstractEquations
    observe: Observe | None
    tolerance: float
    conserved: bool = False
    """Whether the map is conservative at both ends of the step. At one end, at an event, the product of all
    multipliers may be 1 by chance."""

    def between(self, a: Node, b: Node) -> list[Event]:
        """Return the located events in the step of a branch from a to b, in their order."""
        return self._replace(conserved=a.conserved and b.conserved).events(a, b)

    def ends(self, node: Node) -> str:
        """Return why a branch ends before a point; empty where it goes on."""
        return ""

    def at(self, share: float, a: Node, b: Node) -> Node | None:
        """Return the branch's point on the plane across the chord, at a share of the way from a to b, or None."""
        chord = b.z - a.z
        near = a if share < 0.5 else b
        guess = a.z + share * chord
        row = near.weights**2 * chord
        # well below the tolerance, because test functions near zero are only as accurate as the point
        node = correct(self.equations, guess, row, near.z, tolerance=self.tolerance * 1e-3)
        # a point whose distance is more than the chord's length belongs to another branch
        found = node.residual <= self.tolerance and node.length(node.z - guess) <= node.length(chord)
        return observed(node, self.observe) if found else None

    def events(self, a: Node, b: Node, width: float = 1.0) -> list[Event]:
        """Return the located events between a and b; halve the step until it has only one event.

        **Arguments:** `width`: distance from a to b as a share of the branch's step.
        """
        labels = changes(a, b, self.conserved)
        if not labels:
            return []
        if labels == ["BP"]:
            return [self.crossing(a, b) or self.inseparable(labels, a, b, width)]
        # a pitchfork: the branch turns back where another branch crosses it
        if labels == ["LP", "BP"] and (event := self.crossing(a, b, turning=True)) is not None:
            return [event]
        if labels in (["LP"], ["PD"], ["NS"]):
            event = self.located(labels[0], a, b)
            # not converged: a Neimark-Sacker and a flip together may look like a single flip from both ends
            if event.converged or width <= NARROWEST:
                return [event]
        if labels == ["GR"] and (event := self.grazing(a, b)) is not None:
            return [event]
        middle = self.at(0.5, a, b) if width > NARROWEST else None
        if middle is None:
            return [self.inseparable(labels, a, b, width)]
        return self.events(a, middle, width / 2) + self.events(middle, b, width / 2)

    def narrowed(self, test: Callable[[Node], float], a: Node, b: Node) -> tuple[Node, Node, Node, float]:
        """Search a zero of `test` between a and b by Brent's method.

        **Returns:** the last point before the zero, the first point after it, the nearest point, and the share of the
        step between the first two points.
        """
        from scipy.optimize import brentq  # here, because importing it takes time that most runs need not spend

        nodes = {0.0: a, 1.0: b}

        # Brent's method may ask for a point twice; NaN (no point) ends it with an error
        def value(share: float) -> float:
            node = nodes[share] if share in nodes else self.at(share, a, b)
            if node is None:
                return np.nan
            nodes[share] = node
            return test(node)

        root = None
        with contextlib.suppress(ValueError):
            # where the test jumps, Brent's method may end with a wide bracket, so that two more points narrow it
            root = float(brentq(value, 0.0, 1.0, xtol=NARROWEST / 100, rtol=1e-14, maxiter=60, disp=False))
            value(max(root - BRACKET, 0.0))
            value(min(root + BRACKET, 1.0))
        tests = {share: test(node) for share, node in nodes.items()}
        if root is None:
            root = min(tests, key=lambda share: abs(tests[share]))
        low = max((s for s in tests if tests[s] * tests[0.0] > 0 and s <= root), default=0.0)
        high = min((s for s in tests if tests[s] * tests[1.0] > 0 and s >= root), default=1.0)
        return nodes[low], nodes[high], nodes[root], high - low

    def located(self, label: str, a: Node, b: Node) -> Event:
        """Return a fold, flip or Neimark-Sacker located by the sign of its test function."""
        low, high, nearest, width = self.narrowed(self.test(label, a, b), a, b)
        values = [float(node.z[-1]) for node in (low, high, nearest)]
        critical = _critical(label, nearest, self.index(a, b))
        on_circle = complex(np.exp(1j * np.angle(critical)))
        expected = {"LP": 1.0, "PD": -1.0, "NS": on_circle}[label]
        near = abs(critical - expected) < CRITICAL_DISTANCE + CONSERVED * self.conserved
        converged = width <= 4 * BRACKET and near and (label != "NS" or critical.imag != 0)
        near_to = resonance(np.angle(critical)) if label == "NS" else ""
        note = f"near the strong resonance {near_to}: a torus need not branch off" if near_to else ""
        node = nearest._replace(label=label)
        return Event(label, node, min(values), max(values), bool(converged), critical, note)

    def crossing(self, a: Node, b: Node, turning: bool = False) -> Event | None:
        """Return a branch point located by interpolation between points on both sides, or None.

        At the branch point itself the equations are singular.

        **Arguments:** `turning`: whether it belongs to a pitchfork, on the branch that turns back there; then the
        result is None where the fold is elsewhere.
        """
        test = self.test("LP" if turning else "BP", a, b)
        index = self.index(a, b)
        rough = test(a) / (test(a) - test(b))
        # points within a share of the step around it, or within a larger share where these points fail
        for spread in (0.2, 0.3, 0.5):
            shares = rough + spread * np.linspace(-1, 1, 8)  # also beyond a or b, near the branch point
            nodes = [self.at(share, a, b) for share in shares]
            nodes = [node for node in nodes if node is not None and _along(node, a, b)]
            tests = np.array([test(node) for node in nodes])
            if len(nodes) < 4 or np.all(tests > 0) or np.all(tests < 0):
                continue
            # the multiplier may touch +1 there without passing it: value and slope of its distance are zero
            beyond = np.array([[_critical("BP", node, index).real - 1] for node in nodes])
            touches = np.abs(_polynomials(tests, beyond)[:2]).max() < 1e-5 * np.abs(beyond).max()
            if np.abs(tests).min() > 1e-3 * np.abs(tests).max() and (touches or not turning):
                break
        else:
            return None
        # all unknowns as polynomials of the test function, at its zero
        unknowns = np.array([node.z for node in nodes])
        z = _polynomials(tests, unknowns)[0]
        tangent = _polynomials(tests, np.array([node.tangent for node in nodes]))[0]
        # this point is without Newton's method, which leaves the direction undetermined
        node = correct(self.equations, z, tangent, tolerance=self.tolerance, iterations=0)
        node = observed(node._replace(tangent=tangent, label="BP"), self.observe)
        # the error is the difference from a polynomial through fewer points
        error = float(abs(z[-1] - _polynomials(tests[1:-1], unknowns[1:-1])[0][-1]))
        value = float(z[-1])
        return Event("BP", node, value - error, value + error, True, _critical("BP", node, index))

    def grazing(self, a: Node, b: Node) -> Event | None:
        """Return a single grazing, located; None where there are several grazings, or other events near it."""
        before, after = a.view.counts, b.view.counts
        kinds = [k for k, (m, n) in enumerate(zip(before, after, strict=True)) if m != n]

        def test(node: Node) -> float:
            counts = node.view.counts
            if counts not in (before, after) and changes(a, node, self.conserved):
                return np.nan
            # margins have no sign: they become positive on the side of a, where the counts equal those of a
            return (1.0 if counts == before else -1.0) * min(node.view.margins[k] for k in kinds)

        low, high, _, width = self.narrowed(test, a, b)
        if width > 4 * BRACKET or changes(low, high, self.conserved) != ["GR"]:
            return None
        return self.inseparable(["GR"], low, high, NARROWEST)

    def index(self, a: Node, b: Node) -> int:
        """Return the index of the critical multiplier, constant along a branch where moduli sort the multipliers."""
        return min(node.beyond(self.conserved) for node in (a, b))

    def test(self, label: str, a: Node, b: Node) -> Callable[[Node], float]:
        """Return a continuous function of a point that is zero at the event."""
        if label == "LP":
            return lambda node: float(node.tangent[-1] * node.weights[-1])
        if label == "BP":  # the product is also smooth where a pair of multipliers meets at +1
            return lambda node: float(np.prod(node.multipliers - 1).real)
        index = self.index(a, b)
        return lambda node: float(np.abs(node.multipliers[index]) - 1 - CONSERVED * self.conserved)

    def inseparable(self, labels: list[str], a: Node, b: Node, width: float) -> Event:
        """Return one event in place of several that cannot be separated; or a grazing, which is between points."""
        label = "GR" if "GR" in labels else labels[0]
        notes = []
        if set(labels) != {"GR"}:
            # the two largest multipliers on both sides
            one, other = (", ".join(f"{m:.4g}" for m in node.multipliers[:2]) for node in (a, b))
            notes.append(f"multipliers jump from {one} to {other}")
        alone = width <= NARROWEST
        if not alone:
            notes.append(f"{width:.1g} of a step could not be divided")
        low, high = sorted((float(a.z[-1]), float(b.z[-1])))
        critical = complex(np.nan) if label == "GR" else _critical(label, a, self.index(a, b))
        change = tuple(n - m for m, n in zip(a.view.counts, b.view.counts, strict=True))
        return Event(label, a._replace(label=label), low, high, alone, critical, "; ".join(notes), change)


def _along(node: Node, a: Node, b: Node) -> bool:
    """Return whether a point is on the branch from a to b, and not on a branch that crosses it."""
    chord = a.weights * (b.z - a.z)
    cosine = abs(chord @ (node.weights * node.tangent)) / np.linalg.norm(chord)
    return bool(cosine > 0.95)


def _polynomials(tests: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return coefficients of polynomials in tests / max |tests| (count,) through `values` (count, more).

    The first row holds the polynomials' values where the test is zero.
    """
    return np.linalg.solve(np.vander(tests / np.abs(tests).max(), increasing=True), values)


def _critical(label: str, node: Node, index: int) -> complex:
    """Return the critical multiplier at an event; `index`: place of the pair for "NS"."""
    mu = node.multipliers
    if label == "NS":
        return complex(mu[index].real, abs(mu[index].imag))
    return complex(mu[np.argmin(np.abs(mu - (-1.0 if label == "PD" else 1.0)))])


class NoSearch(EventSearch):
    """No search for events, on curves of motions with a condition."""

    smooth = False

    def between(self, a, b):
        return []
