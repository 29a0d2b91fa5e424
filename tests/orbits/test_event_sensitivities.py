"""Derivatives of the places of bifurcations, and their stated errors."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.orbits import event_sensitivities

SCENE, NAMES = sj.paper_scene(), ["length", "restitution", "stiffness"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("label", "parameter", "bounds"),
    [("PD", "speed", (1080.0, 1260.0)), ("LP", "speed", (1240.0, 2300.0)), ("NS", "clearance", (0.9e-3, 3.4e-3))],
)
def test_stated_errors_of_the_places_and_their_derivatives_hold(label, parameter, bounds):
    """Against eight times as many steps; a second difference is of places, found anew with other parameters."""

    def found(steps, scene=SCENE):
        branch = sj.continue_orbit(scene, parameter, bounds, steps_per_period=steps)
        return branch, branch.events_named(label)[0]

    ds, truth = (event_sensitivities(*found(steps), NAMES) for steps in (50, 400))
    errors = abs(ds - truth)[["value", "gradient"]]
    stated, true = float(ds["stderr"]), float(errors["value"])
    assert true <= 3 * stated
    for name in NAMES:
        of = lambda data, key, name=name: float(data[key].sel(parameter=name))
        stated, true = of(ds, "gradient_stderr"), of(errors, "gradient")
        assert true <= 3 * stated
    # places found anew, 0.2 % of the restitution apart
    low, high = (found(400, SCENE.replace(restitution=0.9 * (1 + side * 1e-3)))[1].value for side in (-1, 1))
    np.testing.assert_allclose((high - low) / 1.8e-3, truth["gradient"].sel(parameter="restitution"), rtol=1e-2)
