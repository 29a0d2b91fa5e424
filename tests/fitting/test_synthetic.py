"""Records of the model's own runs."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.fitting import Trajectories, synthetic_record, trajectories
from slipperjax.fitting.search import Chain, search

SCENE = sj.paper_scene()
SENSORS = [sj.model.Sensor("az"), sj.model.Sensor("z", "displacement", noise=1e-5)]


@pytest.fixture(scope="module")
def run():
    return sj.simulate(SCENE, 4, steps_per_period=100, saves_per_period=100)


@pytest.mark.full
def test_records_are_what_sensors_read(run):
    clean = synthetic_record(run, SENSORS[:1], rate=100 / float(SCENE.period))
    expected = run.reactions.acceleration[:400, 1]
    np.testing.assert_allclose(clean["az"], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    assert clean["az"].attrs["units"] == "m/s^2"


@pytest.mark.full
def test_noise_is_that_of_the_sensor_or_a_share_of_its_signal(run):
    clean, noisy = (synthetic_record(run, SENSORS[:1], rate=20e3, noise=noise) for noise in (0.0, 0.1))
    np.testing.assert_allclose((noisy - clean)["az"].std(), 0.1 * clean["az"].std(), rtol=0.15)
    one, other = (synthetic_record(run, SENSORS[1:], rate=20e3, seed=seed)["z"] for seed in (0, 1))
    # two of 500 deviates each
    np.testing.assert_allclose((one - other).std(), np.sqrt(2) * 1e-5, rtol=0.15)


@pytest.mark.full
def test_the_last_periods_count(run):
    period = float(SCENE.period)
    last = synthetic_record(run, SENSORS[:1], rate=100 / period, periods=1)
    whole = synthetic_record(run, SENSORS[:1], rate=100 / period)
    np.testing.assert_allclose(last["az"], whole["az"][300:], rtol=1e-6, atol=1e-6)


@pytest.mark.full
def test_starts_that_are_all_lost_are_an_error(run, monkeypatch):
    nowhere = Chain.of(np.full((2, 1, 20, 22), np.nan), np.zeros((2, 1, 2)))
    lost = lambda evaluate, points, shown, rough=0.0: search(lambda points, index: nowhere, points)
    monkeypatch.setattr(trajectories, "search", lost)
    measured = synthetic_record(run, SENSORS[:1], rate=5000.0)
    with pytest.raises(ValueError, match="all starts are lost: raise steps_per_period"):
        sj.fit(SCENE, measured, {"stiffness": (3e7, 3e8)}, SENSORS[:1], method=Trajectories(2, transient=1))
