"""A design as one dataset and file."""

import json

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.design.objectives import OBJECTIVES
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import Problem

from .bowl import evaluate

BOUNDS = {"clearance": (0.2e-3, 3e-3), "section.points.D.1": (0.01, 0.05)}


def searched(**options):
    return optimise_design(sj.paper_scene(), "peak_force", BOUNDS, steps_per_period=50, starts=2, **options)


@pytest.fixture
def best(monkeypatch):
    monkeypatch.setattr(Problem, "evaluate", evaluate)
    return searched(over={"speed": [1000.0, 1600.0]}, constraints={"drive_force": (None, 5.0)}, max_trials=4)


@pytest.mark.parametrize("calls", [0, 2])
def test_an_interrupted_search_keeps_its_best_design(monkeypatch, calls):
    trials = []

    def interrupted(self, designs, warm_start):
        trials.append(len(designs))
        if len(trials) > calls:
            raise KeyboardInterrupt
        return evaluate(self, designs, warm_start)

    monkeypatch.setattr(Problem, "evaluate", interrupted)
    with pytest.raises(sj.Interrupted) as stop:
        searched()
    assert trials[0] == 12  # four corners, and four designs for each start
    assert (stop.value.finished, stop.value.unit) == (2 * calls, "trials")  # of two starts
    design = stop.value.result
    assert (design is None) == (calls == 0)
    if design is not None:
        assert design.history.sizes["trial"] == stop.value.finished
        accepted = design.history["smooth"].where(design.history["taken"])
        assert design.smooth == float(accepted.min())


def test_tables_have_prefixes_and_units(best):
    ds = best.ds
    assert best.status == "infeasible"  # the bowl is above the limit of 5 N everywhere
    assert list(ds["variable"].values) == list(BOUNDS)
    assert list(ds["variable_unit"].values) == ["m", "m"]
    np.testing.assert_allclose(np.stack([ds["low"], ds["high"]], axis=1), list(BOUNDS.values()))
    for prefix, table in (("start", best.starts), ("trial", best.history)):
        for name in table.data_vars:
            xr.testing.assert_equal(ds[f"{prefix}_{name}"].variable, table[name].variable)
    np.testing.assert_allclose(ds["trial_objective"].max("case"), ds["trial_smooth"])  # equal in the bowl
    np.testing.assert_allclose(ds["gradient_stderr"], [[0, 0], [100, 100]])
    assert (ds["objective"].attrs["shown_unit"], ds["constraint_drive_force"].attrs["shown_unit"]) == ("kN", "N")
    assert ds["trial_smooth"].attrs["quantity"] == OBJECTIVES["peak_force"].smooth.name


def test_a_file_has_the_best_design_as_its_scene(best, tmp_path):
    best.write(tmp_path / "design.nc")
    with xr.open_dataset(tmp_path / "design.nc", engine="h5netcdf") as ds:
        xr.testing.assert_equal(ds.load(), best.ds)
    scene = sj.load(tmp_path / "design.nc").isel(case=1).scene
    for name, value in best.design.items():
        assert float(scene.value(name)) == pytest.approx(value)
    assert ds.attrs["objective"] == pytest.approx(best.objective)
    assert (ds.attrs["robust"], ds.attrs["status"]) == ("worst", best.status)
    assert json.loads(ds.attrs["varied"]) == ["speed"]
    assert json.loads(ds.attrs["call"])["constraints"] == [["drive_force", None, 5.0]]
    # no value of what was chosen or varied stands as that of all
    assert not [name for name in ds.attrs if name.startswith(("speed", "clearance"))]
