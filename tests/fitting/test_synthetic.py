"""Records of the model's own runs."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.fitting import Trajectories, synthetic_record, trajectories
from slipperjax.fitting.search import Chain, search

SCENE = sj.paper_scene()
RATE = 100 / float(SCENE.period)
AZ = [sj.model.Sensor("az")]
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def run():
    return sj.simulate(SCENE, 4, steps_per_period=100, saves_per_period=100)


def test_records_are_what_sensors_read_in_the_last_periods(run):
    expected = run.reactions.acceleration[:400, 1]
    for periods, first in ((None, 0), (1, 300)):
        clean = synthetic_record(run, AZ, rate=RATE, periods=periods)["az"]
        np.testing.assert_allclose(clean, expected[first:], rtol=1e-6, atol=1e-6 * np.abs(expected).max())
        assert clean.attrs["units"] == "m/s^2"


def test_noise_is_that_of_the_sensor_or_a_share_of_its_signal(run):
    clean, noisy = (synthetic_record(run, AZ, rate=20e3, noise=noise) for noise in (0.0, 0.1))
    np.testing.assert_allclose((noisy - clean)["az"].std(), 0.1 * clean["az"].std(), rtol=0.15)
    gauge = [sj.model.Sensor("z", "displacement", noise=1e-5)]
    one, other = (synthetic_record(run, gauge, rate=20e3, seed=seed)["z"] for seed in (0, 1))
    # two of 500 deviates each
    np.testing.assert_allclose((one - other).std(), np.sqrt(2) * 1e-5, rtol=0.15)


def test_starts_that_are_all_lost_are_an_error(run, monkeypatch):
    nowhere = Chain.of(np.full((2, 1, 20, 22), np.nan), np.zeros((2, 1, 2)))
    lost = lambda evaluate, points, shown, **how: search(lambda points, index: nowhere, points)
    monkeypatch.setattr(trajectories, "search", lost)
    measured = synthetic_record(run, AZ, rate=5000.0)
    with pytest.raises(ValueError, match="all starts are lost: raise steps_per_period"):
        sj.fit(SCENE, measured, {"stiffness": (3e7, 3e8)}, AZ, method=Trajectories(2, transient=1))
