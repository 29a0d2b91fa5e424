"""Planes through values of ensembles, with their standard errors."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.ensembles import EnsembleSettings, box_corners
from slipperjax.design.sensitivities import sensitivities

CORNERS = box_corners(2)
SIGNS = np.repeat(CORNERS, 8, axis=0)
PLANE = 3 + 2 * SIGNS[:, :1] - SIGNS[:, 1:]


def fit_plane(values):
    """A plane through runs, eight at each corner."""
    return EnsembleSettings().fit(CORNERS, values.reshape(len(CORNERS), 8, -1), np.arange(8))


@pytest.mark.parametrize(("parameters", "count"), [(1, 2), (2, 4), (3, 4), (5, 8), (12, 16)])
def test_slopes_by_corners_do_not_mix(parameters, count):
    corners = box_corners(parameters)
    assert set(np.unique(corners)) == {-1.0, 1.0}
    np.testing.assert_array_equal(corners.T @ corners, count * np.eye(parameters))
    np.testing.assert_array_equal(corners.sum(axis=0), 0)


def test_a_plane_without_noise_is_found_exactly_and_lost_runs_are_left_out():
    values = np.hstack([PLANE, 5 - SIGNS[:, 1:]])
    for lost in (0, 7):
        values[:lost] = np.nan
        planes, errors = fit_plane(values)
        np.testing.assert_allclose(planes, [[3, 2, -1], [5, 0, -1]], rtol=0, atol=1e-12)
        assert np.max(errors) < 1e-12
    assert np.isnan(fit_plane(values * np.nan)).all()


def test_two_standard_errors_hold_the_truth_in_95_percent_of_cases():
    draws = np.random.default_rng(1)
    inside = []
    for _ in range(2000):
        planes, errors = fit_plane(PLANE + draws.normal(size=(len(SIGNS), 1)))
        inside.append(np.abs(planes[0] - [3, 2, -1]) < 2 * errors[0])
    share = np.mean(inside, axis=0)
    # Student's t with 29 degrees of freedom: 94.5 %; measured 94.4, 94.7 and 94.0
    assert np.all(np.abs(share - 0.945) < 0.02), share


@pytest.mark.full
def test_exponents_are_averaged_too():
    """Measured 0.25 per period; runs of 40 periods scatter."""
    ensemble = EnsembleSettings(members=4, transient=20, periods=40)
    options = dict(method="ensemble", ensemble=ensemble, steps_per_period=50, transient=40)
    ds = sensitivities(sj.paper_scene(length=0.1), ["rms_a_z", "exponent"], ("length",), **options)
    assert 0.0 < float(ds["value"].sel(objective="exponent")) < 1.0
    assert np.isfinite(ds["gradient_stderr"]).all()
