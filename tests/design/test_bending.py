"""Designs of slippers on rails that bend, which are judged by ensembles of runs."""

import dataclasses

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design import EnsembleSettings, RailEnsemble, sensitivities
from slipperjax.model.kinematics import disturbances

from ..model.test_beam import beam

pytestmark = pytest.mark.full
STEPS = dict(steps_per_period=50)
BENDS = dataclasses.replace(sj.paper_scene(600.0), beam=beam(ring=16.0))
RANDOM = dataclasses.replace(BENDS, track=sj.RandomTrack.sled(length=250.0))
SIZES = dict(transient=0, periods=1)
NUMBER = sj.design.OBJECTIVES["rms_a_z"]


def means(scene, clearance, rails):
    """Mean of the number over two disturbed starts, on each rail one, for each of some clearances."""
    start = np.array(jax.tree.leaves(sj.table_2_start()))
    disturbed = start + disturbances(scene, 0.1, 2, np.random.default_rng(0))
    names = ("v_y", "v_z", "w_x", "w_y", "w_z")
    grid = {f"start_{name}": disturbed[:, 5 + k] for k, name in enumerate(names)} | rails
    grid = {name: np.tile(values, len(clearance)) for name, values in grid.items()}
    grid["clearance"] = np.repeat(clearance, 2)
    ds = sj.sweep(scene, grid, product=False, record=NUMBER, probe=False, **SIZES, **STEPS)
    return ds[NUMBER.name].values.reshape(-1, 2).mean(axis=1)


@pytest.mark.parametrize(
    ("scene", "ensemble", "rails", "error"),
    [
        # measured 6e-4
        (BENDS, EnsembleSettings(members=4, **SIZES), {}, 2e-3),
        # measured 0.075, with runs as far apart as 10 % of the clearance
        (RANDOM, RailEnsemble(rails=2, quantile=None, **SIZES), {"track.seed": np.arange(2.0)}, 0.15),
    ],
)
def test_slopes_of_ensembles(scene, ensemble, rails, error):
    """Against central differences of a sweep: as wide, and a hundredth as wide."""
    found = sensitivities(scene, NUMBER, ["clearance"], method="ensemble", ensemble=ensemble, **STEPS)
    clearance = float(scene.value("clearance"))
    reach = ensemble.relative_reach * clearance
    low, below, above, high = map(float, means(scene, clearance + reach * np.array([-1.0, -0.01, 0.01, 1.0]), rails))
    slope = float(found["gradient"].squeeze())
    print(f"\nslope: {slope / (above - below) * 0.02 * reach - 1:.1e} from that of finer differences")
    # 1e-9 by another batch's rounding
    assert slope == pytest.approx((high - low) / (2 * reach), rel=1e-6)
    assert slope == pytest.approx((above - below) / (0.02 * reach), rel=error)
    assert float(found["value"].squeeze()) == pytest.approx((low + high) / 2, rel=1e-9)


def test_a_search_on_a_rail_that_recurs():
    """Orbits are not searched there: their Jacobians by all waves would take hours."""
    few = EnsembleSettings(members=4, transient=1, periods=2)
    options = dict(ensemble=few, starts=1, max_trials=2, progress=False)
    design = sj.optimise_design(BENDS, NUMBER, {"clearance": (0.5e-3, 2e-3)}, **options, **STEPS)
    assert design.regime == ["unresolved"]
    # a better design than the first one: 292 m/s^2 of 361
    assert 0 < design.smooth < design.history["smooth"].values[0]
