"""Results hold what they were made of: scenes come back exactly, and a run again gives the same bits."""

import json

import diffrax
import equinox as eqx
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.load import load_call
from slipperjax.solvers.named import resolve_solver

SCENE = sj.paper_scene(wavelengths=(8.0, 5.0)).replace(gravity=9.81, **{"section.play.2": 4.3e-4})
GRID = {"speed": [900.0, 1250.0], "clearance": [1e-3, 2e-3]}
SHORT = dict(transient=5, periods=3)


def saved(ds, path):
    ds.to_netcdf(path, engine="h5netcdf")
    return xr.load_dataset(path, engine="h5netcdf")


def same_bits(first, again, names=None):
    """Equal in all variables, or in those of `names`, which a selection of cases has, too."""
    if names is not None:
        for name in names:
            np.testing.assert_array_equal(first[name].values, again[name].values, err_msg=name)
        return
    assert set(first.data_vars) == set(again.data_vars)
    assert dict(first.sizes) == dict(again.sizes)
    for name in first.variables:
        np.testing.assert_array_equal(first[name].values, again[name].values, err_msg=str(name))


RUNS = {
    "simulate": lambda: sj.simulate(SCENE, 3, solver="Rodas4", start=sj.simulate(SCENE, 2), probe=1).to_xarray(),
    "adaptive": lambda: sj.simulate(
        SCENE, 2, solver="Tsit5", stepsize_controller=sj.AdaptiveSteps(1e-4), steps_per_period=100
    ).to_xarray(),
    "sections": lambda: sj.sweep(SCENE, GRID | {"v_y": [0.5, 0.4]}, **SHORT),
    "history": lambda: sj.sweep(SCENE, {"speed": [900.0, 1250.0]}, record="history", saves_per_period=10, **SHORT),
    "side by side": lambda: sj.sweep(
        SCENE, {"speed": [900.0, 1250.0], "v_y": [0.5, 0.4]}, product=False, record="strobe", **SHORT
    ),
    "follow": lambda: sj.follow(SCENE, {"clearance": [1e-3, 1.1e-3]}, record="strobe", **SHORT),
    "exponents": lambda: sj.lyapunov_sweep(SCENE, {"speed": [900.0, 910.0]}, transient=20, periods=20, certify=False),
}


@pytest.mark.parametrize("make", RUNS.values(), ids=RUNS.keys())
def test_a_file_is_computed_again_to_the_same_bits(make, tmp_path):
    first = saved(make(), tmp_path / "run.nc")
    again = sj.repeat(tmp_path / "run.nc")
    same_bits(first, again)
    for name in ("scene", "start", "call", "varied", "versions"):
        assert first.attrs[name] == again.attrs[name]
    if not json.loads(first.attrs["varied"]):
        assert eqx.tree_equal(sj.load_scene(tmp_path / "run.nc"), SCENE)


def test_selections_are_rebuilt_or_refused(tmp_path):
    ds = RUNS["sections"]()
    one = ds.isel(speed=1, clearance=0, start_v_y=1)
    back = saved(one, tmp_path / "one.nc")
    scene = sj.load_scene(tmp_path / "one.nc")
    assert eqx.tree_equal(scene, SCENE.replace(speed=1250.0, clearance=1e-3))
    assert sj.load_start(back).v_y == 0.4
    kept = ("strobe", "peak_force", "status", "steps_per_period")
    same_bits(sj.repeat(back).squeeze(), one, kept)
    part = ds.isel(speed=[1])
    same_bits(sj.repeat(part), part, kept)
    assert eqx.tree_equal(sj.load_scene(ds, speed=900.0, clearance=2e-3), SCENE.replace(speed=900.0, clearance=2e-3))
    for wrong, words in (
        (lambda: sj.load_scene(ds), "`speed` must be given, as the result has 2 values"),
        (lambda: sj.load_scene(ds, speed=901.0, clearance=1e-3), "`speed` must be one of the result's, but is 901"),
        (lambda: sj.load_scene(ds, length=0.2), "`length` must be one of what was varied"),
        (lambda: sj.load_scene(ds["strobe"] * 2), "no attribute `scene`"),
        (
            lambda: sj.load_scene(ds.isel(speed=0).drop_vars("speed"), clearance=1e-3),
            "must have the coordinate `speed`",
        ),
        (lambda: sj.repeat(ds.isel(speed=0).drop_vars("speed")), "must have the coordinate `speed`"),
        (lambda: sj.repeat(ds[["strobe"]]), "must have the variable `steps_per_period`"),
        (lambda: sj.load_scene(3), "must be a TOML or netCDF file"),
        (lambda: sj.load_scene(__file__), "must be a TOML file or a netCDF file"),
    ):
        with pytest.raises(ValueError, match=r"must|no attribute") as caught:
            wrong()
        assert words in str(caught.value), str(caught.value)


def test_side_by_side_values_choose_one_case():
    ds = RUNS["side by side"]()
    assert float(sj.load_scene(ds, speed=1250.0).speed) == 1250.0
    assert sj.load_start(ds.isel(case=1)).v_y == 0.4


def test_a_part_of_a_followed_path_is_refused():
    ds = RUNS["follow"]()
    with pytest.raises(ValueError, match="must be a whole result of `follow`"):
        sj.repeat(ds.isel(clearance=[0]))


def test_solvers_come_back_or_say_that_they_do_not():
    for solver in ("RK4", "TwoStep", "Kvaerno3", "diffrax.Tsit5", sj.ROS34PW2()):
        ds = sj.simulate(SCENE, 1, solver=solver, steps_per_period=50, loads=False).to_xarray()
        found = load_call(ds)["solver"]
        assert eqx.tree_equal(found, resolve_solver(SCENE, solver))
    controller = diffrax.PIDController(rtol=1e-4, atol=1e-6, norm=lambda x: sj.model.scaled_size(x.motion))
    ds = sj.simulate(
        SCENE, 1, solver="Tsit5", stepsize_controller=controller, steps_per_period=50, loads=False
    ).to_xarray()
    assert eqx.tree_equal(sj.load_scene(ds), SCENE)
    with pytest.raises(
        ValueError, match=r"`stepsize_controller.norm` cannot be rebuilt: it was tests.sweeps.test_repeat"
    ):
        sj.repeat(ds)


def test_a_run_goes_on_where_another_ended():
    scene = sj.paper_scene()
    whole = sj.simulate(scene, 6)
    first = sj.simulate(scene, 4)
    for start in (first, first.end):
        second = sj.simulate(scene, 2, start=start)
        # measured: 2e-16, because the phase counts from another period
        np.testing.assert_allclose(second.state.motion.v_y[-1], whole.state.motion.v_y[-1], rtol=1e-12)
    # as a motion alone, contacts that are closed begin anew
    assert np.any(np.asarray(first.end.memory) < 0)
    swept = sj.sweep(scene, {"speed": [1250.0]}, record="strobe", transient=0, periods=2, start=first)
    np.testing.assert_allclose(swept["v_y"].values[0, -1], whole.state.motion.v_y[-1], rtol=1e-9)
