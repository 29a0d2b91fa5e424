"""What happens between two points of a branch of periodic motions: detected by multipliers and located."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex

from .curves import Spot, between, evaluated
from .floquet import multipliers
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
NARROW = 1e-10
"""Share of a step to which an event is located."""
SURE = 1e-9
"""Share of a step on both sides of a smooth event at which its sign is confirmed, for its bracket."""
APART = 0.2, 0.3, 0.5
"""Shares of a step on both sides of a branch point from which it is interpolated; more where it is not there."""
ALONG = 0.95
"""Least cosine between the tangent at a point and the chord on which it was looked for, beside a branch point."""
TOUCHING = 1e-5
"""Greatest distance and slope of a multiplier at +1 that counts as touching, over its distance nearby."""
POLISHED = 1e-3
"""Residual aimed at near events, over the one that suffices."""
NEAR = 1e-6
"""Greatest distance of the critical multiplier's modulus from 1 at an event that counts as converged."""


class Observation(NamedTuple):
    """What changes at grazings, as a user's function finds it at a point."""

    counts: tuple[int, ...] = ()
    """Numbers of events in a period, by kind, such as the touchdowns of each point. Where one changes, there is a
    grazing."""
    margins: tuple[float, ...] = ()
    """For each kind, how far the orbit is from such a change: zero there, and continuous in its neighbourhood."""
    data: Any = None
    """Whatever else is to be kept."""


Observe = Callable[[Spot], Observation]


class Node(NamedTuple):
    """A point of a branch with what was found of it."""

    spot: Spot
    multipliers: Complex[np.ndarray, " size"]
    """The largest modulus first."""
    seen: Observation
    label: str = ""
    """Of the event that it is, empty for others."""

    @property
    def outside(self) -> int:
        """Multipliers outside the unit circle."""
        return int(np.sum(np.abs(self.multipliers) > 1))

    def real_beyond(self, sign: int) -> int:
        """Real multipliers beyond +1 or -1."""
        return int(np.sum((self.multipliers.imag == 0) & (sign * self.multipliers.real > 1)))


class Event(NamedTuple):
    """Something that happens on a branch."""

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
    """How `Observation.counts` change at a grazing, in the direction of the branch."""


def as_node(spot: Spot, observe: Observe | None) -> Node:
    """A point with its multipliers and what `observe` gives."""
    seen = Observation() if observe is None else observe(spot)
    return Node(spot, np.asarray(multipliers(np.asarray(spot.extra))), seen)


def changes(one: Node, other: Node) -> list[str]:
    """Labels of what happens between two near points of a branch; a pair that comes and goes again is not seen.

    A real multiplier passes +1 where the parity of those beyond changes: at a fold where the parameter turns, else at
    a branch point. Likewise for -1. What is left of the change in the number outside are pairs: complex ones, unless
    the real ones beyond changed by two.
    """
    beyond = lambda sign: abs(one.real_beyond(sign) - other.real_beyond(sign))
    parity = lambda sign: beyond(sign) % 2
    turns = int(one.spot.tangent[-1] * other.spot.tangent[-1] < 0)
    found = [] if one.seen.counts == other.seen.counts else ["GR"]
    found += ["LP"] * turns + ["BP"] * (parity(1) != turns) + ["PD"] * parity(-1)
    left = abs(one.outside - other.outside) - parity(1) - parity(-1)
    pairs = max(-(-left // 2), 0)
    flips = min(beyond(-1) // 2, pairs)
    folds = min(beyond(1) // 2, pairs - flips)
    return found + ["PD", "PD"] * flips + ["BP", "BP"] * folds + ["NS"] * (pairs - flips - folds)


def events_between(
    one: Node,
    other: Node,
    equations: AbstractEquations,
    observe: Observe | None,
    tolerance: float,
) -> list[Event]:
    """The events between two consecutive points of a branch, in their order."""

    def at(share: float, a: Node, b: Node) -> Node | None:
        spot = between(equations, a.spot, b.spot, share, tolerance * POLISHED)
        chord = np.linalg.norm(spot.weights * (b.spot.z - a.spot.z))
        strayed = np.linalg.norm(spot.weights * (spot.z - a.spot.z - share * (b.spot.z - a.spot.z)))
        return as_node(spot, observe) if spot.residual <= tolerance and strayed <= chord else None

    def placed(node: Node, z: np.ndarray, tangent: np.ndarray) -> Node:
        now = evaluated(equations, z)
        size = weighted_size(now.residual, equations.weights(jnp.asarray(z))[0])
        return as_node(node.spot._replace(z=z, tangent=tangent, residual=np.asarray(size), extra=now.extra), observe)

    def search(a: Node, b: Node, width: float) -> list[Event]:
        labels = changes(a, b)
        if not labels:
            return []
        if labels == ["BP"]:
            return [_crossing(a, b, at, placed) or _inseparable(labels, a, b, width)]
        if labels == ["LP", "BP"] and (event := _crossing(a, b, at, placed, turning=True)) is not None:
            return [event]
        if labels in (["LP"], ["PD"], ["NS"]):
            event = _located(labels[0], a, b, at)
            # what looks like a flip from both ends may be a Neimark-Sacker and a flip
            if event.converged or width <= NARROW:
                return [event]
        if labels == ["GR"] and (event := _grazing(a, b, at)) is not None:
            return [event]
        middle = at(0.5, a, b) if width > NARROW else None
        if middle is None:
            return [_inseparable(labels, a, b, width)]
        return search(a, middle, width / 2) + search(middle, b, width / 2)

    return search(one, other, 1.0)


def _test(label: str, a: Node, b: Node) -> Callable[[Node], float]:
    """A continuous function of a point that is zero at the event."""
    if label == "LP":
        return lambda node: float(node.spot.tangent[-1] * node.spot.weights[-1])
    place = min(a.outside, b.outside)  # sorted moduli are continuous
    return lambda node: float(np.abs(node.multipliers[place]) - 1)


class _Lost(Exception):
    """There is no point of the branch between two of its points."""


def _located(label: str, a: Node, b: Node, at: Callable) -> Event:
    from scipy.optimize import brentq  # here, because importing it takes time that most runs need not spend

    test, seen = _test(label, a, b), {0.0: a, 1.0: b}

    def value(share: float) -> float:
        if share not in seen:
            node = at(share, a, b)
            if node is None:
                raise _Lost
            seen[share] = node
        return test(seen[share])

    try:
        # where the test jumps, the bracket may still be wide at the end: `converged` tells
        how: dict[str, Any] = dict(xtol=NARROW / 100, rtol=1e-14, maxiter=60, full_output=True, disp=False)
        root = cast(float, brentq(value, 0.0, 1.0, **how)[0])
        value(root)
        for near in (max(root - SURE, 0.0), min(root + SURE, 1.0)):
            value(near)
    except (_Lost, ValueError):
        root = min(seen, key=lambda share: abs(test(seen[share])))
    node = seen[root]
    signs = {share: test(n) > 0 for share, n in seen.items()}
    low = max((s for s in seen if signs[s] == signs[0.0] and s <= root), default=0.0)
    high = min((s for s in seen if signs[s] == signs[1.0] and s >= root), default=1.0)
    values = [float(seen[s].spot.z[-1]) for s in (low, high, root)]
    critical = _critical(label, node, min(a.outside, b.outside))
    on_circle = complex(np.exp(1j * np.angle(critical)))
    target = {"LP": 1.0, "PD": -1.0}.get(label, on_circle)
    converged = high - low <= 4 * SURE and abs(critical - target) < NEAR and (label != "NS" or critical.imag != 0)
    return Event(label, node._replace(label=label), min(values), max(values), critical, bool(converged), "")


def _crossing(a: Node, b: Node, at: Callable, placed: Callable, turning: bool = False) -> Event | None:
    """A branch point, by interpolation from both sides: there itself Newton's method is singular.

    With `turning` that of a pitchfork, on the branch that turns back there; None where the fold is another place.
    """
    test, place = _test("LP" if turning else "BP", a, b), min(a.outside, b.outside)
    rough = test(a) / (test(a) - test(b))
    for spread in APART:
        shares = rough + spread * np.linspace(-1, 1, 8)  # also beyond a or b where these are the branch point
        found = [node for node in (at(share, a, b) for share in shares) if node is not None and _along(node, a, b)]
        tests = np.array([test(node) for node in found])
        if len(found) < 4 or np.all(tests > 0) or np.all(tests < 0):
            continue
        beyond = np.array([[_critical("BP", node, place).real - 1] for node in found])
        touches = np.abs(_polynomials(tests, beyond)[:2]).max() < TOUCHING * np.abs(beyond).max()
        if np.abs(tests).min() > 1e-3 * np.abs(tests).max() and (touches or not turning):
            break
    else:
        return None
    places, tangents = (np.array([getattr(node.spot, name) for node in found]) for name in ("z", "tangent"))
    z, fewer = _polynomials(tests, places)[0], _polynomials(tests[1:-1], places[1:-1])[0]
    node = placed(found[len(found) // 2], z, _polynomials(tests, tangents)[0])._replace(label="BP")
    error = float(abs(z[-1] - fewer[-1]))
    return Event("BP", node, float(z[-1] - error), float(z[-1] + error), _critical("BP", node, place), True, "")


def _along(node: Node, a: Node, b: Node) -> bool:
    """Whether a point lies on the branch from a to b, and not on one that crosses it."""
    chord = a.spot.weights * (b.spot.z - a.spot.z)
    return bool(abs(chord @ (node.spot.weights * node.spot.tangent)) > ALONG * np.linalg.norm(chord))


def _polynomials(tests: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients of the polynomials in `tests` (count,), over its greatest, that go through `values` (count, more).
    The first row is what they are where the test is zero."""
    return np.linalg.solve(np.vander(tests / np.abs(tests).max(), increasing=True), values)


def _grazing(a: Node, b: Node, at: Callable) -> Event | None:
    """A single grazing; None where there are several, or other events beside it."""
    from scipy.optimize import brentq

    kinds = [k for k, (m, n) in enumerate(zip(a.seen.counts, b.seen.counts, strict=True)) if m != n]
    seen = {0.0: a, 1.0: b}

    def value(share: float) -> float:
        if share not in seen:
            node = at(share, a, b)
            if node is None or (node.seen.counts != b.seen.counts and changes(a, node)):
                raise _Lost
            seen[share] = node
        sign = 1.0 if seen[share].seen.counts == a.seen.counts else -1.0
        return sign * min(seen[share].seen.margins[k] for k in kinds)

    try:
        brentq(value, 0.0, 1.0, xtol=NARROW, rtol=1e-14, maxiter=60, disp=False)
        before = max(share for share in seen if value(share) > 0)
        value(before + SURE)
    except (_Lost, ValueError):
        return None
    low = max(share for share in seen if value(share) > 0)
    high = min(share for share in seen if value(share) < 0)
    if high - low > 4 * SURE or changes(seen[low], seen[high]) != ["GR"]:
        return None
    return _inseparable(["GR"], seen[low], seen[high], NARROW)


def _critical(label: str, node: Node, place: int) -> complex:
    """The multiplier that is critical at an event; `place`: of the pair's among them."""
    found = node.multipliers
    if label == "NS":
        return complex(found[place].real, abs(found[place].imag))
    return complex(found[np.argmin(np.abs(found - (-1.0 if label == "PD" else 1.0)))])


def _inseparable(labels: list[str], a: Node, b: Node, width: float) -> Event:
    """Several events, or a grazing, that no further point of the branch parts."""
    others = [label for label in labels if label != "GR"]
    label = "GR" if "GR" in labels else labels[0]
    notes = [f"multipliers jump from {_leading(a)} to {_leading(b)}"] if others else []
    notes += [f"{width:.1g} of a step could not be divided"] if width > NARROW else []
    low, high = sorted((float(a.spot.z[-1]), float(b.spot.z[-1])))
    critical = complex(np.nan) if label == "GR" else _critical(label, a, min(a.outside, b.outside))
    change = tuple(n - m for m, n in zip(a.seen.counts, b.seen.counts, strict=True))
    return Event(label, a._replace(label=label), low, high, critical, width <= NARROW, "; ".join(notes), change)


def _leading(node: Node) -> str:
    return ", ".join(f"{m:.4g}" for m in node.multipliers[:2])
