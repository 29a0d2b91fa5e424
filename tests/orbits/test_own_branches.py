"""Branches of systems of one's own as results."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import slipperjax as sj
from slipperjax import analysis
from slipperjax.analysis.arclength import Node, Pace
from slipperjax.analysis.continuation import Branch, End
from slipperjax.analysis.events import Event
from slipperjax.analysis.grazing import GrazingMotions

from ..plots.shown import labels, legend

HENON = lambda a: lambda s, k: jnp.stack([a - s[0] ** 2 + 0.3 * s[1], s[0]])
"""Its fixed point x = (sqrt(0.49 + 4 a) - 0.7) / 2 flips at a = 0.3675."""


@pytest.fixture(scope="module")
def branch():
    motions = analysis.PeriodicMotions(HENON, jnp.zeros(2), 1.0)
    return analysis.continue_motion(motions, (jnp.full(2, 0.3), 0.25), (0.0, 0.6))


def test_a_branch_says_lists_draws_and_writes_itself(branch, tmp_path):
    found = sj.orbits.branch_result(branch, {"a": "m", "state_0": "m"})
    a, x = found["a"].values, found["state_0"].values
    np.testing.assert_allclose(x, (np.sqrt(0.49 + 4 * a) - 0.7) / 2, rtol=0, atol=1e-8)  # measured 3e-11
    assert found["stable"].values.tolist() == branch.stable.tolist()
    events = found.tables()["events"]
    assert events["label"].tolist() == ["EP", "PD", "EP"]
    assert events["value"][1] == pytest.approx(0.3675, abs=1e-8)
    assert [line.split()[0] for line in found.summary()[2:]] == ["EP", "PD", "EP"]
    ax = found.plot()
    assert labels(ax) == ("a [m]", "state 0 [m]")
    assert legend(ax) == ["stable", "unstable", "PD flip"]
    found.write(tmp_path / "henon.nc", tmp_path / "henon.csv", tmp_path / "henon.png")
    again = sj.load(tmp_path / "henon.nc")
    assert again.summary() == found.summary()
    table = pd.read_csv(tmp_path / "henon.csv")
    np.testing.assert_allclose(table["state_0"], x, rtol=1e-8)
    assert pd.read_csv(tmp_path / "henon_events.csv")["label"].tolist() == ["EP", "PD", "EP"]


def test_wrong_branches_are_one_line(branch):
    with pytest.raises(ValueError, match="`units` must name a and some of state_0, state_1, but is"):
        sj.orbits.branch_result(branch, {"b": "m"})


def test_a_curve_of_grazings_says_its_points_with_their_errors():
    # by hand, so that nothing is compiled
    motions = analysis.PeriodicMotions(lambda a, b: HENON(a), np.zeros(1), np.ones(2))
    nodes = []
    for a, label in ((1.0, ""), (2.0, "GRLP"), (3.0, "")):
        z = np.array([0.5, a, 10 * a, 0.0, 0.0])
        mu = np.array([0.9 + 0j])
        nodes.append(Node(z, z, z, 0.0, 0, None, None, mu, np.zeros(1), label=label))
    stderr = {"b": 0.02, "quadratic": 0.003}
    more = dict(places=(1, 2), coefficients={"quadratic": -1.5}, stderr=stderr)
    event = Event("GRLP", nodes[1], 20.0, 20.0, True, **more)
    ends = End("bound", 0.1), End("second touch", 0.1)
    found = sj.orbits.branch_result(Branch(GrazingMotions(motions), tuple(nodes), (event,), ends))
    head, point = found.summary()
    assert head == "GR of period 1 over a and b: 3 points, from (1, 10: bound) to (3, 30: second touch)"
    assert point == "  GRLP at (2, 20 +- 0.02): quadratic = -1.5 +- 0.003"
    ax = found.plot()
    assert [text.get_text() for text in ax.texts] == ["GRLP"]
    assert legend(ax) == ["GR grazing"]


@pytest.mark.full
def test_a_curve_over_two_parameters_lists_and_draws_its_points(tmp_path):
    family = lambda a, b: lambda s, k: jnp.stack([s[1], a - b * s[0] - s[1] ** 2 + 0.1 * s[0] * s[1]])
    motions = analysis.PeriodicMotions(family, jnp.zeros(2), jnp.ones(2))
    critical = analysis.CriticalMotions.of(motions, "NS")
    # on the curve y, b = 1 + y / 10, a = y (1 + b) + 9 y^2 / 10
    curve = analysis.continue_critical(
        critical, jnp.full(2, 0.8), (2.24, 1.08), ((-2.0, 4.0), (0.5, 1.5)), angle=2.4, pace=Pace(most=0.3)
    )
    found = sj.orbits.branch_result(curve)
    head, *lines = found.summary()
    assert head.startswith("NS of period 1 over a and b: ")
    assert [line.split()[0] for line in lines] == ["R1", "R4", "R3", "R2"]
    assert lines[-1].endswith("4c = -1.1, -2d-6c = 0.0225")
    assert not found["outside"].values.any()
    ax = found.plot()
    assert sorted(text.get_text() for text in ax.texts) == ["R1", "R2", "R3", "R4"]
    assert legend(ax) == ["NS Neimark-Sacker"]
    found.write(tmp_path / "curve.nc")
    assert sj.load(tmp_path / "curve.nc").summary() == found.summary()
