"""Exponents of one slipper, with either contact memory."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status

from .nominal import SCENE, STEPS


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_a_periodic_motion_contracts_and_a_lost_one_says_so(nominal):
    options = dict(transient=0, periods=40, steps_per_period=STEPS)
    found = sj.lyapunov_spectrum(SCENE, 2, start=nominal.state, **options)
    assert found.status == Status.FINITE
    # a slow spiral over 40 periods: -0.036 +- 0.026
    assert not found.resolved
    # the leading pair of multipliers is complex: measured -0.0462 and -0.0472 by the weighted mean, -0.0465 by both
    np.testing.assert_allclose(found.weighted, float(nominal.exponent), atol=3e-3)
    np.testing.assert_allclose(found.per_second, found.per_period / 6.4e-3)
    lost = sj.lyapunov_spectrum(SCENE.replace(speed=1e-3), 2, **options)
    assert lost.status == Status.NOT_FINITE
    assert np.all(np.isnan(lost.per_period))
    assert not lost.resolved


@pytest.mark.slow
def test_errors_of_one_run_hold_after_a_band_of_chaos():
    """At 2100 m/s many motions spend some 2000 periods in a band, of which a shorter record tells nothing."""
    scene, velocity = sj.paper_scene(2100.0), np.random.default_rng(1).uniform(0.0, 1.0, (2, 32))
    run = lambda v_y, v_z: sj.lyapunov_spectrum(scene, start=sj.Motion(v_y=v_y, v_z=v_z), transient=6000)
    found = sj.jit(jax.vmap(run))(*velocity)
    assert not found.resolved.any()
    # 0.262 +- 0.001: the mean of the last 6000 of 12,000 periods of 32 motions
    error = np.abs(np.asarray(found.per_period)[:, 0] - 0.262) / found.stderr[:, 0]
    assert np.mean(error > 3) <= 0.1
    assert np.sqrt(np.mean(error**2)) < 1.2  # measured 0.94; 2.4 after 150 and 1.2 after 2000
