"""Designs compared over the same rails and starts: which runs are made, and what is said of them."""

import dataclasses
import json
import re

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.plots.comparisons import comparison
from slipperjax.results.comparisons import summary as verdict, tables
from slipperjax.sweeps import over_rails
from slipperjax.sweeps.compare import _compared, _numbers
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.windows import run_record

SCENE = dataclasses.replace(sj.paper_scene(900.0), track=sj.RandomTrack.sled(length=400.0), gravity=9.81)
DESIGNS = {"clearance": [0.8e-3, 1.6e-3]}
ON_TWO = sj.Sled(
    mass=28.0,
    inertia=(10.0, 5.0, 15.0),
    mounts=[sj.Mount(0.0, y, 0.0, rail=rail) for y, rail in ((0.6, "left"), (-0.6, "right"))],
)


@pytest.fixture(autouse=True)
def _closed():
    """Lets no figure be, which other tests would count."""
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def compared():
    return sj.compare(SCENE, DESIGNS, length=24.0, window=8.0, rails=8, starts=2, quantiles=[0.5])


@pytest.mark.full
def test_runs_are_those_of_each_rail_and_start_and_quantiles_those_of_all_runs(compared):
    assert compared["runs"].dims == ("clearance", "rail", "start")
    grid = {"clearance": [1.6e-3], "track.seed": [2.0]}
    alone = sj.run(SCENE, grid, length=24.0, window=8.0, record="peak_slipper_force")
    # at rest comes first, and seeds follow that of the track; equal up to another batch's rounding
    np.testing.assert_allclose(compared["runs"][1, 2, 0], np.abs(alone["peak_slipper_force"]).max(), rtol=1e-6)
    # another start is another motion: measured 0.3 N and more
    assert np.all(np.abs(np.diff(compared["runs"], axis=2)) > 0.1)
    assert compared["counted"].all()
    assert not compared["status"].any()
    values = np.quantile(compared["runs"].values.reshape(2, 16), [0.5], axis=1, method="median_unbiased").T
    np.testing.assert_allclose(compared["value"], values)
    best = int(np.argmin(values[:, 0]))
    assert np.flatnonzero(compared["best"]).tolist() == [best]
    np.testing.assert_allclose(compared["difference"], values - values[best])
    assert np.all(compared["difference_stderr"][best] == 0)
    assert np.all(compared["difference_stderr"][1 - best] > 0)


@pytest.mark.full
@pytest.mark.parametrize("two_rails", [False, True])
def test_the_first_rail_of_a_survey_is_the_survey(two_rails):
    distance = np.linspace(0.0, 60.0, 601)
    rng = np.random.default_rng(0)
    wave = lambda: 3e-4 * np.sin(2 * np.pi * distance / 5.0 + rng.uniform(0, 6)) + 2e-5 * rng.normal(size=601)
    survey = sj.model.SampledTrack(distance, wave(), wave())
    if two_rails:
        survey = sj.model.TwoRails(survey, sj.model.SampledTrack(distance, wave(), wave()))
    scene = dataclasses.replace(SCENE, track=survey, slipper=ON_TWO if two_rails else SCENE.slipper)
    options = dict(length=16.0, window=8.0, steps_per_period=400)
    ds = sj.compare(scene, DESIGNS, rails=8, quantiles=[0.5], **options)
    alone = np.abs(sj.run(scene, DESIGNS, record="peak_slipper_force", **options)["peak_slipper_force"])
    highest = alone.max(set(alone.dims) - {"clearance"})
    np.testing.assert_allclose(ds["runs"][:, 0, 0], highest, rtol=1e-6)
    assert np.all(np.abs(ds["runs"][:, 1, 0] - highest) > 1.0)
    assert float(ds.isel(clearance=1).scene.value("clearance")) == pytest.approx(DESIGNS["clearance"][1])


@pytest.mark.full
def test_lost_runs_are_repeated_with_more_steps():
    stiff = SCENE.replace(stiffness=1e10)
    options = dict(length=24.0, window=8.0, record="peak_force")
    # too few for all impacts
    coarse = sj.run(stiff, DESIGNS, steps_per_period=40, **options)
    assert np.all(coarse["status"] == sj.Status.TOO_FEW_STEPS)
    # and none of their numbers is to be trusted
    assert all(np.isnan(values).all() for values in coarse.values() if values.dtype == float)
    ds = sj.compare(stiff, DESIGNS, steps_per_period=40, rails=8, quantiles=[0.5], **options)
    assert not ds["status"].any()
    finer = sj.run(stiff, DESIGNS, steps_per_period=80, **options)["peak_force"].max(("distance", "end", "point"))
    np.testing.assert_allclose(ds["runs"][:, 0, 0], finer, rtol=1e-6)


@pytest.mark.parametrize(
    ("record", "dims", "joined"),
    [
        ("contact_fraction", ("end", "point"), np.mean),
        ("slipper_force", ("slipper", "direction"), np.mean),
        ("rms_a_z", (), lambda values, axis: np.sqrt(np.mean(np.square(values), axis))),
        ("impacts", ("end", "point"), np.sum),
        ("smallest_z", (), np.min),
        ("peak_force", ("end", "point"), np.max),
        ("peak_slipper_force", ("slipper", "axis"), lambda values, axis: np.max(np.abs(values), axis)),
    ],
)
def test_a_run_has_the_number_that_its_windows_have_together(record, dims, joined):
    values = np.random.default_rng(0).uniform(-1.0, 1.0, size=(24, 3, *[2 for _ in dims]))
    values = np.abs(values) if record == "rms_a_z" else values
    ds = xr.Dataset({record: (("distance", "case", *dims), values), "status": ("case", np.zeros(3, int))})
    expected = joined(values, axis=0).reshape(3, -1).max(axis=1)
    np.testing.assert_allclose(_numbers(run_record(record), ds), expected, rtol=1e-12)


def test_power_means_of_windows_are_joined_as_power_means():
    smooth = sj.flow.RECORDS["peak_force"].smooth
    values = np.random.default_rng(0).uniform(0.0, 1e5, size=(24, 3))
    values[:, 0] = 0.0
    expected = np.mean(values**32, axis=0) ** (1 / 32)
    np.testing.assert_allclose(smooth.join.whole(values), expected, rtol=1e-12)


def drawn(rails, starts, seed, shift=1.0):
    """Runs of two designs, of which those on one rail have most in common."""
    rng = np.random.default_rng(seed)
    common = rng.gumbel(size=(1, rails, 1)) + 0.3 * rng.normal(size=(1, rails, starts))
    return 10 + common + shift * np.array([0.0, 1.0])[:, None, None] + 0.3 * rng.normal(size=(2, rails, starts))


def made(numbers, seed=0, shares=(0.5, 0.95)):
    ds = xr.Dataset({"peak_force": ((), 0.0, {"units": "N", "quantity": "peak_force"})})
    status = np.where(np.isnan(numbers), 1, 0)
    found = _compared(Grid(SCENE, DESIGNS), numbers, status, ds, "peak_force", shares, seed)
    return found.assign_attrs(call='{"function": "compare"}')


def test_a_comparison_varies_its_designs_and_no_rails():
    assert json.loads(made(drawn(8, 1, 5), shares=[0.5]).attrs["varied"]) == list(DESIGNS)


def test_equal_runs_that_share_their_rails_are_worth_one():
    numbers = drawn(80, 1, 5)
    one, four = made(numbers), made(np.tile(numbers, (1, 1, 4)))
    for name in ("value", "stderr", "low", "high", "difference_low", "difference_high"):
        np.testing.assert_allclose(four[name], one[name], rtol=1e-12)


def test_runs_over_one_rail_are_drawn_by_their_starts():
    numbers = drawn(1, 100, 3)
    ds = made(numbers)
    alone = over_rails(xr.DataArray(numbers[:, 0], dims=("clearance", "track.seed"), attrs={"units": "N"}), 0.95)
    for name in ("value", "stderr", "low", "high", "difference", "difference_stderr"):
        np.testing.assert_allclose(ds[name].sel(quantile=0.95), alone[name])


def test_words_tables_pictures_and_reports_say_which_is_better_and_how_sure(tmp_path):
    ds = made(1e3 * drawn(100, 2, 5))
    lines = verdict(ds)
    better = "clearance 0.8 mm is better than clearance 1.6 mm: by 0.56 +- 0.24 kN in the 95 % quantile"
    assert lines[0].startswith(better)
    assert lines[0].endswith(" kN in the median")
    assert lines[1] == "highest normal force of a contact point on 100 rails from 2 starts each:"
    assert len(lines) == 4
    inches = verdict(ds, ["in", "lbf"])
    assert inches[0].startswith("clearance 0.0315 in is better than clearance 0.06299 in: by 125 +- 54 lbf")
    assert " cannot be told from " in verdict(made(1e3 * drawn(100, 2, 5, shift=0.0)))[0]
    frame = tables(ds)["designs"]
    assert frame["design"].tolist() == ["clearance 0.8 mm"] * 2 + ["clearance 1.6 mm"] * 2
    np.testing.assert_allclose(frame["value [kN]"], ds["value"].values.ravel() / 1e3)
    left, right = comparison(ds)
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["clearance 0.8 mm", "clearance 1.6 mm"]
    assert right.get_xlabel() == "difference from the best [kN]"
    for end in (".pdf", ".csv", ".xlsx"):
        file = tmp_path / f"designs{end}"
        assert sj.Result(ds).write(file) == f"wrote {file}"
    assert len(re.findall(rb"/Type /Page\b", (tmp_path / "designs.pdf").read_bytes())) == 2
    sheets = pd.read_excel(tmp_path / "designs.xlsx", sheet_name=None)
    assert sheets["summary"]["summary"].tolist() == lines
    pd.testing.assert_frame_equal(sheets["designs"], pd.read_csv(tmp_path / "designs.csv"), rtol=1e-8)


def test_a_rail_with_a_lost_run_is_left_out_for_all_designs():
    numbers = drawn(100, 2, 5)
    # high ones, so that they would count if they were left in
    numbers[0, 3:5] += 50.0
    whole = made(np.delete(numbers, [3, 4], axis=1))
    numbers[1, 3, 0] = numbers[1, 4, 1] = np.nan
    ds = made(numbers)
    for name in ("value", "stderr", "low", "high", "difference", "difference_low"):
        np.testing.assert_array_equal(ds[name], whole[name])
    assert np.flatnonzero(~ds["counted"].all("start")).tolist() == [3, 4]
    lines = verdict(ds)
    assert lines[0].startswith("status of 2 of 400 runs: not finite: ")
    assert lines[0].endswith(": clearance 1.6 mm rail=3 start=0 and clearance 1.6 mm rail=4 start=1")
    assert lines[1] == "2 of 100 rails are left out for all designs, because a run is lost there"
    assert lines[2].startswith("clearance 0.8 mm is better than")
    drawn_runs = comparison(ds)[0].lines[0].get_xdata()
    assert len(drawn_runs) == 196


def test_too_few_rails_have_no_quantile():
    numbers = drawn(90, 1, 5)
    numbers[0, :11] = np.nan
    ds = made(numbers)
    # 79 rails have a median, but no quantile 0.95, which decides
    assert np.isfinite(ds["value"][:, 0]).all()
    assert np.isnan(ds["value"][:, 1]).all()
    lines = verdict(ds)
    assert lines[0].endswith("clearance 0.8 mm rail=4 start=0 and 6 more")
    assert lines[-1] == "too many runs are lost to tell which design is better"
    # a median that decides is known
    by_median = "\n".join(verdict(made(numbers, shares=(0.95, 0.5))))
    assert "nan" not in by_median
    assert " kN in the median, an unknown value in the 95 % quantile" in by_median


BEYOND = "`{}` must be {} or more for the quantile {}, with 4 of them beyond it, but is {}"
BAD = {
    # runs over one rail are not independent
    BEYOND.format("rails", 80, 0.95, 32): dict(rails=32, starts=4),
    BEYOND.format("rails", 8, 0.5, 1): dict(rails=1),
    BEYOND.format("rails", 40, 0.1, 39): dict(quantiles=(0.1,), rails=39),
    BEYOND.format("starts", 8, 0.5, 7): dict(rails=1, starts=7),
    "`record` must be the name of a number, such as peak_slipper_force, but is 'speed'": dict(record="speed"),
    "`record` must be a number that several windows have in common": dict(record="peak_slipper_distance"),
    "Argument `clearence` is no parameter": dict(designs={"clearence": [1e-3]}),
    "`designs` must be no starts where these are drawn": dict(designs={"start_v_y": [0.0, 1.0]}, starts=2),
    "Argument `quantile` must be a share between 0 and 1": dict(quantiles=(0.5, 1.5)),
    "Argument `quantiles` must be a list of shares": dict(quantiles=0.5),
    "`rails` must be 1 on a track that is neither random nor a survey": dict(scene=sj.paper_scene()),
    "Argument `length` must be positive": dict(length=-1.0),
}


@pytest.mark.parametrize("words", BAD)
def test_bad_comparisons_name_what_is_wrong(words):
    with pytest.raises(ValueError, match=words):
        sj.compare(**dict(scene=SCENE, designs=DESIGNS, length=8.0, rails=80) | BAD[words])
