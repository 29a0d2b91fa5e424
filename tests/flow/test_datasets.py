"""Datasets and their scenes."""

import tracemalloc

import equinox as eqx
import h5netcdf
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.datasets import run_attributes, scene_attributes
from slipperjax.model.parameters import PARAMETERS
from slipperjax.plots.style import case_title


@pytest.mark.parametrize(
    ("varied", "gone"),
    [
        ("speed", {"speed [m/s]"}),
        ("start_v_y", set()),
        ("slipper.mass", {"mass [kg]"}),
        ("inertia_y", {"inertia_y [kg m^2]"}),
        ("slipper.inertia.1", {"inertia_y [kg m^2]"}),
        ("section.play.2", {"clearance [m]"}),
        ("track.wavelengths.0", {"wavelengths [m]"}),
        ("gravity", set()),
    ],
)
def test_what_depends_on_a_varied_number_is_no_attribute(varied, gone):
    scene = sj.paper_scene()
    assert set(scene_attributes(scene)) - set(scene_attributes(scene, without=[varied])) == gone


def test_scenes_are_read_without_the_results_beside_them(tmp_path):
    """A variable of 1.6 GB that takes no room on the disk."""
    scene, start = sj.paper_scene(), sj.table_2_start()
    attributes = run_attributes(scene, start, {"function": "simulate"})
    xr.Dataset(attrs=attributes).to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with h5netcdf.File(tmp_path / "run.nc", "a") as file:
        file.dimensions["n"] = 200_000_000
        file.create_variable("unused", ("n",), "f8", chunks=(1_000_000,))
    tracemalloc.start()
    assert eqx.tree_equal(sj.load(tmp_path / "run.nc").scene, scene)
    assert eqx.tree_equal(sj.load(tmp_path / "run.nc").start, start)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


@pytest.mark.full
@pytest.mark.parametrize("wrong", [3, "x", "[[1]]", "null", '{"a": ['])
@pytest.mark.parametrize("name", ["scene", "start", "varied"])
def test_attributes_of_other_kinds_are_one_line(name, wrong):
    ds = sj.simulate(sj.paper_scene(), 1).ds
    ds.attrs[name] = wrong
    with pytest.raises(ValueError, match=r"^Argument `(source|scene)` must") as told:
        _ = sj.load(ds).scene
    assert "\n" not in str(told.value)


@pytest.mark.full
def test_joined_results_of_several_scenes_have_none(tmp_path):
    one, other = (
        sj.sweep(sj.paper_scene(clearance=c), {"speed": speeds}, transient=0, periods=1, steps_per_period=50).ds
        for c, speeds in ((1e-3, [1000.0, 1100.0]), (2e-3, [1300.0, 1400.0]))
    )
    clearance = lambda scene: float(PARAMETERS["clearance"].of(scene))
    same = xr.concat([one, one.assign_coords(speed=one.speed.values + 200.0)], "speed")
    assert clearance(sj.load(same).sel(speed=1300.0).scene) == 1e-3
    assert "clearance" in case_title(same)
    joined = xr.concat([one, other], "speed")
    beside = xr.concat([one, other.assign_coords(speed=one.speed.values)], "play")
    joined.to_netcdf(tmp_path / "joined.nc")
    for mixed in (joined, joined.isel(speed=[3]), beside, beside.isel(play=1), tmp_path / "joined.nc"):
        with pytest.raises(ValueError, match="`source` must be of one scene: these are joined from several"):
            _ = sj.load(mixed).scene
        with pytest.raises(ValueError, match="joined from several"):
            _ = sj.load(mixed).start
    assert clearance(sj.load(joined.isel(speed=slice(2))).sel(speed=1100.0).scene) == 1e-3
    assert clearance(sj.load(beside.isel(play=0)).sel(speed=1000.0).scene) == 1e-3
    assert case_title(joined) == ""
    runs = [sj.simulate(sj.paper_scene(speed=speed), 1, steps_per_period=50).ds for speed in (1e3, 2e3)]
    mixed = xr.concat(runs, "case", join="outer", coords="different", compat="equals")
    with pytest.raises(ValueError, match="joined from several"):
        _ = sj.load(mixed).scene
