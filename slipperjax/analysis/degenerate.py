"""Points of codimension two on curves of folds, flips and Neimark-Sackers: named, located, with their normal forms.

Each kind of point is a zero of a test function along the curve. A further multiplier on the unit circle is a zero of
a product over the other multipliers; the rest are zeros of a coefficient of the curve's own normal form, of the
product of both null vectors, or of the distance of the angle from a strong resonance.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from .arclength import Node, correct
from .continuation import parameter_places
from .events import BRACKET, Event, EventSearch, observed
from .normal_forms import FORMS, NormalForm, Number, normal_form
from .shooting import PeriodicMotions

POINTS = {
    "CP": "cusp: two folds meet",
    "GPD": "generalised flip: the flip changes its side",
    "CH": "Chenciner point: the Neimark-Sacker changes its side",
    "R1": "strong resonance 1:1: a double multiplier +1",
    "R2": "strong resonance 1:2: a double multiplier -1",
    "R3": "strong resonance 1:3",
    "R4": "strong resonance 1:4",
    "LPPD": "fold and flip",
    "LPNS": "fold and Neimark-Sacker",
    "PDNS": "flip and Neimark-Sacker",
    "NSNS": "two Neimark-Sackers",
    "GRLP": "grazing where folds leave",
    "GRPD": "grazing where flips leave",
}
"""Labels of points of codimension two, as in MatContM but for grazings, with their meanings."""
ZERO = 1e-3
"""Greatest value of a test function at its zero, as a share of its values before and behind. It is larger at a pole
or a jump, which also changes the sign."""
ON_CIRCLE = 1e-6
"""Greatest distance from the unit circle of a further complex pair of multipliers."""

Test = Callable[[PeriodicMotions, Node], float]
"""Function of a point of a curve that is zero at a point of codimension two."""


def others(label: str, node: Node) -> np.ndarray:
    """Return the multipliers without the critical ones of a curve."""
    rest = list(node.multipliers)
    for mu in critical(label, node):
        rest.pop(int(np.argmin(np.abs(np.array(rest) - mu))))
    return np.array(rest)


def critical(label: str, node: Node) -> Sequence[Number]:
    """Return the critical multipliers of a curve at a point, with the conjugate of a complex one."""
    (mu,) = FORMS[label].critical
    return [complex(np.exp(sign * 1j * node.z[-1])) for sign in (1, -1)] if mu is None else [mu]


def _beside(label: str, mu: float) -> Test:
    """Return the product over the other multipliers that is zero where one is `mu`."""
    return lambda motions, node: float(np.prod(others(label, node) - mu).real)


def _pairs(label: str) -> Test:
    """Return the product over pairs of the other multipliers that is zero where the pair's product is one."""

    def test(motions: PeriodicMotions, node: Node) -> float:
        products = [a * b - 1 for a, b in itertools.combinations(others(label, node), 2)]
        return float(np.prod(products).real)

    return test


def _double(motions: PeriodicMotions, node: Node) -> float:
    """Return the product of both null vectors, which are orthogonal where the multiplier is double."""
    left, right = node.null_vectors  # type: ignore[misc]
    return float(np.vdot(left, right).real)


def _own(label: str) -> Test:
    """Return the coefficient of the curve's own normal form that decides on which side the other motions are."""

    def test(motions: PeriodicMotions, node: Node) -> float:
        form = NormalForm(motions, node.z, np.asarray(node.matrices), critical(label, node)[:1])
        number, *_ = FORMS[label].coefficients(form).values()
        if label == "NS":
            return float(number.real)
        # the null vectors are continuous along the curve, and their product removes the pole at a double multiplier
        turn = form.right[0] @ np.asarray(node.null_vectors[1]) if label == "LP" else 1.0  # type: ignore[index]
        return float((number * turn).real) * _double(motions, node)

    return test


def _angle(label: str) -> Test:
    (mu,) = FORMS[label].critical
    return lambda motions, node: float(node.z[-1] - np.angle(mu))  # type: ignore[arg-type]


TESTS: dict[str, dict[str, Test]] = {
    "LP": {"CP": _own("LP"), "R1": _double, "LPPD": _beside("LP", -1.0), "LPNS": _pairs("LP")},
    "PD": {"GPD": _own("PD"), "R2": _double, "LPPD": _beside("PD", 1.0), "PDNS": _pairs("PD")},
    "NS": {
        "CH": _own("NS"),
        "R3": _angle("R3"),
        "R4": _angle("R4"),
        "LPNS": _beside("NS", 1.0),
        "PDNS": _beside("NS", -1.0),
        "NSNS": _pairs("NS"),
    },
}
"""Test functions of the points on each kind of curve."""
OWN = "CP", "GPD", "CH"
"""Points where a coefficient of the curve's own normal form vanishes."""


class PointSearch(EventSearch):
    """Search for points of codimension two between two points of a curve of `CriticalMotions`."""

    # second derivatives of the map may be rough
    smooth = False

    def between(self, a: Node, b: Node) -> list[Event]:
        """Return the located points in the step of a curve from a to b, in their order."""
        equations = self.equations.update(a.z, a.null_vectors)
        search = self._replace(equations=equations)
        motions = equations.motions  # type: ignore[attr-defined]
        found = []
        for name, test in TESTS[equations.label].items():  # type: ignore[attr-defined]
            if name in OWN and FORMS[name].order > motions.derivatives:
                continue
            value = lambda node, test=test: test(motions, node)
            if value(a) * value(b) < 0 and (event := search.point(name, value, a, b)) is not None:
                found.append(event)
        chord = a.weights**2 * (b.z - a.z)
        return sorted(found, key=lambda event: chord @ event.node.z)

    def point(self, name: str, test: Callable[[Node], float], a: Node, b: Node) -> Event | None:
        """Return the point at which a test function is zero; None at a pole, or where no pair is complex."""
        low, high, nearest, width = self.narrowed(test, a, b)
        ends = [abs(test(node)) for node in (a, b)]
        if not abs(test(nearest)) <= ZERO * min(ends):
            return None
        if name.endswith("NS"):
            rest = nearest.multipliers[nearest.multipliers.imag > 0]
            count = FORMS[name].critical.count(None)
            if np.sum(np.abs(np.abs(rest) - 1) < ON_CIRCLE) < count:
                return None
        return described(self.equations, name, nearest, width <= 4 * BRACKET, low, high)


def described(equations, name: str, node: Node, converged: bool, *around: Node) -> Event:
    """Return the event of a point, with the coefficients of its normal form, or the reason why it has none."""
    places = tuple(parameter_places(equations, node.z.size).values())
    ends = [float(one.z[places[-1]]) for one in (*around, node)]
    motions = equations.motions
    note = ""
    coefficients = {}
    if FORMS[name].order > motions.derivatives:
        note = f"no coefficients: they need {FORMS[name].order} derivatives, but the map has {motions.derivatives}"
    else:
        coefficients = normal_form(motions, motions.state(node.z), motions.values(node.z), name)
    mu = complex(equations.multiplier(node.z))
    named = node._replace(label=name)
    return Event(name, named, min(ends), max(ends), converged, mu, note, (), places, coefficients)


def resonant_end(equations, node: Node, tolerance: float) -> Event:
    """Return the strong resonance 1:1 or 1:2 just behind the end of a curve of Neimark-Sackers.

    State and parameters are even functions of the distance of the angle from the resonance. Their tangent at the end
    gives them at the resonance with an error of fourth order in this distance.
    """
    own = equations.update(node.z, node.null_vectors)
    end = correct(own, node.z, node.row, tolerance=1e-3 * tolerance)
    angle = np.pi * round(float(node.z[-1]) / np.pi)
    z = end.z + end.tangent / end.tangent[-1] * (angle - end.z[-1]) / 2
    z[-1] = angle
    # Newton's method does not converge at the resonance itself
    there = correct(own, z, node.row, tolerance=tolerance, iterations=0)
    name = "R1" if np.cos(angle) > 0 else "R2"
    return described(equations, name, observed(there._replace(tangent=node.tangent), None), True)
