"""Runs over a length of rail: compared with sweeps of forcing periods, resumed, over programmes and rails."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.sweeps.runs import LEAST_STEPS_PER_WINDOW
from slipperjax.sweeps.windows import BANDS, SAMPLES_PER_WINDOW, STRETCH, ThirdOctaves

SCENE, STEPS, START = sj.paper_scene(), 50, sj.table_2_start()
RAIL = dataclasses.replace(
    SCENE, track=sj.RandomTrack.sled(length=400.0), gravity=9.81, friction=sj.model.Coulomb(0.1)
)
FAST = sj.SpeedProgramme.over_distance([0.0, 100.0, 200.0], [50.0, 800.0, 400.0])


@pytest.fixture(scope="module")
def steady():
    return sj.run(SCENE, length=64.0, window=8.0, steps_per_period=STEPS, probe=3, start=START)


@pytest.fixture(scope="module")
def runs():
    """Two rails, at a speed that changes sixteenfold."""
    return sj.run(RAIL, {"track.seed": [3.0, 4.0]}, length=210.0, speed=FAST)


@pytest.mark.full
def test_windows_of_a_wavelength_are_forcing_periods_to_the_last_bit(steady):
    names = ["peak_force", "contact_fraction", "impulse", "drive_force", "rms_a_z"]
    how = dict(transient=0, periods=8, steps_per_period=STEPS, record=[*names, "strobe"])
    ds = sj.sweep(SCENE, {"length": [0.2]}, **how).isel(length=0)
    np.testing.assert_array_equal(steady["peak_force"].max("distance"), ds["peak_force"])
    np.testing.assert_allclose(steady["impulse"].sum("distance"), ds["impulse"], rtol=1e-13)
    for name in ("contact_fraction", "drive_force"):
        np.testing.assert_allclose(steady[name].mean("distance"), ds[name], rtol=1e-12)
    np.testing.assert_allclose(steady["rms_a_z"][0], ds["rms_a_z"], rtol=1e-13)
    state = steady["state"].isel(stretch=-1)
    np.testing.assert_array_equal(state.sel(number=["y", "z", "v_y", "v_z"]), ds["strobe"][-1, [0, 1, 5, 6]])
    np.testing.assert_allclose(steady["seconds"], steady["distance"] / 1250.0)
    # peaks are in their windows, where there are any, and every touch begins with a touchdown
    where, ends = steady["peak_distance"], steady["distance"]
    assert bool(np.all(((where > ends - 8.0) & (where <= ends)) | np.isnan(where)))
    assert bool(np.all(np.isnan(where) == (steady["peak_force"] == 0)))
    assert bool(np.all((steady["impacts"].sum("distance") > 0) == (steady["contact_fraction"].sum("distance") > 0)))
    # what half the step changes: measured 1.35159139e-05 both
    probe = sj.simulate(SCENE, 1, steps_per_period=STEPS, probe=1).probe
    np.testing.assert_allclose(steady["probe_error"], probe.error, rtol=1e-4)


@pytest.mark.full
def test_a_run_and_a_trajectory_go_on_from_where_another_one_ended(steady):
    first = sj.run(SCENE, length=24.0, window=8.0, steps_per_period=STEPS, start=START)
    rest = sj.run(SCENE, length=40.0, window=8.0, steps_per_period=STEPS, start=first)
    np.testing.assert_array_equal(rest["distance"], steady["distance"][3:])
    # measured equal bits
    np.testing.assert_allclose(rest["peak_force"], steady["peak_force"][3:], rtol=1e-10)
    np.testing.assert_allclose(rest["state"][-1], steady["state"][-1], rtol=1e-9, atol=1e-12)
    run = sj.simulate(SCENE, 5, start=first, begin=24.0, steps_per_period=STEPS, probe=1)
    np.testing.assert_allclose(run.loads.peak_force, steady["peak_force"][3:], rtol=1e-10)
    np.testing.assert_allclose(8.0 * run.loads.peak_period, steady["peak_distance"][3:], rtol=1e-10)
    np.testing.assert_allclose(run.time[0], steady["seconds"][2])
    for call in (sj.run, lambda scene, *, length, **more: sj.simulate(scene, 1, **more)):
        with pytest.raises(ValueError, match="`begin` must be one of the distances where the earlier run kept"):
            call(SCENE, length=8.0, begin=17.0, start=first)
    lost = first.assign(state=np.nan * first["state"])
    with pytest.raises(ValueError, match="Argument `start` must be finite, but its y is"):
        sj.run(SCENE, length=8.0, start=lost)


def test_the_least_number_of_steps_in_a_window_is_said():
    assert f"constant along the run, but {LEAST_STEPS_PER_WINDOW} or more in each window" in " ".join(
        str(sj.run.__doc__).split()
    )


@pytest.mark.full
def test_times_and_steps_follow_the_speed(runs):
    np.testing.assert_allclose(runs["seconds"], FAST.seconds(runs["distance"].values), rtol=1e-12)
    np.testing.assert_allclose(runs["speed"], FAST.at(runs["distance"].values - 0.5), rtol=1e-12)
    steps = runs["steps_per_window"]
    assert steps.dims == ("track.seed", "distance")
    # slowest in the first metre, where the speed rises, and fastest in the hundredth
    assert np.all(steps[:, 0] == steps.max())
    assert np.all(steps[:, 99] == steps.min())
    # as many as a constant speed there would take
    for window in (0, 50, 150):
        least = dataclasses.replace(RAIL, speed=float(FAST.least(window, window + 1.0)))
        np.testing.assert_array_equal(steps[:, window], np.ceil(sj.model.default_steps_per_period(least) / 8.0))
    assert list(runs["stretch"].values) == [100.0, 200.0, 210.0]
    assert not runs["status"].any()


@pytest.mark.full
def test_a_run_from_standstill_passes_what_is_too_slow():
    # 0.5 s at rest, 300 m/s^2 up to 40 m, and a stop at 61 m
    history = sj.SpeedProgramme.over_time(
        np.array([1.0, 1.5, 1.5 + np.sqrt(80 / 300), 2.3]), [0.0, 0.0, np.sqrt(24e3), 0.0]
    )
    ds = sj.run(RAIL, {"track.seed": [3.0, 4.0]}, length=60.0, speed=history)
    assert not ds["status"].any()
    slow = ds["window_status"] == sj.Status.TOO_SLOW
    assert np.flatnonzero(slow).tolist() == [0]
    np.testing.assert_allclose(ds["seconds"], history.seconds(ds["distance"].values) - 1.0, rtol=1e-12)
    # 1 m/s is reached after 1.7 mm
    np.testing.assert_allclose(ds["seconds"][0], 0.5 + np.sqrt(2 / 300), rtol=1e-9)
    assert np.all(np.isfinite(ds["peak_force"]))
    # as many steps as the contacts take: as in 1 m at 1 m/s, but not in the second
    assert float(ds["steps_per_window"][0, 0]) > 10 * float(ds["steps_per_window"][0, 1])


@pytest.mark.full
def test_runs_of_a_grid_are_those_of_their_rails_and_stretches_those_of_their_windows(runs):
    one = sj.run(RAIL, {"track.seed": [4.0]}, length=210.0, speed=FAST)
    np.testing.assert_array_equal(one["peak_force"][0], runs["peak_force"][1])
    assert float(np.abs(runs["peak_force"][0] - runs["peak_force"][1]).max()) > 100.0
    counts = runs["impacts"][0, :STRETCH].sum("distance")
    seconds = float(runs["seconds"][STRETCH - 1])
    np.testing.assert_allclose(runs["impact_rate"][0, 0], counts / seconds, rtol=1e-12)
    highest = runs["peak_force"].max(("end", "point"))[0, :STRETCH]
    np.testing.assert_allclose(runs["peak_force_percentile"][0, 0], np.percentile(highest, [50, 90, 99]))
    # heat is the friction's share of what the impulses press, at the sliding speed; measured 2e-3 apart
    heat, pressed = runs["friction_work"].sum(("end", "point")), runs["impulse"].sum(("end", "point"))
    np.testing.assert_allclose(heat[0].sum(), (0.1 * pressed * runs["speed"])[0].sum(), rtol=0.02)


def third_octaves(acceleration, seconds, windows=STRETCH, capacity=64):
    """Bands of accelerations that are a function of time."""
    record, rows = ThirdOctaves(), []
    for window in range(windows):
        curve = SimpleNamespace(at=lambda places, w=window: acceleration((w + places[:, None]) * seconds))
        course = SimpleNamespace(acceleration=curve, capacity=capacity, travel=SimpleNamespace(period=seconds))
        rows.append(record.sample(course)[0])
    return record.finish(None, (np.stack(rows)[None], np.full((1, windows), seconds)), None)[0]


def test_third_octaves_hold_the_power_of_sines_and_nothing_of_those_above():
    """Sines above half the sampling frequency of 16 kHz would appear at 1900 and 160 Hz."""
    wave = lambda frequency, size: lambda t: size * np.sin(2 * np.pi * frequency * t)
    shown, beyond = (wave(400.0, 3.0), wave(1000.0, 2.0)), (wave(14_100.0, 3.0), wave(15_840.0, 3.0))
    both = lambda t: np.hstack([of(t) + other(t) for of, other in zip(shown, beyond, strict=True)])
    bands = third_octaves(both, 1e-3)
    for k, (middle, size) in enumerate(((400.0, 3.0), (1000.0, 2.0))):
        nearest = int(np.argmin(np.abs(np.log(BANDS / middle))))
        np.testing.assert_allclose(bands[nearest, k], size / np.sqrt(2), rtol=1e-4)  # measured 9e-7
        others = np.delete(bands[:, k], nearest)
        assert np.nanmax(others) < 1e-3 * size  # measured 6e-4, of 14,100 Hz
    assert np.isnan(bands[BANDS > 4000.0 / 10**0.05]).all()  # beyond a quarter of the sampling frequency
    assert np.isnan(bands[BANDS < 40.0]).all()  # narrower than 10 Hz


@pytest.mark.parametrize("window", [8.0, 4.0, 2.0, 1.0])
def test_third_octaves_of_short_pulses_are_those_of_their_closed_form(window):
    """Half sines of 0.7 ms at random instants, at 1000 m/s: of windows of 8 m a sample is as long as a pulse."""
    seconds, pulse = window / 1000.0, 7e-4
    total, count = STRETCH * seconds, SAMPLES_PER_WINDOW * STRETCH - 3
    instants = np.random.default_rng(0).uniform(0.02 * total, 0.98 * total, max(4, int(120 * total)))

    def acceleration(t):
        phase = (t - instants) / pulse
        half_sine = np.sum(np.where(np.abs(phase) < 0.5, np.cos(np.pi * phase), 0.0), axis=1)
        return np.stack([half_sine, -2 * half_sine], axis=1)

    bands = third_octaves(acceleration, seconds, capacity=400)
    # the sum of the pulses' transforms, each with Hann's weight at its instant, at the frequencies of the samples
    spacing = seconds / SAMPLES_PER_WINDOW
    weight = np.sin(np.pi * (instants / spacing - 2) / count) ** 2
    frequency = np.arange(1, count // 2) / (count * spacing)
    one = 2 * pulse / np.pi * np.cos(np.pi * frequency * pulse) / (1 - (2 * frequency * pulse) ** 2)
    transform = one * (np.exp(-2j * np.pi * np.outer(frequency, instants)) @ weight)
    share = 2 * np.abs(transform) ** 2 / (3 / 8 * (count * spacing) ** 2)
    known = np.isfinite(bands[:, 0])
    assert known.sum() > 10
    ends = [(BANDS[known] * 10 ** (sign / 20))[:, None] for sign in (-1, 1)]
    level = np.sqrt(np.sum(np.where((frequency >= ends[0]) & (frequency < ends[1]), share, 0.0), axis=1))
    # measured 1.1e-3 at 1 m and 1.1e-4 at 8 m, where eight unfiltered samples were 1.2 to 5.9 times too high
    np.testing.assert_allclose(bands[known], level[:, None] * [1.0, 2.0], rtol=3e-3)


def test_wrong_runs_are_named():
    wearing = dataclasses.replace(RAIL, wear=sj.model.Wear(1e-13))
    for make, words in (
        (
            lambda: sj.run(SCENE, length=16.0, record="peak"),
            "Argument `record` must be one of peak_distance, impacts",
        ),
        (lambda: sj.run(SCENE, {"sped": [1.0]}, length=16.0), "Argument `sped` is no parameter"),
        (
            lambda: sj.run(dataclasses.replace(wearing, friction=None), length=8.0),
            "`scene` must have friction, by whose",
        ),
        (lambda: sj.simulate(wearing, 1), "Argument `scene` must have no wear here"),
    ):
        with pytest.raises(ValueError, match=words):
            make()
    short = sj.model.SampledTrack([0.0, 16.0], 1e-4 * np.sin(np.arange(65)), 0.0, ends="error")
    with pytest.raises(ValueError, match=r"end before the rail does at 16 m, but is 24; .*ramp=8.*length=24"):
        sj.run(dataclasses.replace(SCENE, track=short), length=24.0)
    known = pytest.warns(sj.ImplausibleWarning, match="the rail is known up to 400 m only")
    with known, pytest.raises(ValueError, match="Argument `record`"):
        sj.run(RAIL, length=500.0, record="nothing")


@pytest.mark.full
def test_wear_opens_the_play_of_each_face_by_its_friction_and_a_table_by_the_distance():
    def worn(wear, length=210.0, **options):
        scene = dataclasses.replace(RAIL, wear=wear)
        return sj.run(scene, length=length, speed=FAST, record="friction_work", **options)

    ds, section = worn(sj.model.Wear(1e-13)), RAIL.section
    work = ds["friction_work"].sum("end").groupby(ds["distance"] > 100.0).sum()[0]
    of_faces = np.array([work.values[section.face_of_point == k].sum() for k in range(5)])
    pairs = np.array([[0, 9], [1, 2], [3, 4], [5, 6], [7, 8]])
    widths = np.hypot(*np.diff(np.asarray(section.points)[pairs], axis=1)[:, 0].T)
    opened = ds["play"][0] - np.asarray(section.play)  # at the end of the first stretch
    np.testing.assert_allclose(opened, 1e-13 * of_faces / (widths * 0.2), rtol=1e-10)
    assert float(opened.max()) > 1e-7
    rest = worn(sj.model.Wear(1e-13), length=10.0, begin=200.0, start=ds)
    np.testing.assert_allclose(rest["friction_work"], ds["friction_work"][200:], rtol=1e-6, atol=1e-12)
    assert float((ds["play"][2] - ds["play"][1]).max()) > 1e-9
    np.testing.assert_allclose(rest["play"][0] - ds["play"][2], 0.0, atol=1e-12)
    ds = worn(sj.model.WearTable([0.0, 200.0], [0.0, 1e-4]))
    np.testing.assert_allclose(ds["play"][:, 0] - 0.5e-3, [5e-5, 1e-4, 1e-4], rtol=1e-12)


@pytest.mark.slow  # three programs
def test_the_play_opens_before_each_window():
    opening = sj.model.WearTable([0.0, 4.0], [0.0, 4e-4])
    # Tsit5 keeps the last slope, which the play changes
    options = dict(speed=FAST, record="peak_force", steps_per_period=80, solver="Tsit5", probe=1)
    whole = sj.run(dataclasses.replace(RAIL, wear=opening), length=4.0, **options)
    start = sj.table_2_start()
    for k in range(4):
        wider = {f"section.play.{face}": 0.5e-3 + k * 1e-4 for face in range(5)}
        start = sj.run(RAIL.replace(**wider), length=1.0, begin=float(k), start=start, **options)
        if k == 0:
            np.testing.assert_allclose(start["probe_error"], whole["probe_error"], rtol=1e-6)
        np.testing.assert_allclose(start["peak_force"][0], whole["peak_force"][k], rtol=1e-10)  # 2e-13
    np.testing.assert_allclose(start["state"], whole["state"], rtol=1e-10, atol=1e-10)  # 1e-12


@pytest.mark.full
@pytest.mark.parametrize("speeds", [(), (300.0, 400.0)], ids=["starts", "speeds"])
def test_slippers_wear_alike_in_a_grid_and_alone(speeds):
    scene = dataclasses.replace(RAIL, speed=400.0, wear=sj.model.Wear(1e-10))
    how = dict(length=21.0, window=0.2, record="friction_work", steps_per_period=400)
    grid = {"start_y": [0.0, 1e-4]} | ({"speed": speeds} if speeds else {})
    ds = sj.run(scene, grid, **how)
    # at the end of each of the two stretches
    opened = ds["play"].diff("stretch").max("face")
    assert float(opened.min()) > 1e-8
    for y, speed in itertools.product(grid["start_y"], speeds or [400.0]):
        alone = sj.run(scene.replace(speed=speed), start=sj.AtRest(y=y), **how)
        lane = ds.sel(start_y=y, **({"speed": speed} if speeds else {}))
        for name in ("play", "friction_work", "state", "status"):
            # measured equal bits
            np.testing.assert_allclose(lane[name], alone[name], rtol=1e-8, atol=1e-10, err_msg=name)
