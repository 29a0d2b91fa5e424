"""Records over the model: made-up runs whose numbers are known, and runs of the model itself."""

import dataclasses
import re

import numpy as np
import pytest
import scipy.signal
import xarray as xr

import slipperjax as sj
from slipperjax.fitting import synthetic_record, telemetry
from slipperjax.fitting.accelerations import read_record
from slipperjax.fitting.telemetry import check_telemetry, compared
from slipperjax.flow.datasets import run_attributes
from slipperjax.sweeps import AccelerationHistory
from slipperjax.tools.units import STANDARD_GRAVITY

BOX = sj.model.Sensor("box")
SPEED = 100.0
WINDOWS = 200
SAMPLES = 256
RATE = SPEED * SAMPLES  # of samples [Hz]
COMPARED = ("rms", "density", "shock_response")
BANDS = dict(low=100.0, high=1000.0)


def sine(time, frequency=300.0, amplitude=30.0):
    return amplitude * np.sin(2 * np.pi * frequency * time)


def made(signals, steps=SAMPLES):
    """Gives made-up runs at 100 m/s whose vertical accelerations are signals [m/s^2], (rails, samples)."""
    scene = sj.paper_scene(SPEED)
    windows = signals.shape[1] // SAMPLES
    values = np.zeros((len(signals), windows, SAMPLES, 8))
    values[..., 1] = signals.reshape(values.shape[:3])
    ends = np.arange(1.0, windows + 1)
    data = {
        AccelerationHistory.quantity.name: (("case", "distance", "sample", "component"), values),
        "status": ("case", np.zeros(len(signals), int)),
        "steps_per_window": (("case", "distance"), np.full((len(signals), windows), steps)),
    }
    coords = {
        "distance": ("distance", ends, {"units": "m"}),
        "seconds": ("distance", ends / SPEED, {"units": "s"}),
        "speed": ("distance", np.full(windows, SPEED), {"units": "m/s"}),
    }
    call = dict(function="run", begin=0.0, length=float(windows))
    attributes = run_attributes(scene, sj.Motion(), call) | {"window [m]": 1.0}
    return xr.Dataset(data, coords, attributes)


TIME = np.arange(WINDOWS * SAMPLES) / RATE


def dataset(value, time=TIME, unit="m/s^2"):
    return xr.Dataset({"box": ("time", value, {"units": unit})}, {"time": ("time", time, {"units": "s"})})


@pytest.fixture
def table(tmp_path):
    """Writes a table of columns by their heads, and returns its path."""

    def write(**columns):
        path = tmp_path / "record.csv"
        heads = {
            "time": "time [s]",
            "value": "box [m/s^2]",
            "a": "a [g]",
            "distance": "distance [ft]",
            "speed": "v [m/s]",
        }
        rows = np.column_stack(list(columns.values()))
        head = ", ".join(heads.get(name, name.replace("__", " [") + "]" * ("__" in name)) for name in columns)
        np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=head, comments="")
        return path

    return write


@pytest.mark.full
def test_a_sine_has_its_rms_density_and_shock_response():
    amplitude = 45.0
    run = made(sine(TIME)[None])
    record = dataset(sine(TIME, amplitude=amplitude))
    # 300 Hz is the middle of a band of a third of an octave or less, much wider than the lobe of a window of 1 s
    low = 300.0 * 2 ** (-19 / 12)
    found = telemetry(run, record, BOX, low=low, high=low * 8, window=1.0)
    # measured 3e-4, of the ripple of the low-pass before samples are left out; 7e-4 of densities
    np.testing.assert_allclose(found["measured_rms"], amplitude / np.sqrt(2), rtol=1e-3)
    np.testing.assert_allclose(found["measured_total_rms"], amplitude / np.sqrt(2), rtol=1e-3)
    band = found["density"].isel(quantile=0).argmax("frequency").item()
    width = float(found["high"][band] - found["low"][band])
    np.testing.assert_allclose(found["measured_density"][band], amplitude**2 / 2 / width, rtol=2e-3)
    # SciPy's densities of the record itself, in the same band
    frequency, density = scipy.signal.welch(record["box"].values, RATE, nperseg=int(RATE))
    inside = (frequency >= float(found["low"][band])) & (frequency < float(found["high"][band]))
    np.testing.assert_allclose(found["measured_density"][band], density[inside].sum() / width, rtol=2e-3)
    # the model has the other amplitude
    wanted = 20 * np.log10(amplitude / 30.0)
    for name in ("rms", "total_rms", "density", "shock_response"):
        ratio = found[f"{name}_ratio"].values if name != "density" else found["density_ratio"].values[band]
        np.testing.assert_allclose(ratio, wanted, rtol=0, atol=1e-9)  # measured 1e-12
    # an edge of bands is 300 Hz: |H| = sqrt(Q^2 + 1) at resonance
    found = telemetry(run, record, BOX, low=150.0, high=1200.0, quality=20.0)
    at = int(np.argmin(abs(found["natural_frequency"].values - 300.0)))
    assert float(found["natural_frequency"][at]) == pytest.approx(300.0)
    # measured 7e-4
    np.testing.assert_allclose(found["measured_shock_response"][at], amplitude * np.sqrt(401.0), rtol=3e-3)


def test_a_doubtful_run_keeps_its_mark():
    """In the result, its words, its tables and its picture."""
    run = made(sine(TIME)[None])
    run["status"][:] = sj.Status.INACCURATE
    said = "status of 1 of 1 run: inaccurate"
    with pytest.warns(UserWarning, match=f"Doubtful runs count: {said}"):
        found = telemetry(run, dataset(sine(TIME)), BOX, low=100.0, high=200.0)
    assert found["status"].values.tolist() == [sj.Status.INACCURATE]
    assert found.summary()[0].startswith(said)
    assert {tuple(table["status"].unique()) for table in found.tables().values()} == {("inaccurate",)}
    assert said in sj.plots.record_over_model(found)[0].figure.get_suptitle()


@pytest.mark.full
def test_units_names_and_rates_of_a_record_do_not_matter(table):
    """A record in g at another rate, in a file, beside one in m/s^2 at the times of the run."""
    rng = np.random.default_rng(1)
    spectrum = rng.normal(size=(2, 60))
    frequencies = rng.uniform(100, 1000, 60)
    signal = lambda t: sum(
        a * np.sin(2 * np.pi * f * t + p) for (a, p), f in zip(spectrum.T, frequencies, strict=True)
    )
    run = made(signal(TIME)[None])
    own = telemetry(run, dataset(signal(TIME)), BOX, **BANDS)
    time = np.arange(0, 2.0, 1 / 9000.0)
    for file in (
        table(time=time, a=signal(time) / STANDARD_GRAVITY),
        table(time=time, value=signal(time), distance=SPEED * time / 0.3048),
    ):
        other = telemetry(run, file, BOX, **BANDS)
        for name in COMPARED:
            assert abs(own[f"{name}_ratio"]).max() < 1e-9  # measured 3e-13
            # measured 0.012 dB
            assert abs(other[f"{name}_ratio"]).max() < 0.05, name
    in_g = telemetry(run, dataset(signal(TIME) / STANDARD_GRAVITY, unit="standard_gravity"), BOX, **BANDS)
    np.testing.assert_allclose(in_g["measured_rms"], own["measured_rms"], rtol=1e-12)


@pytest.mark.full
def test_distance_and_speed_find_the_place_of_a_record(table):
    """The record's clock is 0.3 s late, and its loudness changes along the rail."""
    loud = lambda distance: 1 + distance / 100.0
    signal = sine(TIME) * loud(SPEED * TIME)
    run = made(signal[None])
    by_distance = table(time=TIME + 0.3, value=signal, distance=SPEED * TIME / 0.3048)
    found = telemetry(run, by_distance, BOX, **BANDS)
    assert abs(found["rms_ratio"]).max() < 1e-6  # measured 4e-13 dB
    # by speed the place is that of its time; the second half is the run's first half
    by_speed = table(time=TIME + 0.3, value=signal, speed=np.full(len(TIME), SPEED))
    found = telemetry(run, by_speed, BOX, **BANDS)
    by_time = telemetry(run, table(time=TIME + 0.3, value=signal), BOX, **BANDS)
    middle = found["distance"].values
    wanted = 20 * np.log10(loud(middle - 0.3 * SPEED) / loud(middle))
    np.testing.assert_allclose(found["rms_ratio"], wanted, atol=3e-3)  # measured 3e-4 dB
    np.testing.assert_allclose(by_time["rms_ratio"], wanted, atol=3e-3)
    # half as fast: windows of the same time in the middle of the same places
    slow = np.arange(0, 4.0, 1 / RATE)
    half = table(time=slow, value=sine(slow) * loud(SPEED * slow / 2), distance=SPEED * slow / 2 / 0.3048)
    found = telemetry(run, half, BOX, **BANDS)
    np.testing.assert_allclose(found["rms_ratio"], 0.0, atol=5e-3)  # measured 4e-4 dB


def test_the_band_holds_nine_of_ten_records():
    """Of numbers of one more rail; by NumPy's default quantiles it would be 0.85 with 32 rails."""
    rng = np.random.default_rng(3)
    for rails in (19, 32, 100):
        found = compared("rms", ("distance",), rng.lognormal(size=(rails + 1, 20_000)), "m/s^2", 20, "RMS")
        # measured 0.902, 0.907 and 0.899; the standard error is 0.003
        assert found["rms_inside"][1] == pytest.approx(0.9, abs=0.01)


@pytest.mark.full
def test_a_record_of_one_more_rail_is_inside_the_band():
    """Noise, whose level differs from rail to rail and along each."""
    rng = np.random.default_rng(3)
    count, records = 32, 8
    half = len(TIME) // 2
    levels = np.repeat(10 ** rng.normal(0, 0.15, (count + records, 10)), half // 10, axis=1)
    signals = 30 * levels * rng.normal(size=levels.shape)
    run = made(signals[:count])
    found = [telemetry(run, dataset(signal, TIME[:half]), BOX, **BANDS) for signal in signals[count:]]
    shares = {f"{name}": float(np.mean([one[f"{name}_inside"] for one in found])) for name in COMPARED}
    # the standard error is 0.03
    assert all(0.8 < share < 1.0 for share in shares.values()), shares
    loud = telemetry(run, dataset(4 * signals[-1], TIME[:half]), BOX, **BANDS)
    assert float(loud["rms_inside"]) < 0.2
    assert loud["rms"].sizes["quantile"] == 3
    (line,) = [line for line in loud.summary() if line.startswith("RMS in windows")]
    assert re.search(r"; \d+ % of \d+ windows inside$", line)
    assert loud.summary()[0] == "record at box over 32 rails (5 to 95 %), 100 to 1000 Hz"


@pytest.mark.full
def test_a_gap_of_a_record_is_left_out_of_its_windows():
    rng = np.random.default_rng(2)
    signal = 30 * rng.normal(size=len(TIME))
    gap = (TIME > 0.5) & (TIME < 0.52)
    whole = telemetry(made(signal[None]), dataset(signal), BOX, **BANDS)
    holed = telemetry(made(signal[None]), dataset(np.where(gap, np.nan, signal)), BOX, **BANDS)
    seconds = holed["distance"].values / SPEED
    near = abs(seconds - 0.51) < 0.01 + float(holed.attrs["window of densities [s]"]) / 2
    assert 0 < near.sum() < len(near)
    np.testing.assert_array_equal(np.isnan(holed["rms_ratio"]), near)
    # a spline across the gap would swing; measured 0.03
    np.testing.assert_allclose(holed["measured_shock_response"], whole["measured_shock_response"], rtol=0.1)
    assert abs(holed["rms_ratio"]).max() < 1e-6  # measured 6e-8 dB


@pytest.mark.full
def test_a_gain_and_a_slow_run_are_known(tmp_path):
    run = made(sine(TIME)[None], steps=24)
    sensor = dataclasses.replace(BOX, gain=1.25, bias=3.0, delay=1e-3)
    found = telemetry(run, dataset(1.25 * sine(TIME - 1e-3) + 7.0), sensor, **BANDS)
    np.testing.assert_allclose(found["rms_ratio"], 0.0, atol=1e-5)  # measured 6e-8
    # 24 steps a metre suffice for 600 Hz
    assert 500.0 < float(found["known_to"].max()) <= 600.0
    assert np.isnan(found["shock_response"].sel(natural_frequency=slice(610.0, None))).all()
    summary = found.summary()
    assert "bands up to 1000 Hz need more steps and samples of the run" in summary
    assert summary[-2].startswith("both sides alike: 20000 Hz, low-pass 2000 Hz, line removed")
    found.write(tmp_path / "a.pdf", tmp_path / "a.csv", tmp_path / "a.nc", tmp_path / "a.png")
    assert {path.name for path in tmp_path.iterdir()} == {
        *("a.pdf", "a.csv", "a_frequencies.csv", "a_windows.csv", "a.nc", "a.png")
    }
    assert sj.load(tmp_path / "a.nc").summary() == summary
    heads = list(found.tables(units=["ft"])["windows"].columns)
    assert heads == [
        "distance travelled [ft]",
        "record [g]",
        "model [g]",
        "record over model [dB]",
        "bands up to [Hz]",
        "status",
    ]


@pytest.mark.full
def test_a_record_of_the_model_s_own_motion_lies_on_the_line():
    """By another way: `simulate`, and the sensor's readings of its states."""
    track = sj.RandomTrack.sled(length=250.0)
    scene = dataclasses.replace(sj.paper_scene(speed=400.0), track=track, gravity=9.81)
    steps = 800
    sensor = sj.model.Sensor("box", place=(0.05, 0.0, 0.03))
    run = sj.run(scene, length=40.0, record="body_acceleration", steps_per_period=steps)
    motion = sj.simulate(scene, 5, start="rest", steps_per_period=steps, saves_per_period=steps)
    record = synthetic_record(motion, [sensor], rate=25e3)
    found = telemetry(run, record, sensor, low=200.0, high=1000.0)
    worst = {name: float(abs(found[f"{name}_ratio"]).max()) for name in COMPARED}
    # measured 8e-5, 2e-4 and 8e-4 dB
    assert max(worst.values()) < 0.01, worst


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (dict(time=TIME[:99]), "has no line of names"),
        (dict(time=TIME[:99], speed=TIME[:99]), "must have a column `box` or `acceleration`"),
        (dict(value=TIME[:99], speed=TIME[:99]), "must have a column `time`"),
        (dict(time=TIME[:99], box__furlong=TIME[:99]), "furlong"),
        (dict(time=TIME[:99], box__m=TIME[:99]), "box"),
        (dict(time=TIME[[0, 2, 1, 3]], value=TIME[:4]), "line 4: time"),
        (dict(time=TIME[:5], value=TIME[:5]), "must have 8 samples or more, but has 5"),
        (
            dict(time=1e-3 * np.arange(99), value=TIME[:99]),
            "must have 4000 samples a second or more for bands up to 1000 Hz",
        ),
        (dict(time=1e9 + np.arange(99) / 8192, value=TIME[:99]), "not be times of a clock"),
        (dict(time=TIME[:99], value=TIME[:99], speed=-TIME[:99]), "speeds of zero or more"),
        (
            dict(time=TIME[:99], value=TIME[:99]),
            "with the run for 0.0092 s or more, but is there for 0.00383 s",
        ),
        (dict(time=5 + TIME[:99], value=TIME[:99]), "within the run, 0 to 2 s, but has 0: 5 to 5.004 s"),
        (
            dict(time=TIME[:99], value=TIME[:99], distance=1e4 + TIME[:99]),
            "within the run, 0 to 200 m, but has 0: 3048",
        ),
    ],
)
def test_a_wrong_record_is_one_line_before_a_run(columns, words, table):
    with pytest.raises(ValueError, match=re.escape(words)) as error:
        check_telemetry(sj.paper_scene(SPEED), table(**columns), BOX, length=200.0, **BANDS)
    assert "\n" not in str(error.value)


def test_wrong_arguments_are_named():
    record = dataset(sine(TIME))
    check = lambda sensor=BOX, **how: check_telemetry(
        sj.paper_scene(SPEED), record, sensor, **dict(length=200.0) | how
    )
    check(**BANDS)
    with pytest.raises(ValueError, match="`sensor` must measure acceleration, but is 'force'"):
        check(sj.model.Sensor("box", "force"), **BANDS)
    with pytest.raises(ValueError, match="`rails` must be 1, or 19 or more for a band, but is 8"):
        check(rails=8, **BANDS)
    with pytest.raises(ValueError, match="`measured` must have a signal of lid"):
        read_record(record.drop_vars("box"), sj.model.Sensor("lid"), 1000.0)
    with pytest.raises(ValueError, match=r'`runs` must be results of .* with the record "body_acceleration"'):
        telemetry(xr.Dataset(), record, BOX)
