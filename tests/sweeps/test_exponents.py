"""Exponents of slippers over a grid, each with its certificate."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.analysis import largest_exponent
from slipperjax.flow import Status
from slipperjax.sweeps.votes import MOTIONS, Votes

SPEEDS = [1100.0, 1250.0, 1500.0, 1800.0, 2100.0, 2300.0]
STEPS = 50


def swept(**options):
    options |= dict(transient=300, steps_per_period=STEPS)
    return sj.lyapunov_sweep(sj.paper_scene(), {"speed": SPEEDS}, **options).isel(count=0)


def test_periodic_motions_contract_and_chaotic_ones_part():
    found = swept(periods=300, certify=False)
    calm, wild = found.sel(speed=slice(1000, 1900)), found.sel(speed=slice(2000, 2400))
    assert (calm["period"] == 1).all()
    assert (calm["weighted_exponent"] < -0.03).all()
    assert (wild["exponent"] > 5 * wild["stderr"]).all()
    assert not (wild["kind"] == "period").any()


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_certificates_of_a_short_run():
    """A periodic motion agrees with its multiplier, and every case says what it is and how it went."""
    grid = {"speed": [1250.0, 1e-3]}
    found = sj.lyapunov_sweep(sj.paper_scene(), grid, transient=200, periods=60, steps_per_period=STEPS)
    good, bad = found.isel(speed=0), found.isel(speed=1)
    assert bool(good["resolved"])
    assert str(good["regime"].values) == "periodic"
    assert int(good["status"]) == 0
    # measured: floquet -0.0465, half the step -0.0479, two trajectories equal to the tangent within 1e-6
    np.testing.assert_allclose(good["weighted_exponent"], good["floquet"], atol=1e-3)
    np.testing.assert_allclose(good["two_trajectories"], good["exponent"][0], atol=1e-5)
    np.testing.assert_allclose(good["half_step"], good["exponent"][0], atol=1e-3)
    assert int(bad["status"]) == 1  # hours in 50 steps: thrown out of the finite numbers
    assert not bool(bad["resolved"])
    assert str(bad["regime"].values) == "unresolved"
    assert str(bad["kind"].values) == "unresolved"


@pytest.fixture(scope="module")
def certified():
    return swept(periods=500)


@pytest.mark.slow
def test_periodic_motions_have_the_exponents_of_their_multipliers(certified):
    calm = certified.sel(speed=slice(1000, 1900))
    np.testing.assert_allclose(calm["weighted_exponent"], calm["floquet"], atol=1e-3)
    assert certified["resolved"].all()


def test_multipliers_of_several_periods():
    first, second = np.diag([2.0, 0.1]), np.array([[0.0, 1.0], [0.5, 0.0]])
    assert largest_exponent([first, second, 9 * first], 1) == pytest.approx(np.log(2))
    assert largest_exponent([first, second, 9 * first], 2) == pytest.approx(np.log(np.sqrt(0.1)) / 2)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="Argument `count` must be a whole number of 1 or more, but is 0"):
        sj.lyapunov_sweep(sj.paper_scene(), {"speed": [1250.0]}, count=0)
    with pytest.raises(ValueError, match="Argument `count` must be at most"):
        sj.lyapunov_spectrum(sj.paper_scene(), 99, transient=0, periods=1)
    for count in (11, 99):
        with pytest.raises(
            ValueError, match=f"`count` must be at most 10, the dimension of the motion, but is {count}"
        ):
            sj.lyapunov_sweep(sj.paper_scene(), {"speed": [1250.0]}, count=count)
    smooth = sj.paper_scene(memory=sj.SmoothSwitch())
    with pytest.raises(ValueError, match="`count` must be at most 30"):
        sj.lyapunov_spectrum(smooth, 31)


@pytest.mark.parametrize("finished", [0, 1])
def test_an_interrupt_during_the_longer_motions_keeps_what_was_measured(monkeypatch, finished):
    def take_votes(plan, cases, chosen, states, epoch, blocks, count, *rest):
        if not finished:
            raise sj.Interrupted(None, 0, 8)
        history = np.full((len(chosen), MOTIONS, 40, count), 0.5)
        return Votes(history, np.zeros(len(chosen), int), np.array([0, int(Status.NOT_RUN)])), True

    monkeypatch.setattr("slipperjax.sweeps.exponents.take_votes", take_votes)
    grid = {"speed": [2100.0, 1250.0, 2100.0]}
    with pytest.raises(sj.Interrupted) as stop:
        sj.lyapunov_sweep(sj.paper_scene(), grid, transient=200, periods=60, steps_per_period=STEPS)
    found = stop.value.dataset
    assert (stop.value.finished, stop.value.cases) == (1 + finished, 3)
    assert found["status"].values.tolist() == [0 if finished else 7, 0, 7]
    assert np.all(np.isfinite(found["exponent"]))
    assert (float(found["exponent"][0, 0]) == 0.5) == bool(finished)
    assert str(found["regime"].values[2]) == "unresolved"
    assert not bool(found["resolved"].values[2])
