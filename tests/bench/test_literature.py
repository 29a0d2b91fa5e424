"""Numbers that others published."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from ..benchmarks.literature import SYSTEMS, Number, main, numbers, rows


def number(published, ours, error=0.0, note=""):
    return Number("a system", "a number", published, ours, error, "a source", note)


def test_published_digits_say_what_agrees():
    for published, low, high in (
        ("3.4495", 3.4494, 3.4496),
        ("1.057390e-1", 0.1057389, 0.1057391),
        ("-14", -15, -13),
        ("0.42 to 0.44", 0.42, 0.44),
        ("-8.38 ± 4e-3", -8.384, -8.376),
    ):
        np.testing.assert_allclose(number(published, 0.0).bounds, (low, high), rtol=1e-12)
    assert number("0.906", 0.9049, 0.0).agrees is False
    assert number("0.906", 0.9049, 0.0005).agrees is True
    table = "\n".join(
        rows([number("0.906", 0.9, note="known to differ"), number("0.906", 0.8), number("0.906", 0.9062)])
    )
    assert "no: known to differ" in table
    assert "| NO |" in table
    assert "| 2.0e-04 | yes |" in table
    assert "| a system | 3 | 1 |" in table


@pytest.mark.full
def test_impacts_are_those_of_an_event_driven_code(capsys):
    main(["stop"])
    lines = capsys.readouterr().out
    assert "10 of 10 within the published digits and our errors" in lines
    assert lines.count("| yes |") == 10
    with pytest.raises(ValueError, match="must be one of parabola, stop"):
        main(["nosuch"])


@pytest.mark.slow
def test_all_numbers_agree_or_are_explained():
    found = list(numbers())
    print("\n".join(rows(found)))
    assert len(SYSTEMS) >= 8
    assert len(found) >= 80
    differ = [n for n in found if not n.agrees]
    # three: a mean of unknown length, twice, and the Hopf point
    assert [(n.system, bool(n.note)) for n in differ] == [("Duffing-Ueda", True)] * 2 + [("A -> B reaction", True)]


@pytest.mark.slow
def test_the_hopf_point_is_where_the_trace_vanishes():
    """AUTO's tutorial prints 0.1308998, ours is 0.13090004: an equation for it alone decides."""

    def equilibrium(u):
        """The parameter and the field's Jacobian where the first component rests at u."""
        second = 14 * u / 3
        p = u / ((1 - u) * np.exp(second))
        field = lambda s: jnp.stack(
            [p * (1 - s[0]) * jnp.exp(s[1]) - s[0], 14 * p * (1 - s[0]) * jnp.exp(s[1]) - 3 * s[1]]
        )
        return p, np.asarray(jax.jacfwd(field)(jnp.array([u, second])))

    p, _ = equilibrium(brentq(lambda u: np.trace(equilibrium(u)[1]), 0.85, 0.95, xtol=1e-14))
    (ours,) = [n for n in numbers(("reaction",)) if "Hopf" in n.quantity]
    assert abs(ours.ours - p) < 2e-9  # measured 5e-10
    assert abs(float(ours.published) - p) > 1e-7
