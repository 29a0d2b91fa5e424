"""Designs that are best, against orbits, brute force and what a gradient leaves."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.checks import event_margins, surroundings
from slipperjax.design.judge import judge_on_orbits
from slipperjax.design.optimise import optimise_design

STEPS = 50
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def small():
    """The clearance with the least peak force at two speeds."""
    options = dict(over={"speed": [1250.0, 1500.0]}, starts=2, max_trials=12, steps_per_period=STEPS)
    return optimise_design(sj.paper_scene(), "peak_force", {"clearance": (0.5e-3, 1.5e-3)}, **options)


def test_less_play_means_lower_peaks_in_the_worst_orbit(small):
    assert small.status == "converged"
    assert small.design["clearance"] == pytest.approx(0.5e-3, rel=1e-9)
    assert small.regime.tolist() == ["period 1", "period 1"]
    np.testing.assert_allclose(small.starts["end"].values[:, 0], 0.5e-3, rtol=1e-9)  # from both starts
    assert not small.has_equal_optima
    assert small.at_bounds == {"clearance": "lower"}
    assert 0 < small.stderr < 1e-3 * small.objective  # measured 2e-5 of it, by the steps
    assert "best design: clearance 0.5 mm (its lower bound)" in repr(small)
    assert "motions: 2 x period 1" in repr(small)
    orbit = sj.periodic_orbit(small.scene.replace(speed=1500.0), steps_per_period=STEPS)
    assert small.objective == pytest.approx(float(orbit.trajectory().peak.force), rel=1e-7)
    assert small.smooth < small.objective == float(small.cases["objective"].max())
    assert float(small.cases["multiplier"][1]) == pytest.approx(float(abs(orbit.multipliers[0])), rel=1e-7)


def test_derivatives_are_those_of_orbits_found_anew(small):
    """Away from the optimum, of the peak and of its power mean, by the clearance."""
    at = lambda clearance: {"clearance": np.full(2, clearance), "speed": np.array([1250.0, 1500.0])}
    here = judge_on_orbits(small.problem, at(1e-3))
    near = [judge_on_orbits(small.problem, at(1e-3 + h), here).value for h in (-1e-8, 1e-8)]
    # measured 3e-8, the difference's own error
    np.testing.assert_allclose(here.gradient[:, :, 0], (near[1] - near[0]) / 2e-8, rtol=1e-6)


def test_the_history_is_that_of_the_search(small):
    ds = small.history
    for start in (0, 1):
        assert np.all(np.diff(ds["smooth"].values[(ds["start"].values == start) & ds["taken"].values]) < 0)
    check = small.cases["simulated"].values  # of the errors, with half the step
    assert small.cost_periods == ds["simulated"].values[-1] + check.sum() > ds["simulated"].values[-1]


@pytest.mark.slow
def test_brute_force_finds_nothing_better_nearby(small):
    ds = surroundings(small, points=5, width=0.2)
    assert ds.attrs["improvement_found"] < 1e-6
    own = ds["total"].sel(clearance=small.design["clearance"], method="nearest")
    assert float(own) == pytest.approx(small.smooth, rel=1e-3)  # measured 2e-7 after 300 periods


@pytest.mark.slow
def test_the_nearest_events_are_those_of_the_branch(small):
    ds = event_margins(small, ["clearance", "speed"], cases=[0], width=0.3)
    scene = small.scene.replace(speed=1250.0)
    branch = sj.continue_orbit(scene, "speed", (875.0, 1625.0), steps_per_period=2 * STEPS)
    far = np.array([event.value for event in branch.events if event.label in ("LP", "PD", "NS", "GR")]) - 1250.0
    met = ds.where((ds["parameter"] == "speed") & (ds["label"] != ""), drop=True)
    for change in met["change"].values:
        # the first one on its side
        assert abs(np.min(np.abs(far[far * change > 0])) - abs(change)) < 1e-3
    kept = dataclasses.replace(small, margins=ds).ds
    assert np.array_equal(kept["margin_relative"], ds["relative"])
