"""Estimates of sweeps, and points spread over a box."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import slipperjax as sj
from slipperjax.sweeps.estimate import Estimate
from slipperjax.sweeps.grid import Tiling

from .made_up import a_grid, made_up

SCENE = sj.paper_scene()


def test_an_estimate_measures(tmp_path, monkeypatch):
    monkeypatch.setenv("PAUSE", "0.1")
    store = sj.sweeps.Store(tmp_path / "map.zarr", tile=10)
    found = sj.explain(made_up, SCENE, a_grid(), store=store, workers=4, steps_per_period=100)
    # a tenth of a second for the 128 cases of the probe
    assert 0.1 / 128 <= found.per_case < 0.5 / 128
    assert found.seconds == pytest.approx(120 * found.per_case / 4)
    # a tile is a task: 64 workers have 12 tiles of 10 cases
    assert dataclasses.replace(found, workers=64).seconds == pytest.approx(10 * found.per_case)
    for words in ("120 cases in 12 tiles of 10 (1 x 10)", "steps per period: 100 to 100", "on 4 cores", " free"):
        assert words in str(found)
    assert not store.path.exists()
    monkeypatch.delenv("PAUSE")
    # what a store of it takes, within the factor that compressing few cases at a time costs
    made_up(SCENE, a_grid(), store=store, steps_per_period=100)
    size = sum(file.stat().st_size for file in store.path.rglob("c/**/*") if file.is_file())
    assert found.stored < size < 8 * found.stored


def test_only_functions_of_a_grid_are_explained():
    with pytest.raises(ValueError, match="`function` must be a function of a grid, such as"):
        sj.explain(sj.compare, SCENE, {"speed": [1000.0]}, length=8.0)


def test_a_run_from_standstill_has_steps_of_its_own(monkeypatch):
    asked = []

    def runs(scene, grid, **options):
        asked.append(options)
        return sj.Result(xr.Dataset({"steps_per_window": (("case", "distance"), [[4000, 40]] * 128)}))

    monkeypatch.setattr("slipperjax.sweeps.explain.run", runs)
    # half a second at a standstill, for which a wavelength would take endless steps
    fast = sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0)], start=0.0)
    found = sj.explain(runs, SCENE, {"speed.scale": [0.9, 1.0]}, speed=fast, length=40.0, refine=2)
    assert "steps per window: 40 to 4000" in str(found)
    assert all("steps_per_period" not in options and options["refine"] == 2 for options in asked)


MILLION = {"speed": np.linspace(1e3, 2e3, 10**4), "clearance": np.linspace(1e-3, 2e-3, 10**4)}
TWO = {"speed": [1e3, 2e3]}


YEARS = {
    "cases of .* need about": [
        lambda s, at: sj.sweep(s, MILLION, periods=10**6, record="peak_force", store=at),
        lambda s, at: sj.lyapunov_sweep(s, MILLION, periods=10**6, store=at),
    ],
    "need about .* more than a year": [lambda s, at: sj.sweep(s, TWO, record="strobe", transient=10**14)],
    "need about .*B of memory": [
        lambda s, at: sj.follow(s, TWO, transient=10**12),
        lambda s, at: sj.period_map(s, sj.initial_state(s), periods=10**12),
    ],
    "1000000000000 points need about 8 TB": [lambda s, at: sj.sweeps.sample_box({"speed": (1e3, 2e3)}, 10**12)],
    "10000000002.. forcing periods of 40 steps need about": [lambda s, at: sj.lyapunov_spectrum(s, periods=10**12)],
    "`refine` must be at most": [lambda s, at: sj.sweep(s, TWO, refine=10**9)],
    "`period` must be at most": [
        lambda s, at: sj.periodic_orbit(s, 10**9),
        lambda s, at: sj.orbit_sweep(s, TWO, period=10**9),
    ],
    "`steps_per_period` must be at most": [
        lambda s, at: sj.simulate(s, 60, steps_per_period=10**9),
        lambda s, at: sj.sweep(s, TWO, steps_per_period=10**9, store=at),
        lambda s, at: sj.follow(s, TWO, steps_per_period=10**9),
        lambda s, at: sj.run(s, length=100.0, steps_per_period=10**9),
        lambda s, at: sj.lyapunov_spectrum(s, steps_per_period=10**9),
        lambda s, at: sj.continue_orbit(s, "speed", (9e2, 2e3), steps_per_period=10**9),
    ],
}


@pytest.mark.parametrize("words", YEARS)
def test_what_would_take_years_is_refused_before_it_is_begun(tmp_path, words):
    for call in YEARS[words]:
        with pytest.raises(ValueError, match=words):
            call(SCENE, tmp_path / "map.zarr")
    assert not list(tmp_path.iterdir())


def test_a_store_that_others_compute_too_may_take_years():
    options = dict(cases=10**8, per_case=20.0, bytes_per_case=8.0, tiles=Tiling.of((10**8,)), workers=2)
    with pytest.raises(ValueError, match=r"100000000 cases need about .+ years, which is more than a year"):
        Estimate(**options).check()
    Estimate(shared=True, **options).check()


def test_points_are_spread_over_a_box():
    box = {"speed": (500.0, 2000.0), "clearance": (0.3e-3, 3e-3), "section.play.2": (1e-4, 1e-3)}
    found, again = (sj.sweeps.sample_box(box, 64, log=["clearance"], seed=3) for _ in range(2))
    for name, (low, high) in box.items():
        assert found[name].shape == (64,)
        assert np.all((found[name] >= low) & (found[name] < high))
        np.testing.assert_array_equal(found[name], again[name])
    # 64 points that fill a box evenly
    halves = np.sum(found["clearance"] < np.sqrt(0.3e-3 * 3e-3)), np.sum(found["speed"] < 1250)
    assert np.allclose(halves, 32, atol=1)
    assert len(sj.sweeps.sample_box(box, 100)["speed"]) == 100


def test_points_are_spread_by_distributions():
    """Moments and bounds of 1024 points."""
    scene = dataclasses.replace(sj.paper_scene(), track=sj.RandomTrack.sled(length=200.0))
    box = {
        "clearance": stats.norm(1e-3, 5e-5),
        "section.play.2": stats.truncnorm(-1.0, 2.0, loc=1e-4, scale=1e-4),
        "restitution": stats.triang(0.5, loc=0.8, scale=0.2),
        "stiffness": stats.lognorm(0.3, scale=1e8),
        "track.seed": stats.randint(0, 64),
        "mass": stats.rv_histogram(np.histogram([13.0, 14.0, 14.0, 16.0], bins=3)),
        "speed": (500.0, 2000.0),
    }
    found = sj.sweeps.sample_box(box, 1024, seed=3, scene=scene)
    for name, of in (box | {"speed": stats.uniform(500.0, 1500.0)}).items():
        values = found[name]
        low, high = of.support()
        assert np.all((values >= low) & (values <= high))
        assert abs(values.mean() - of.mean()) < 0.02 * of.std()  # measured 0.009
        assert abs(values.std() / of.std() - 1) < 0.02
    assert len(np.unique(found["track.seed"])) == 64
    other = sj.sweeps.sample_box(box, 1024, seed=4, scene=scene)
    assert np.all(other["clearance"] != found["clearance"])


def test_a_share_of_zero_has_a_value(monkeypatch):
    zeros = lambda dimensions, rng: SimpleNamespace(random=lambda count: np.zeros((count, dimensions)))
    monkeypatch.setattr(stats.qmc, "Sobol", zeros)
    found = sj.sweeps.sample_box({"start_y": stats.norm(0, 1e-4), "mass": stats.randint(10, 20)}, 4)
    assert np.all((found["start_y"] > -1e-3) & (found["start_y"] < -5e-4))
    assert np.all(found["mass"] == 10)


def test_wrong_boxes_are_named():
    for box, more, words in (
        ({}, {}, "`box` must name one or more"),
        ({"spede": (1.0, 2.0)}, {}, "spede"),
        ({"speed": (1e3, 2e3, 3e3)}, {}, "lower and the higher bound of speed"),
        ({"speed": (1e3, 2e3)}, dict(log=["mass"]), "`log` must name parameters of `box`, but is 'mass'"),
        ({"start_y": (-1e-3, 1e-3)}, dict(log=["start_y"]), "`log` must name parameters above zero"),
        ({"speed": 1e3}, {}, "bound of speed, or its distribution, but has 1000"),
        ({"speed": stats.norm(1e3, 10.0)}, dict(log=["speed"]), "with two bounds, but is speed, which has a distr"),
        ({"clearance": stats.norm(1e-4, 1e-3)}, {}, "`clearance` must be zero or positive, but is -0.000"),
        ({"stiffness": stats.lognorm}, {}, "`box` must have a distribution of stiffness with all its parameters: "),
        ({"speed": stats.norm(1e3, -1.0)}, {}, "`box` must have .* but has one without finite values"),
    ):
        with pytest.raises((ValueError, KeyError), match=words):
            sj.sweeps.sample_box(box, **({"count": 8} | more))
