"""Normal forms at a fold and a flip of a slipper, beside the branches near them."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis
from slipperjax.analysis.arclength import correct, evaluated
from slipperjax.analysis.normal_forms import form_at
from slipperjax.orbits import orbit_form

pytestmark = pytest.mark.slow


def at_event(label, bounds):
    """The branch up to an event, the event, its node, its normal form's vectors, and the coefficients with errors."""
    branch = sj.continue_orbit(sj.paper_scene(speed=1250.0), "speed", bounds, until=(label,))
    event = branch.events_named(label)[0]
    node = branch.branch.nodes[event.point]
    found, stderr = orbit_form(branch, event)
    print(label, event.value, found, stderr)
    return branch, node, form_at(branch.branch.equations, node.z, label), found, stderr


def test_the_form_of_a_fold_is_the_curvature_of_the_branch():
    branch, node, form, found, stderr = at_event("LP", (1240.0, 2300.0))
    equations = branch.branch.equations
    left = form.left[0] * form.scale
    away = 0.01 * np.arange(-4, 5)
    points = [correct(equations, node.z + s * node.tangent, node.row, tolerance=1e-12).z for s in away]
    along = np.array([left @ (z - node.z)[:-1] for z in points])
    speeds = np.array([z[-1] for z in points])
    curvature = np.polynomial.Polynomial.fit(along, speeds, 4).convert().coef[2]
    slope = left @ np.asarray(evaluated(equations, node.z).jacobian)[:, -1]
    print("curvature", -curvature * slope)
    assert abs(found["a"] + curvature * slope) < 3 * stderr["a"]


def test_the_form_of_a_flip_is_the_width_of_the_branch_of_twice_the_period():
    branch, node, form, found, stderr = at_event("PD", (1080.0, 1260.0))
    (flip,) = [event for event in branch.branch.events if event.label == "PD"]
    left = form.left[0] * form.scale
    for length in (0.02, 0.01, 0.005):
        _, twice = analysis.switch(branch.branch, flip, length=length)
        now = evaluated(branch.branch.equations, twice.z)
        width = left @ now.residual / 2
        single = correct(branch.branch.equations, np.append(node.z[:-1], twice.z[-1]), np.eye(node.z.size)[-1], tolerance=1e-12)
        mu = np.linalg.eigvals(single.matrices[0])
        beyond = -1 - mu[np.argmin(np.abs(mu + 1))].real
        print("width", length, twice.z[-1], width, beyond, beyond / width**2)
    assert abs(found["b"] - beyond / width**2) < 3 * stderr["b"]
