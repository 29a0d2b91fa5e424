"""Accelerations of places on sleds in closed form and by other ways, and environments over rails."""

import dataclasses
import warnings

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.analysis.environment import band_rms
from slipperjax.sweeps import AccelerationHistory
from slipperjax.sweeps.environment import DIRECTIONS, accelerations_at, histories_of
from slipperjax.sweeps.windows import BANDS

from ..common import sled_on
from ..fitting.test_telemetry import RATE, made

PLACE = (0.5, 0.2, 0.4)
KEPT = ["peak_force", "body_acceleration"]


def in_the_air(speed=100.0, **parts):
    """Gives a sled between straight rails that it never touches."""
    with warnings.catch_warnings():
        # 0.2 m is no clearance of a slipper
        warnings.simplefilter("ignore", sj.ImplausibleWarning)
        scene = sj.paper_scene(clearance=0.2)
    rails = sj.model.TwoRails(sj.model.StraightTrack(), sj.model.StraightTrack())
    body = sled_on(inertia=(150.0, 300.0, 300.0), **parts)
    return dataclasses.replace(scene, speed=speed, slipper=body, track=rails, gravity=0.0)


def at_place(ds, place=PLACE):
    """Gives the times of samples [s] and accelerations of a place [m/s^2], (directions, samples)."""
    histories, seconds, *_ = histories_of([ds])
    return seconds, accelerations_at(sj.load(ds).scene, histories, np.array([place]))[0, 0]


def first_of(rails):
    return sj.load(rails).sel(**{"track.seed": 0}).scene


@pytest.fixture(scope="module")
def rails():
    """Runs of a slipper at 400 m/s over three random rails, 100 m long."""
    track = sj.RandomTrack.sled(length=250.0)
    scene = dataclasses.replace(sj.paper_scene(speed=400.0), track=track, gravity=9.81)
    return sj.run(scene, {"track.seed": range(3)}, length=100.0, record=KEPT)


@pytest.mark.full
@pytest.mark.filterwarnings("ignore:Doubtful runs")  # nothing touches
def test_a_place_of_a_spinning_sled():
    """Of an axisymmetric body without moments, whose spin turns about its axis at a constant rate."""
    w_x, w_y, w_z = 0.5, 0.1, -0.3
    start = sj.Motion(w_x=w_x, w_y=w_y, w_z=w_z)
    ds = sj.run(in_the_air(), length=10.0, record=KEPT, start=start)
    seconds, found = at_place(ds)
    assert not ds["peak_force"].any()
    turn = (300.0 - 150.0) / 300.0 * w_x
    c, s = np.cos(turn * seconds), np.sin(turn * seconds)
    spin = np.stack([np.full_like(c, w_x), w_y * c + w_z * s, w_z * c - w_y * s], axis=-1)
    angular = turn * np.stack([np.zeros_like(c), spin[:, 2], -spin[:, 1]], axis=-1)
    wanted = np.cross(angular, PLACE) + np.cross(spin, np.cross(spin, PLACE))
    assert np.ptp(wanted, axis=0).min() > 1e-4
    # of 0.15 m/s^2: measured 1e-15
    np.testing.assert_allclose(found, wanted.T, rtol=0, atol=1e-12)


@pytest.mark.full
@pytest.mark.filterwarnings("ignore:Doubtful runs")
@pytest.mark.parametrize("speed", [100.0, sj.SpeedProgramme.stages([sj.Stage(100.0, speed=200.0)], start=80.0)])
def test_a_mode_rings_at_a_place(speed):
    """One mode in the air: -(2 pi f)^2 q times its shape at the place, at a constant and at a changing speed."""
    frequency, amplitude = 300.0, 1e-3
    shape = np.array([0.01, 0.03, 0.05])
    modes = sj.model.Modes([frequency], [0.0], np.zeros((1, 4, 3)), [PLACE], shape[None, None])
    start = sj.Motion(modes=sj.model.ModalMotion([amplitude], [0.0]))
    ds = sj.run(in_the_air(speed, modes=modes), length=60.0, record=KEPT, start=start, steps_per_period=1600)
    seconds, found = at_place(ds)
    omega = 2 * np.pi * frequency
    wanted = -(omega**2) * amplitude * np.cos(omega * seconds) * shape[:, None]
    peak = omega**2 * amplitude * shape
    # measured 7e-4, of what the solver makes of the frequency
    assert (abs(found - wanted).max(axis=1) < 3e-3 * peak).all(), abs(found - wanted).max(axis=1) / peak
    report = sj.environment(ds, places=[PLACE], low=75.0 * 2 ** (-1 / 12), high=1000.0)
    # measured 2e-4, 4e-5 and 4e-3
    np.testing.assert_allclose(report["rms"][0, 0], peak / np.sqrt(2), rtol=5e-3)
    np.testing.assert_allclose(report["band_rms"][0, 0], peak / np.sqrt(2), rtol=2e-2)
    band = report["density"][0, 0].argmax("frequency")
    assert ((report["low"][band] <= frequency) & (frequency <= report["high"][band])).all()
    # an edge of bands is its frequency; at resonance an oscillator has Q times as much
    shock = sj.environment(ds, places=[PLACE], low=75.0, high=1200.0)["shock_response"][0, 0]
    np.testing.assert_allclose(shock.max("natural_frequency") / peak, 10.0, rtol=0.05)


@pytest.mark.full
def test_bands_agree_with_the_third_octaves_of_the_run(rails):
    """Another filter and another estimate in the package, of the centre of mass at one speed."""
    duration = float(rails["seconds"][-1])
    fine = sj.run(first_of(rails), length=100.0, record=KEPT, refine=2)
    chosen = np.nonzero(np.isfinite(fine["band_a_z"].values[0]) & (BANDS > 30.0) & (BANDS < 1100.0))[0]
    low, high = BANDS[chosen[0]] * 10**-0.05, BANDS[chosen[-1]] * 10**0.05
    report = sj.environment(fine, places=[(0.0, 0.0, 0.0)], low=low, high=high, window=duration)
    for direction in ("y", "z"):
        wanted = np.linalg.norm(fine[f"band_a_{direction}"].values[0, chosen])
        # of the density, whose window has a taper as the bands have
        density = report["density"].sel(direction=direction).values
        found = band_rms(density, report["natural_frequency"].values).item()
        # measured 0.7 and 0.1 % apart
        assert found == pytest.approx(wanted, rel=0.03), direction


@pytest.mark.full
def test_environments_are_those_of_each_rail_alone(rails):
    settings = dict(places=[PLACE, (0.0, 0.0, 0.0)], high=800.0)
    report = sj.environment(rails, **settings)
    apart = [rails.isel({"track.seed": k}) for k in range(3)]
    alone = [sj.environment(one, **settings) for one in apart]
    assert report["density"].sizes == dict(rail=3, place=2, direction=3, frequency=report.sizes["frequency"])
    assert report["direction"].values.tolist() == list(DIRECTIONS)
    for name, of in (("density_envelope", "density"), ("shock_envelope", "shock_response")):
        each = np.concatenate([one[of].values for one in alone])
        np.testing.assert_allclose(report[of].values, each, rtol=1e-9)  # measured 0
        np.testing.assert_array_equal(report[name].sel(summary="maximum"), report[of].max("rail", skipna=False))
        np.testing.assert_allclose(report[name].sel(summary="mean"), each.mean(axis=0), rtol=1e-9)
    # runs one by one are the same rails
    np.testing.assert_array_equal(sj.environment(apart, **settings)["rms"], report["rms"])
    for name in ("scene", "speed [m/s]"):
        assert report.attrs[name] == rails.attrs[name]


@pytest.mark.full
def test_a_specification_lies_its_margin_above_the_greatest_density_of_all_rails(rails):
    report = sj.environment(rails, places=[PLACE], low=50.0, high=400.0, margin=3.0)
    for direction in ("y", "z"):
        of_one = report.sel(direction=direction).isel(place=0)
        most = of_one["maximax_density"].max("rail")
        known = np.isfinite(of_one["specification_frequency"].values)
        points = [of_one[f"specification_{name}"].values[known] for name in ("frequency", "density")]
        lines = np.exp(np.interp(np.log(most["frequency"]), *map(np.log, points)))
        ratio = 10 * np.log10(lines / most.values)
        assert ratio.min() == pytest.approx(3.0, abs=1e-6)
        assert of_one["specification_rms"] > of_one["maximax_rms"].max()
    table = report.tables()["specification"]
    assert list(table.columns[4:]) == ["frequency [Hz]", "density [g^2/Hz]", "g-RMS", "runs", "status"]
    assert set(table["runs"]) == {3}
    text = "straight-line specification, 3 dB above the greatest density of 3 runs"
    assert text in report["specification_density"].attrs["long_name"]
    assert report.summary()[-1].startswith("specification over 3 rails along ")


@pytest.mark.full
def test_lost_runs_are_left_out_and_so_may_be_windows_at_the_beginning(rails):
    whole = sj.environment(rails, [PLACE], high=800.0)
    lost = rails.assign(status=rails["status"].where(rails["track.seed"] != 1, int(sj.Status.DERAILED)))
    with pytest.warns(UserWarning, match=r"1 of 3 runs are lost, and left out"):
        report = sj.environment(lost, [PLACE], high=800.0)
    np.testing.assert_array_equal(report["rms"], whole["rms"][[0, 2]])
    part = sj.environment(rails.isel(distance=slice(40, None)), [PLACE], high=800.0)
    _, found = at_place(rails.isel({"track.seed": 0}))
    np.testing.assert_allclose(part["rms"][0, 0], found[:, 40 * 64 :].std(axis=1), rtol=1e-2)
    ends = [float(one["seconds"][-1] + one["seconds"][0]) for one in (part, whole)]
    assert ends[0] == pytest.approx(0.6 * ends[1], rel=1e-2)


def noise(rails, seconds):
    """Gives made-up runs at 100 m/s with noise along z."""
    return made(np.random.default_rng(1).normal(size=(rails, int(seconds * RATE))))


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (200.0, 202.0, r"200 to 202 Hz: bands need windows of 0\.5 s or more, but have 0\.1 s; give a longer run"),
        (1e4, 2e4, r"1e\+04 to 2e\+04 Hz: bands need 800 steps and samples a window or more"),
    ],
    ids=["short", "few steps"],
)
def test_without_a_known_density_no_specification_is_known(low, high, words):
    with pytest.warns(UserWarning, match=rf"No density is known from {words}"):
        report = sj.environment(noise(1, 0.1), [PLACE], low=low, high=high)
    assert np.isnan(report["density"]).all()
    assert np.isnan(report["specification_rms"]).all()
    lines = report.summary()
    assert lines[-1] == "no specification along x, y, z: fewer than two densities are known"
    assert report.tables()["specification"].empty
    # a direction in which nothing moves has none that is not zero
    known = sj.environment(noise(1, 0.1), [PLACE], low=200.0, high=1000.0)["specification_rms"]
    assert (known.sel(place=0, direction=["x", "y"]) == 0).all()
    assert known.sel(place=0, direction="z") > 0


def test_doubtful_runs_keep_their_mark(tmp_path):
    """In the result, its words, its tables and its page."""
    runs = noise(3, 0.1)
    runs["status"][:] = [sj.Status.FINITE, sj.Status.INACCURATE, sj.Status.DERAILED]
    said = "status of 1 of 2 runs: inaccurate"
    with pytest.warns(UserWarning, match="lost|Doubtful") as caught:
        report = sj.environment(runs, [PLACE], low=200.0, high=1000.0)
    first, second = (str(one.message) for one in caught)
    assert first == "1 of 3 runs are lost, and left out."
    assert second.startswith(f"Doubtful runs count: {said}")
    assert report["status"].dims == ("rail",)
    assert report["status"].values.tolist() == [sj.Status.FINITE, sj.Status.INACCURATE]
    assert report.summary()[0].startswith(said)
    assert {tuple(table["status"].unique()) for table in report.tables().values()} == {("finite, inaccurate",)}
    axes = sj.plots.vibration(report)
    assert said in axes[0, 0].figure.get_suptitle()
    report.write(tmp_path / "report.nc")
    assert sj.load(tmp_path / "report.nc").status.values.tolist() == [0, 6]


@pytest.mark.full
def test_densities_end_where_steps_are_too_far_apart(rails):
    """At 100 m/s by 20 steps a window or so: a quarter of their rate is below 2 kHz."""
    scene = dataclasses.replace(first_of(rails), speed=100.0)
    how = dict(length=60.0, record=KEPT)
    ds = sj.run(scene, steps_per_period=200, **how)
    steps = int(ds["steps_per_window"][0])
    with pytest.warns(UserWarning, match=r"Densities end at .* Hz: more need 80 steps and samples a window"):
        report = sj.environment(ds, [PLACE])
    known = np.isfinite(report["density"].values).all(axis=(0, 1, 2))
    assert known.tolist() == (report["high"].values <= 0.25 * 100.0 * steps).tolist()
    assert known.any()
    assert np.isfinite(report["shock_response"]).all()
    enough = sj.run(scene, steps_per_period=640, length=60.0, record=["peak_force", AccelerationHistory(80)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(sj.environment(enough, [PLACE])["density"]).all()


@pytest.mark.full
@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (lambda ds: [], {}, "`runs` must be one run or more"),
        (lambda ds: ds.drop_vars("body_acceleration"), {}, '`runs` must be .* with the record "body_acceleration"'),
        (lambda ds: ds.assign(status=ds["status"] * 0 + 2), {}, "`runs` must have one that is not lost"),
        (lambda ds: [ds, ds.assign_coords(seconds=2 * ds["seconds"])], {}, "`runs` must have the same speeds"),
        (lambda ds: [ds, ds.isel(sample=slice(32))], {}, "`runs` must have the same samples"),
        (lambda ds: ds, {"places": [(1.0, 2.0)]}, "`places` must have x, y and z"),
        (lambda ds: ds, {"low": 3000.0}, "`low` must be below"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*lost")
def test_wrong_inputs_are_one_line(rails, change, options, words):
    with pytest.raises(ValueError, match=words) as raised:
        sj.environment(change(rails), **{"places": [PLACE]} | options)
    assert "\n" not in str(raised.value)


@pytest.mark.full
def test_places_of_an_elastic_sled_are_those_of_its_modes():
    modes = sj.model.Modes([300.0], [0.0], np.zeros((1, 4, 3)), [PLACE], np.ones((1, 1, 3)))
    ds = sj.run(
        in_the_air(modes=modes), length=4.0, record=KEPT, start=sj.Motion(modes=sj.model.ModalMotion([0], [0]))
    )
    with pytest.raises(ValueError, match=r"`places` must be places of the modes, .* the nearest is 0.1 m away"):
        sj.environment(ds, [(0.5, 0.2, 0.5)])
