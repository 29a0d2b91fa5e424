"""Normal forms at a fold and a flip of a slipper, beside the motions near them."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.analysis.arclength import correct, evaluated
from slipperjax.analysis.normal_forms import form_at
from slipperjax.orbits import orbit_form
from slipperjax.orbits.motions import with_steps

pytestmark = pytest.mark.slow
STEPS = 9600
"""Steps at which the motions are followed: with 200, derivatives are as rough as the small changes sought."""


def at_event(label, bounds):
    """Equations with many steps, the node of an event, both eigenvectors, and the coefficients with errors."""
    branch = sj.continue_orbit(sj.paper_scene(speed=1250.0), "speed", bounds, until=(label,))
    event = branch.events_named(label)[0]
    coefficients, stderr = orbit_form(branch, event)
    node = branch.branch.nodes[event.point]
    equations = with_steps(branch.branch.equations, STEPS)
    form = form_at(equations, node.z, label)
    print(label, event.value, coefficients, stderr)
    return equations, node, form.left[0] * form.scale, form.right[0] / form.scale, coefficients, stderr


def test_the_form_of_a_fold_is_the_curvature_of_the_branch():
    equations, node, left, _, coefficients, stderr = at_event("LP", (1240.0, 2300.0))
    away = 0.01 * np.arange(-3, 4)
    points = [correct(equations, node.z + s * node.tangent, node.row, tolerance=1e-12).z for s in away]
    along = np.array([left @ (z - node.z)[:-1] for z in points])
    curve = np.polynomial.Polynomial.fit(along, [z[-1] for z in points], 4).convert().coef
    expected = -curve[2] * (left @ np.asarray(evaluated(equations, node.z).jacobian)[:, -1])
    print("by the branch", expected)
    assert abs(coefficients["a"] - expected) < 3 * stderr["a"]


def test_the_form_of_a_flip_is_the_width_of_the_branch_of_twice_the_period():
    equations, node, left, right, coefficients, stderr = at_event("PD", (1080.0, 1260.0))
    twice = dataclasses.replace(equations, intervals=2)
    way = np.append(right, 0.0)
    found = []
    for length in (0.004, 0.008):
        z = correct(twice, node.z + length * way, node.weights**2 * way, tolerance=1e-12, iterations=20).z
        width = left @ evaluated(equations, z).residual / 2
        row = np.eye(z.size)[-1]
        single = correct(equations, np.append(node.z[:-1], z[-1]), row, tolerance=1e-12, iterations=20)
        mu = np.linalg.eigvals(single.matrices[0])
        beyond = -1 - mu[np.argmin(np.abs(mu + 1))].real
        found.append((width**2, beyond / width**2))
        print("width", width, "at", z[-1], "b", beyond / width**2)
    # at width zero
    (near, one), (far, other) = found
    expected = (one * far - other * near) / (far - near)
    print("by the branch", expected)
    assert abs(coefficients["b"] - expected) < 3 * stderr["b"]
