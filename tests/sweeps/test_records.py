"""Reducers: each against histories with all steps; the same numbers whatever the chunks; labels, statuses, errors."""

import functools
import json

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.load import load_call
from slipperjax.flow.percentiles import ForcePercentile
from slipperjax.flow.reducers import PointLoad, Reduced, SectionPoints, StrobeStates
from slipperjax.flow.spectra import SpectrumLines
from slipperjax.flow.status import Status
from slipperjax.model.quantities import ACCELERATIONS, COORDINATES, LOADS, SECTIONS
from slipperjax.sweeps.attractors import attractors
from slipperjax.sweeps.exponents import lyapunov_sweep
from slipperjax.sweeps.grid import Cases
from slipperjax.sweeps.plan import make_plan
from slipperjax.sweeps.reducers import REDUCERS, LargestExponent, MotionKind, Motions, resolved_record
from slipperjax.sweeps.repeat import repeat

PERIODS, STEPS, MOST = 20, 50, 8  # all of them in the programs of test_sweep, but those of reducers
LINES = (0, 0.5, 1, 2)
RECORD = [
    *(name for name in REDUCERS if name not in ("sections", "exponent")),
    SectionPoints(MOST),
    ForcePercentile((50, 90, 99)),
    SpectrumLines("v_z", LINES),
    SpectrumLines("a_z", (1,)),
]
# the first begins on its orbit, the last is lost at its first contact
CASES = {"speed": np.array([1250.0, 1000.0, 1500.0, 900.0, 1e-3])}
SEVERAL = np.array([50, 50, 50, 100, 50])  # the programs have room for more steps than most of the cases take
OPTIONS = dict(product=False, transient=10, periods=PERIODS, chunk=8)
pytestmark = pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose


@functools.cache
def settled():
    """A state near the orbit at 1250 m/s, by the program of test_sweep."""
    end = None
    for _ in range(20):
        end = sj.simulate(sj.paper_scene(), 20, steps_per_period=STEPS, start=end)
    return end.end


def swept(record, grid=CASES, steps=STEPS, clearance=1e-3, **options):
    options = OPTIONS | dict(start=settled(), steps_per_period=steps) | options
    return sj.sweep(sj.paper_scene(clearance=clearance), grid, record=record, **options)


@pytest.fixture(scope="module")
def reduced():
    return swept(RECORD, steps=SEVERAL)


@pytest.fixture(scope="module")
def history():
    """Every step of all cases but the fourth; of that every other one."""
    return swept("history", steps=SEVERAL, saves_per_period=STEPS)


@pytest.fixture(scope="module")
def good(reduced, history):
    """Of the good cases of which the history has every step."""
    return reduced.isel(case=slice(0, 3)), history.isel(case=slice(0, 3))


def test_loads_and_statuses_are_those_of_a_history(reduced, history):
    wide = dict(clearance=400.0, grid={"speed": [1250.0, 1000.0]}, steps=SEVERAL[2:4], start=None)
    free = swept(RECORD, **wide), swept("history", saves_per_period=STEPS, **wide)
    for (found, exact), status in (
        ((reduced, history), [0, 0, 0, 0, Status.NOT_FINITE]),
        (free, [Status.NO_CONTACT] * 2),
    ):
        assert found["status"].values.tolist() == exact["status"].values.tolist() == status
        np.testing.assert_array_equal(found["steps_per_period"].values, exact["steps_per_period"].values)
        for name in LOADS:
            assert found[name].attrs == exact[name].attrs
            # measured 2e-12: programs with other records are fused, and round, differently
            np.testing.assert_allclose(found[name].values, exact[name].values, rtol=1e-10, atol=1e-15, err_msg=name)
    assert set(free[0]["kind"].values) == {"unresolved"}
    assert np.all(free[0]["contact_force_percentile"].values == 0)


def test_rms_and_extremes_are_those_of_all_samples(good):
    found, exact = good
    for name, q in ACCELERATIONS.items():
        rms = np.sqrt((exact[name] ** 2).mean("time"))
        # measured 4e-8: the solver's own rates are those of gaps that follow its correction linearly
        np.testing.assert_allclose(found[f"rms_{name}"].values, rms.values, rtol=1e-6)
        assert found[f"rms_{name}"].attrs["units"] == q.unit
        assert "root mean square" in found[f"rms_{name}"].attrs["long_name"]
    for name in COORDINATES:
        x = exact[name]
        largest = found[f"largest_{name}"].values - x.max("time").values
        smallest = x.min("time").values - found[f"smallest_{name}"].values
        for beyond in (largest, smallest):
            # tests/flow/test_reducers.py compares them with the curves between the samples; measured 8e-3
            assert np.all((beyond >= -1e-12) & (beyond < 0.02 * np.ptp(x.values))), name


def test_percentiles_are_near_those_of_all_samples(good, reduced):
    exact = np.percentile(good[1]["contact_force"].values, [50, 90, 99], axis=1)
    found = good[0]["contact_force_percentile"].transpose("percentile", "case", "end", "point")
    assert found["percentile"].values.tolist() == [50, 90, 99]
    np.testing.assert_array_equal(found.values == 0, exact == 0)
    there = exact > 0
    assert there.sum() > 100
    apart = np.abs(found.values[there] / exact[there] - 1)
    print(f"\n{there.sum()} percentiles: off by {apart.max():.2%} at most, {np.median(apart):.2%} in the median")
    assert apart.max() < 1 / 32  # the width of a class; measured 0.0138
    assert np.median(apart) < 0.006  # measured 0.0035
    assert np.isnan(reduced["contact_force_percentile"].values[4]).all()


def test_spectrum_lines_are_those_of_the_discrete_transform(good):
    for name, lines in (("v_z", LINES), ("a_z", (1,))):
        x = good[1][name].values
        places = (np.array(lines) * PERIODS).astype(int)
        # the first sample is one step after the start of the record
        exact = np.fft.fft(x, axis=1)[:, places] / x.shape[1] * np.exp(-2j * np.pi * np.array(lines) / STEPS)
        exact *= np.where(np.array(lines) > 0, 2, 1)
        found = [good[0][f"spectrum_{name}_{part}"].values for part in ("real", "imag")]
        # measured 1e-8 of the largest, see above
        np.testing.assert_allclose(found[0] + 1j * found[1], exact, rtol=0, atol=1e-6 * np.abs(exact).max())
    assert good[0]["frequency_v_z"].attrs["units"] == "1/period"


def test_section_points_are_the_first_and_dropped_ones_are_counted(reduced, history):
    """Of ten periods; of all, history tells their number."""
    exact = swept("sections", steps=SEVERAL, periods=10)
    begin = exact["strobe"].values[:4, 9]
    for name, coordinate in SECTIONS.items():
        x = history[coordinate].values[:4]
        x = np.concatenate([begin[:, [list(COORDINATES).index(coordinate)]], x], axis=1)
        count = np.sum((x[:, :-1] < 0) & (x[:, 1:] >= 0), axis=1)
        np.testing.assert_array_equal(reduced[f"crossings_{name}"].values[:4], count)
        assert np.any(count > MOST)
        for part in (name, f"{name}_period"):
            assert reduced[part].sizes["crossing"] == MOST
            # measured 2e-16
            first = exact[part].values[:4, :MOST]
            np.testing.assert_allclose(reduced[part].values[:4], first, rtol=1e-12, atol=1e-12)
    last = np.stack([history[name].values[:4, STEPS - 1 :: STEPS] for name in COORDINATES], axis=-1)
    for found, alike in (
        (reduced["strobe"].values[:4, :10], exact["strobe"].values[:4, 10:]),
        (reduced["strobe"].values[:4], last),
    ):
        # measured 3e-10 and 8e-11: programs with other records are fused, and round, differently
        np.testing.assert_allclose(found, alike, rtol=1e-8, atol=1e-9)


def test_motions_are_those_of_the_strobe_states(reduced):
    exact = attractors(reduced)
    np.testing.assert_array_equal(reduced["kind"].values, exact.kind)
    np.testing.assert_array_equal(reduced["period"].values, exact.period)
    assert reduced["kind"].values.tolist() == ["period"] + ["unresolved"] * 4
    with pytest.raises(ValueError, match=r"`periods` must be 16 or more to classify motions, 200 or .* but is 15"):
        swept(["rms", "motion"], periods=15)


@pytest.mark.slow
def test_the_exponent_is_that_of_a_measurement_from_there():
    reduced = swept(["exponent", "rms"])
    assert reduced["status"].values.tolist() == [0, 0, 0, 0, Status.NOT_FINITE]
    options = dict(product=False, transient=30, periods=PERIODS, certify=False, orbits=False, chunk=8)
    grid = {name: values[:2] for name, values in CASES.items()}
    exact = lyapunov_sweep(sj.paper_scene(), grid, steps_per_period=STEPS, start=settled(), **options)
    # measured 1.5e-6: rounding, which chaos and grazings enlarge
    np.testing.assert_allclose(reduced["exponent"].values[:2], exact["exponent"].values[:, 0], rtol=1e-5)
    np.testing.assert_allclose(reduced["exponent_stderr"].values[:2], exact["stderr"].values[:, 0], rtol=1e-4)
    assert "uncertified" in reduced["exponent"].attrs["long_name"]


def test_everything_is_labelled_and_can_be_run_again(reduced, tmp_path):
    assert reduced.attrs["record"].startswith("peak_force, peak_period, impulse")
    for name, variable in reduced.data_vars.items():
        assert variable.attrs["long_name"], name
        assert "units" in variable.attrs or name in ("kind", "status", "strobe"), name
        assert variable.dims[0] == "case"
    assert load_call(reduced)["record"] == tuple(RECORD)
    reduced.to_netcdf(tmp_path / "reduced.nc", engine="h5netcdf")
    again = repeat(tmp_path / "reduced.nc", chunk=8)
    xr.testing.assert_identical(again.drop_attrs(), reduced.drop_attrs())


def equal_bits(one, other):
    for name in other.data_vars:
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=name)


def test_numbers_do_not_depend_on_neighbours(reduced):
    """The same compiled program, with the cases in another order."""
    turned = swept(RECORD, {"speed": CASES["speed"][::-1]}, steps=SEVERAL[::-1])
    equal_bits(turned.isel(case=slice(None, None, -1)), reduced)


@pytest.mark.slow
def test_chunks_and_threads_change_no_bit():
    grid = {"speed": np.linspace(900, 2000, 20)}
    equal_bits(*(swept(RECORD, grid, chunk=n, workers=w) for n, w in ((8, 2), (24, 1))))


@pytest.mark.slow
def test_long_records_in_several_calls_are_those_of_one():
    """100 periods are two calls of 50, and 97, which nothing divides, one."""
    grid = {"speed": [1250.0, 1500.0]}
    record = ["rms", "contact_fraction", SectionPoints(5), StrobeStates(60), SpectrumLines("z", (1, 0.25))]
    long = swept(record, grid, periods=100, transient=3)
    exact = swept("history", grid, periods=100, transient=3, saves_per_period=STEPS)
    rms = np.sqrt((exact["a_z"] ** 2).mean("time"))
    np.testing.assert_allclose(long["rms_a_z"].values, rms.values, rtol=1e-6)  # as above
    np.testing.assert_allclose(long["contact_fraction"].values, exact["contact_fraction"].values, rtol=1e-9)
    np.testing.assert_allclose(
        long["strobe"].values[..., 0], exact["y"].values[:, STEPS - 1 :: STEPS][:, -60:], rtol=1e-8
    )
    assert long.sizes["crossing"] == 5
    assert np.all(long["crossings_v_y"].values > 50)
    x = exact["z"].values
    line = 2 / x.shape[1] * np.sum(x * np.exp(-2j * np.pi * 0.25 * (np.arange(x.shape[1]) + 1) / STEPS), axis=1)
    np.testing.assert_allclose(long["spectrum_z_real"].values[:, 1], line.real, atol=1e-11)
    np.testing.assert_allclose(long["spectrum_z_imag"].values[:, 1], line.imag, atol=1e-11)


@pytest.mark.slow
def test_following_with_reducers():
    record = ["peak_period", SectionPoints(3), "rms"]
    path = {"speed": [1240.0, 1250.0]}
    options = dict(directions=("up",), transient=10, periods=10)
    ds = sj.follow(sj.paper_scene(), path, record=record, **options)
    exact = sj.follow(sj.paper_scene(), path, record="sections", **options)
    assert ds["rms_a_z"].dims == ("direction", "speed")
    for name in ("v_z", "v_z_period"):
        np.testing.assert_allclose(ds[name].values, exact[name].values[..., :3], rtol=1e-12)
    # counted from the start of each value, as the crossings are
    assert np.all((ds["peak_period"].values > 10) & (ds["peak_period"].values < 20) | np.isnan(ds["peak_period"]))


def test_plans_know_what_is_kept_and_what_it_costs():
    scene = sj.paper_scene()
    cases = Cases(scene, {"speed": [1000.0, 1250.0]}, sj.table_2_start())

    def plan(record, periods=100):
        return make_plan(scene, cases, record=resolved_record(record), transient=20, periods=periods)

    assert resolved_record("sections") == "sections"
    assert [plan([r]).values for r in ("peak_force", "rms", "motion", "strobe")] == [20, 5, 2, 1000]
    assert plan(["peak_force", "rms"]).values == plan(["peak_force", "rms"], 5000).values == 25
    assert plan("motion").weight == 1
    assert not plan("motion").recorder.inside
    assert plan("rms").weight < 1.2 < plan("sections").weight
    assert plan(["peak_force", "impulse", "penetration"]).weight == plan("peak_force").weight
    assert plan("motion").work == 120
    assert plan(["motion", "exponent"]).work == pytest.approx(120 + 2.6 * 120)
    assert plan(["motion", "exponent"]).recorder.tangents


def test_cases_that_were_not_run_are_no_motions():
    blank = Motions(np.zeros(3, int), np.zeros(3, int))
    data, _ = MotionKind().label(sj.paper_scene(), ("case",), blank)
    assert data["kind"][1].tolist() == ["unresolved"] * 3


def bad(record):
    """Refused before anything is compiled."""
    return lambda: swept(record, {"speed": [1250.0]}, start=None)


def forces(t, state, args):
    return sj.reactions(t, state, args).drive_force


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (bad("peak"), "`record` must be one of sections, strobe, history, peak_force"),
        (bad(["peak"]), "`record` must be one of peak_force, "),
        (bad(["history"]), "`record` must be one of peak_force, "),
        (bad([]), "`record` must name at least one of peak_force, "),
        (bad([["rms"]]), "but is ['rms']"),
        (bad(3), "but is 3"),
        (bad(["rms", PointLoad("peak_force"), "peak_force"]), "must give each variable once, but gives `peak_f"),
        (bad(Reduced(forces, name="speed")), "`record` must not give `speed`, a name which the dataset has"),
        (bad(Reduced(forces, name="status")), "`record` must not give `status`"),
        (bad(SpectrumLines("y", (1, 30))), "must be below half of the 50 steps per period, but is 30"),
        (bad(Reduced(lambda t: t, name="odd")), "of `odd` must take (t, state, args), but raised TypeError"),
        (bad(Reduced(lambda t, s, a: (t, t), name="odd")), "of `odd` must give real numbers, but gives (Sh"),
        (bad(Reduced(lambda t, s, a: 1j * t, name="odd")), "`function` of `odd` must give real numbers"),
        (lambda: PointLoad("force"), "`load` must be one of peak_force, peak_period, impulse"),
        (lambda: ForcePercentile(101), "`percentiles` must be numbers from 0 to 100, each once, but is 101"),
        (lambda: ForcePercentile(()), "`percentiles` must be numbers"),
        (lambda: ForcePercentile((50, 50)), "`percentiles` must be numbers from 0 to 100, each once"),
        (lambda: ForcePercentile("99"), "`percentiles` must be numbers"),
        (lambda: ForcePercentile([[50]]), "`percentiles` must be numbers"),
        (lambda: SpectrumLines("x", (1,)), "`coordinate` must be one of y, z, roll"),
        (lambda: SpectrumLines("z", (-1,)), "`frequencies` must be numbers of zero or more, each once, but is (-1,)"),
        (lambda: SpectrumLines("z", float("nan")), "`frequencies` must be numbers"),
        (lambda: SpectrumLines("z", True), "`frequencies` must be numbers"),
        (lambda: SectionPoints(0), "`crossings` must be a whole number of 1 or more, but is 0"),
        (lambda: StrobeStates(0), "`last` must be a whole number of 1 or more"),
        (lambda: MotionKind(10), "`last` must be a whole number of 16 or more, but is 10"),
        (lambda: LargestExponent(2), "`periods` must be a whole number of 8 or more, but is 2"),
        (lambda: Reduced("max"), "`function` must be a function of (t, state, args), but is 'max'"),
        (lambda: Reduced(forces, name="a b"), "`name` must be a name such as spring_force, but is 'a b'"),
        (lambda: Reduced(forces, units=3), "`units` must be a text, but is 3"),
        (lambda: Reduced(forces, over="median"), "`over` must be one of max, min, sum, mean, but is 'med"),
    ],
)
def test_bad_records_and_reducers_are_refused(make, words):
    with pytest.raises(ValueError, match=r"^Argument ") as caught:
        make()
    assert words in str(caught.value)


def test_what_cannot_be_written_is_named_when_it_is_asked_for():
    record = [{"type": "Reduced", "function": {"opaque": "<function>"}}]
    ds = xr.Dataset(attrs={"call": json.dumps({"record": record})})
    with pytest.raises(ValueError, match=r"Argument `record.function` cannot be rebuilt: it was <function>"):
        load_call(ds)
