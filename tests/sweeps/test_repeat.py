"""Results hold what they were made of: scenes come back exactly, and a run again gives the same bits."""

import json

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pint
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.datasets import load_call, run_attributes
from slipperjax.solvers.named import resolve_controller, resolve_solver

# other values than the nominal ones, other parts, and a start with closed contacts
SCENE = sj.paper_scene(restitution=0.85).replace(**{"section.play.2": 4.3e-4})
SEVERAL = sj.paper_scene(wavelengths=(8.0, 5.0)).replace(gravity=9.81, **{"section.play.2": 4.3e-4})
START = eqx.tree_at(
    lambda state: state.memory, sj.initial_state(SCENE, sj.table_2_start()), jnp.linspace(-0.5, 0.0, 20)
)
GRID = {"speed": [900.0, 1250.0], "v_y": [0.5, 0.4]}
SPEEDS = {"speed": [1250.0, 1500.0]}
# in the programs of test_sweep and test_exponents
TEN = dict(transient=10, periods=10)


def saved(ds, path):
    ds.to_netcdf(path, engine="h5netcdf")
    return xr.load_dataset(path, engine="h5netcdf")


def same_bits(first, again, names=None):
    """Equal in all variables, or in those of `names`, which a selection of cases has, too."""
    if names is None:
        assert set(first.data_vars) == set(again.data_vars)
        assert dict(first.sizes) == dict(again.sizes)
    for name in first.variables if names is None else names:
        np.testing.assert_array_equal(first[name].values, again[name].values, err_msg=str(name))


PAPER, SIDE = sj.paper_scene(), dict(product=False, record="strobe")
HISTORY = dict(record="history", transient=0, periods=20, saves_per_period=50)
EXPONENTS = dict(transient=200, periods=60, certify=False, steps_per_period=50)
RUNS = {
    "simulate": lambda: sj.simulate(PAPER, 20, steps_per_period=50, start=START).to_xarray(),
    "grid": lambda: sj.sweep(SCENE, GRID, record="strobe", transient=0, periods=10),
    "sections": lambda: sj.sweep(PAPER, SPEEDS, steps_per_period=[50, 100], **TEN),
    "history": lambda: sj.sweep(PAPER, {"speed": [400.0, 1250.0]}, **HISTORY),
    "side by side": lambda: sj.sweep(PAPER, SPEEDS | {"v_y": [0.5, 0.4]}, **SIDE, **TEN),
    "follow": lambda: sj.follow(PAPER, SPEEDS, record="strobe", **TEN),
    "exponents": lambda: sj.lyapunov_sweep(PAPER, SPEEDS, **EXPONENTS),
}


@pytest.fixture(scope="module")
def grid():
    return RUNS["grid"]()


@pytest.mark.parametrize("make", RUNS.values(), ids=RUNS.keys())
def test_a_file_is_computed_again_to_the_same_bits(make, tmp_path):
    first = saved(make(), tmp_path / "run.nc")
    again = sj.repeat(tmp_path / "run.nc")
    same_bits(first, again)
    for name in ("scene", "start", "call", "varied", "versions"):
        assert first.attrs[name] == again.attrs[name]


@pytest.mark.parametrize("name", ["simulate", "grid", "follow"])
def test_a_file_says_numbers_only_and_no_paths_or_executors(name, grid, tmp_path):
    ds = grid.copy() if name == "grid" else RUNS[name]()
    path = tmp_path / "anywhere.zarr"
    call = json.loads(ds.attrs["call"])
    others = dict(store=str(path), executor="x", chunk=1, workers=1, progress=True, start=None, other=1)
    for more in ({key: value} for key, value in others.items()):
        ds.attrs["call"] = json.dumps(call | more)
        with pytest.raises(ValueError, match=f"`source` must have a call of .*, but has {next(iter(more))}, too"):
            sj.repeat(ds)
    ds.attrs["call"] = json.dumps({"function": ["sweep"]})
    with pytest.raises(ValueError, match="`source` must be one of simulate, sweep, follow"):
        sj.repeat(ds)
    assert not list(tmp_path.iterdir())


def test_scenes_and_starts_come_back_exactly():
    """Whatever they are made of."""
    ds = xr.Dataset(attrs=run_attributes(SEVERAL, START, {"function": "simulate"}))
    assert eqx.tree_equal(sj.load_scene(ds), SEVERAL)
    for again, first in zip(jax.tree.leaves(sj.load_start(ds)), jax.tree.leaves(START), strict=True):
        np.testing.assert_array_equal(again, first)


def test_selections_are_rebuilt_or_refused(grid, tmp_path):
    ds = grid
    assert ds["strobe"].dims == ("speed", "start_v_y", "strobe_period", "coordinate")
    one = ds.isel(speed=1, start_v_y=1)
    back = saved(one, tmp_path / "one.nc")
    assert eqx.tree_equal(sj.load_scene(tmp_path / "one.nc"), SCENE.replace(speed=1250.0))
    assert sj.load_start(back).v_y == 0.4
    kept = ("strobe", "status", "steps_per_period")
    same_bits(sj.repeat(back).squeeze(), one, kept)
    part = ds.isel(speed=[1])
    same_bits(sj.repeat(part), part, kept)
    assert eqx.tree_equal(sj.load_scene(ds, speed=900.0), SCENE.replace(speed=900.0))
    assert eqx.tree_equal(sj.load_scene(ds, speed=pint.Quantity(3240.0, "km/h")), SCENE.replace(speed=900.0))
    lost = ds.isel(speed=0).drop_vars("speed")
    for wrong, words in (
        (lambda: sj.load_scene(ds), "`speed` must be given, as the result has 2 values"),
        (lambda: sj.load_scene(ds, speed=901.0), "`speed` must be one of the result's, but is 901"),
        (lambda: sj.load_scene(ds, length=0.2), "`length` must be one of what was varied"),
        (lambda: sj.load_scene(ds["strobe"] * 2), "no attribute `scene`"),
        (lambda: sj.load_scene(lost), "must have the coordinate `speed`"),
        (lambda: sj.repeat(lost), "must have the coordinate `speed`"),
        (lambda: sj.repeat(ds[["strobe"]]), "have the variable `steps_per_period`"),
        (lambda: sj.load_scene(3), "must be a TOML or netCDF file"),
        (lambda: sj.load_scene(__file__), "must be a TOML file or a netCDF file"),
    ):
        with pytest.raises(ValueError, match=r"must|no attribute") as caught:
            wrong()
        assert words in str(caught.value), str(caught.value)


def test_side_by_side_values_choose_one_case_and_a_part_of_a_followed_path_is_refused():
    ds = RUNS["side by side"]()
    assert float(sj.load_scene(ds, speed=1250.0).speed) == 1250.0
    assert sj.load_start(ds.isel(case=1)).v_y == 0.4
    with pytest.raises(ValueError, match="must be a whole result of `follow`"):
        sj.repeat(RUNS["follow"]().isel(speed=[0]))


def test_solvers_come_back_or_say_that_they_do_not():
    def kept(**call):
        return xr.Dataset(attrs=run_attributes(SCENE, sj.table_2_start(), {"function": "simulate", **call}))

    for name in ("RK4", "TwoStep", "Kvaerno3", "diffrax.Tsit5", sj.Rodas4()):
        solver = resolve_solver(SCENE, name)
        assert eqx.tree_equal(load_call(kept(solver=solver))["solver"], solver)
    controller = resolve_controller(sj.AdaptiveSteps(1e-4), sj.Tsit5())
    found = load_call(kept(stepsize_controller=controller))["stepsize_controller"]
    assert eqx.tree_equal(resolve_controller(found, sj.Tsit5()), controller)
    own = diffrax.PIDController(rtol=1e-4, atol=1e-6, norm=lambda x: sj.model.scaled_size(x.motion))
    ds = kept(stepsize_controller=own)
    assert eqx.tree_equal(sj.load_scene(ds), SCENE)
    with pytest.raises(
        ValueError, match=r"`stepsize_controller.norm` cannot be rebuilt: it was tests.sweeps.test_repeat"
    ):
        sj.repeat(ds)


@pytest.mark.slow
@pytest.mark.parametrize("how", [dict(stepsize_controller=sj.AdaptiveSteps(1e-4)), dict(probe=1)])
def test_other_runs_are_computed_again_to_the_same_bits(how):
    first = sj.simulate(SEVERAL, 2, solver="Tsit5", start=START, steps_per_period=100, **how).to_xarray()
    same_bits(first, sj.repeat(first))


def test_a_run_goes_on_where_another_ended():
    """Seventeen periods, and three of another seventeen, are the twenty of `test_sweep`, whose program they take."""
    scene, steps = sj.paper_scene(), dict(steps_per_period=50)
    whole, first = sj.simulate(scene, 20, **steps), sj.simulate(scene, 17, **steps)
    for start in (first, first.end):
        second = sj.simulate(scene, 17, start=start, **steps)
        # measured: 2e-16, because the phase counts from another period
        np.testing.assert_allclose(second.state.motion.v_y[150], whole.state.motion.v_y[-1], rtol=1e-12)
    # as a motion alone, contacts that are closed begin anew
    assert np.any(np.asarray(first.end.memory) < 0)
    swept = sj.sweep(scene, {"speed": [1250.0]}, record="strobe", transient=0, periods=10, start=first, **steps)
    np.testing.assert_allclose(
        swept["strobe"].sel(coordinate="v_y").values[0, 2], whole.state.motion.v_y[-1], rtol=1e-9
    )
