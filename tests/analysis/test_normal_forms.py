"""Normal forms: published and exact coefficients, and maps that are normal forms in other coordinates."""

import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.normal_forms import normal_form
from slipperjax.analysis.shooting import PeriodicMotions

from .systems import LOGISTIC, Companion, Generalised, delayed

HENON = [
    # label, R, S, y, determinant, coefficients by MatContM's formulas in NumPy
    ("LP", 0.0, 0.0, -0.35, -0.3, {"a": -0.543928293220421}),
    ("PD", 0.0, 0.0, 0.35, -0.3, {"b": 0.549450549450549}),
    ("NS", 0.1, 0.0, 0.8, 1.0, {"d": 0.00639204545454545, "theta": 2.43410944181045}),
    ("R1", 0.1, 0.0, -20 / 19, 1.0, {"s": 1.0}),
    ("R2", 0.1, 0.0, 20 / 19, 1.0, {"4c": -1.1, "-2d-6c": 0.0225}),
    ("R3", 0.1, 0.0, 10 / 19, 1.0, {"Re c1": 1 / 74}),
    ("R4", 0.1, 0.0, 0.0, 1.0, {"A": 0.0425961833636 - 0.799861665384j}),
    ("LPPD", 0.1, 0.0, 0.0, -1.0, {"a": 0.45, "b": 0.275}),
    ("CH", 0.1, 0.2, 1.5, 1.0, {"d": 0.0, "theta": 2.418858405776}),
    ("NS", 0.1, 0.2, 1.45, 1.0, {"d": 2.1468441e-4}),
    ("R3", 0.1, 0.2, 2 / 3, 1.0, {"Re c1": 0.0193798449612}),
    ("R2", -0.1, 0.1, 1.13709218687, 1.0, {"4c": -0.568225531212, "-2d-6c": -0.0189718085984}),
    ("LPPD", -0.1, 0.1, 7.0, -1.0, {"a": 0.4545454545, "b": 0.33}),
]


def of_plane(family, size=2):
    """Motions over two parameters."""
    return PeriodicMotions(family, jnp.zeros(size), jnp.ones(2))


@pytest.mark.full
def test_coefficients_of_the_generalised_henon_map():
    for label, r, s, y, determinant, exact in HENON:
        family = Generalised(jnp.asarray(r), jnp.asarray(s))
        found = normal_form(of_plane(family), jnp.full(2, y), family.at(y, determinant), label)
        for name, value in exact.items():
            # of a Neimark-Sacker only the real part is in the table
            ours = found[name].real if name == "d" else found[name]
            # measured: 2e-12 with the digits of the last row's y, where it is rounded; 4e-13 elsewhere
            assert abs(ours - value) < 1e-10, (label, r, s, name)


@pytest.mark.full
def test_coefficients_of_maps_of_one_number_and_of_the_delayed_logistic_map():
    ricker = lambda a: lambda x, k: a * x * jnp.exp(-x)
    flip = lambda family, x, at: normal_form(PeriodicMotions(family, jnp.zeros(1), 1.0), jnp.array([x]), at, "PD")
    assert flip(ricker, 2.0, np.e**2)["b"] == pytest.approx(1 / 6, abs=1e-13)  # measured: 6e-17
    assert flip(LOGISTIC, 2 / 3, 3.0)["b"] == pytest.approx(9, abs=1e-12)  # measured: 2e-15
    cubic = lambda a, b: lambda x, k: a + b * x - x**2 - x**3 / 4
    found = normal_form(of_plane(cubic, 1), jnp.array([-2 / 3]), (-44 / 27, -2.0), "GPD")
    assert found["e"] == pytest.approx(-1 / 8, abs=1e-12)  # measured: 3e-17
    found = normal_form(of_plane(delayed), jnp.full(2, 0.5), (2.0, 0.0), "NS")
    assert found["theta"] == pytest.approx(np.pi / 3, abs=1e-12)  # measured: 2e-16
    assert found["d"] == pytest.approx(-1 - 1j * np.sqrt(3), abs=1e-12)  # measured: 9e-16


@pytest.mark.full
def test_a_fold_and_flip_decides_about_the_neimark_sackers_that_begin_there():
    """The second iterate's Neimark-Sackers near the fold and flip of (R, S) = (0.1, 0) have a positive first
    coefficient, so that cNS is positive; with the sign of two vectors in MatContM's file it would be -0.15871875."""
    family = Generalised(jnp.asarray(0.1), jnp.asarray(0.0))
    at_point = normal_form(of_plane(family), jnp.zeros(2), (0.0, -1.0), "LPPD")
    assert at_point["cNS"] == pytest.approx(0.03103125, abs=1e-12)  # measured: 2e-16
    # the motion u, v, u, ... has the sum 1 + b, and a product of determinants of one
    total = -1e-5
    product = total * (1.9 - 0.9 * total) * 100
    u, v = total / 2 + np.sqrt(total**2 / 4 - product) * np.array([1, -1])
    b = total - 1
    a = (total + b * total + u * u + v * v - 0.2 * u * v) / 2
    doubled = PeriodicMotions(family, jnp.zeros(2), jnp.ones(2), intervals=2)
    assert normal_form(doubled, jnp.array([u, v]), (a, b), "NS")["d"].real > 1e-3  # measured: 1.07e-3


def turned(angle, u, v):
    return jnp.cos(angle) * u - jnp.sin(angle) * v, jnp.sin(angle) * u + jnp.cos(angle) * v


class Bent:
    """A map in the coordinates of a polynomial change whose linear part is one: its normal form is the same."""

    def __init__(self, core, size):
        self.core, self.size = core, size

    def bend(self, x, sign):
        """Add squares of later components to each component, or take them away."""
        out = list(x)
        order = range(self.size - 1) if sign > 0 else range(self.size - 2, -1, -1)
        for k in order:
            later = [(j + 1.3) * out[i] * out[j] for i in range(k + 1, self.size) for j in range(i, self.size)]
            out[k] = out[k] + sign * 0.3 * sum(later) + sign * 0.2 * out[-1] ** 3
        return jnp.stack(out)

    def __call__(self, a, b):
        return lambda x, k: self.bend(self.core(self.bend(x, -1)), 1)


@pytest.mark.full
def test_normal_forms_in_other_coordinates():
    """Eigenvectors of length one halve the square of a complex coordinate's modulus."""

    def flip_and_turn(x):
        w, u, v = x
        square = u**2 + v**2
        u, v = turned(1.9, u * (1 - 0.3 * w**2 + 0.7 * square), v * (1 - 0.3 * w**2 + 0.7 * square))
        return jnp.stack([-w * (1 + 0.4 * w**2 - 0.6 * square), u, v])

    found = normal_form(of_plane(Bent(flip_and_turn, 3), 3), jnp.zeros(3), (0.0, 0.0), "PDNS")
    exact = {"a": 0.4, "b": -1.2, "c": -0.3, "d": 1.4}
    assert found == pytest.approx(exact, abs=1e-10)  # measured: 4e-15

    def two_turns(x):
        first, second = x[0] ** 2 + x[1] ** 2, x[2] ** 2 + x[3] ** 2
        one = turned(0.7, *(x[:2] * (1 + 0.4 * first - 0.6 * second)))
        other = turned(1.9, *(x[2:] * (1 - 0.3 * first + 0.7 * second)))
        return jnp.stack([*one, *other])

    found = normal_form(of_plane(Bent(two_turns, 4), 4), jnp.zeros(4), (0.0, 0.0), "NSNS")
    # which pair is the first is not determined, because both lie on the circle
    exact = [0.8, -1.2, -0.6, 1.4]
    ours = [found[name] for name in "abcd"]
    assert min(np.abs(np.subtract(ours, exact)).max(), np.abs(np.subtract(ours, exact[::-1])).max()) < 1e-10

    def quintic(x):
        square = x[0] ** 2 + x[1] ** 2
        growth = 1 - 0.3 * square**2
        shift = 1.9 + 0.5 * square
        return jnp.stack(turned(shift, *(x * growth)))

    found = normal_form(of_plane(Bent(quintic, 2), 2), jnp.zeros(2), (0.0, 0.0), "CH")
    assert found["d"] == pytest.approx(1j, abs=1e-10)  # measured: 6e-16
    assert found["e"].real == pytest.approx(-1.2, abs=1e-10)  # measured: 2e-15


@pytest.mark.full
def test_a_fold_with_a_neimark_sacker():
    """x' = x + x^2 + z conj(z), z' = exp(i theta) z (1 + 0.3 x) in other coordinates."""

    def core(x):
        w, u, v = x
        u, v = turned(1.9, u * (1 + 0.3 * w), v * (1 + 0.3 * w))
        return jnp.stack([w + w**2 + 0.5 * (x[1] ** 2 + x[2] ** 2), u, v])

    found = normal_form(of_plane(Bent(core, 3), 3), jnp.zeros(3), (0.0, 0.0), "LPNS")
    exact = {"f200": 1.0, "f011": 1.0, "g110": 0.3, "s": 1.0}
    assert {name: found[name] for name in exact} == pytest.approx(exact, abs=1e-10)  # measured: 1e-15


def test_what_cannot_be_computed_is_refused():
    family, _ = Companion.of([0.5, 0.2], 0.1)
    rough = PeriodicMotions(family, jnp.zeros(2), jnp.ones(2), derivatives=2)
    with pytest.raises(ValueError, match="`label` must need at most derivatives of order 2, which are all"):
        normal_form(rough, jnp.zeros(2), (0.0, 0.0), "PD")
    with pytest.raises(ValueError, match=r"`label` must be one of LP, PD, .* but is 'BP'"):
        normal_form(rough, jnp.zeros(2), (0.0, 0.0), "BP")
