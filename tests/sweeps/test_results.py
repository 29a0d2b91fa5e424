"""Results hold what they were made of: scenes, starts and solvers come back exactly."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.datasets import load_call, run_attributes
from slipperjax.solvers.named import resolve_controller, resolve_solver

from ..families import settling, swept

# other values than the nominal ones, other parts, and a start with closed contacts
SCENE = sj.paper_scene(restitution=0.85).replace(**{"section.play.2": 4.3e-4})
SEVERAL = sj.paper_scene(wavelengths=(8.0, 5.0)).replace(gravity=9.81, **{"section.play.2": 4.3e-4})
START = eqx.tree_at(
    lambda state: state.memory, sj.initial_state(SCENE, sj.table_2_start()), jnp.linspace(-0.5, 0.0, 20)
)


def test_scenes_and_starts_come_back_exactly():
    """Whatever they are made of."""
    ds = xr.Dataset(attrs=run_attributes(SEVERAL, START, {"function": "simulate"}))
    assert eqx.tree_equal(sj.load(ds).scene, SEVERAL)
    for again, first in zip(jax.tree.leaves(sj.load(ds).start), jax.tree.leaves(START), strict=True):
        np.testing.assert_array_equal(again, first)


@pytest.mark.full
def test_selections_are_rebuilt_or_refused(tmp_path):
    ds = swept([900.0, 1250.0], [0.5, 0.4], scene=SCENE)
    assert ds["strobe"].dims == ("speed", "start_v_y", "strobe_period", "coordinate")
    ds.isel(speed=1, start_v_y=1).write(tmp_path / "one.nc")
    one = sj.load(tmp_path / "one.nc")
    assert eqx.tree_equal(one.scene, SCENE.replace(speed=1250.0))
    assert one.start.v_y == 0.4
    assert eqx.tree_equal(sj.load(ds).sel(speed=900.0).scene, SCENE.replace(speed=900.0))
    lost = ds.isel(speed=0).drop_vars("speed")
    for wrong, words in (
        (lambda: sj.load(ds).scene, "`speed` must have one value, but has 2: select a case, as by .isel(speed=0)"),
        (lambda: sj.load(ds["strobe"] * 2).scene, "no attribute `call`"),
        (lambda: sj.load(lost).scene, "must have the coordinate `speed`"),
        (lambda: sj.load(3), "must be a TOML or netCDF file"),
        (lambda: sj.load(__file__), "no TOML file or netCDF file"),
    ):
        with pytest.raises(ValueError, match=r"must|no ") as caught:
            wrong()
        assert words in str(caught.value), str(caught.value)


@pytest.mark.full
def test_side_by_side_values_choose_one_case():
    ds = swept([1250.0, 1500.0], [0.5, 0.4], [0.0, 0.0], product=False)
    assert float(sj.load(ds).sel(speed=1250.0).scene.speed) == 1250.0
    assert sj.load(ds.isel(case=1)).start.v_y == 0.4


def test_solvers_come_back_or_say_that_they_do_not():
    def kept(**call):
        return xr.Dataset(attrs=run_attributes(SCENE, sj.table_2_start(), {"function": "simulate", **call}))

    for name in ("RK4", "TwoStep", "Kvaerno3", "diffrax.Tsit5", sj.solvers.Rodas4()):
        solver = resolve_solver(SCENE, name)
        assert eqx.tree_equal(load_call(kept(solver=solver))["solver"], solver)
    controller = resolve_controller(sj.solvers.AdaptiveSteps(1e-4), sj.solvers.Tsit5())
    found = load_call(kept(stepsize_controller=controller))["stepsize_controller"]
    assert eqx.tree_equal(resolve_controller(found, sj.solvers.Tsit5()), controller)
    own = diffrax.PIDController(rtol=1e-4, atol=1e-6, norm=lambda x: sj.model.scaled_size(x.motion))
    ds = kept(stepsize_controller=own)
    assert eqx.tree_equal(sj.load(ds).scene, SCENE)
    with pytest.raises(ValueError, match=r"`stepsize_controller.norm` cannot be rebuilt: it was tests.sweeps"):
        load_call(ds)


@pytest.mark.full
def test_a_run_goes_on_where_another_ended():
    """Seventeen periods, and three of another seventeen, are twenty."""
    scene, steps, last = sj.paper_scene(), dict(steps_per_period=50), settling().state.motion.v_y[-1]
    first = sj.simulate(scene, 17, **steps)
    for start in (first, first.end):
        second = sj.simulate(scene, 17, start=start, **steps)
        # measured: 2e-16, because the phase counts from another period
        np.testing.assert_allclose(second.state.motion.v_y[150], last, rtol=1e-12)
    # as a motion alone, contacts that are closed begin anew
    assert np.any(np.asarray(first.end.memory) < 0)
    m = first.end.motion
    ds = swept([1250.0], [float(m.v_y)], [float(m.z)], start=first, transient=0)
    np.testing.assert_allclose(ds["strobe"].sel(coordinate="v_y").values[0, 2], last, rtol=1e-9)
