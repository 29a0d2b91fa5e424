"""Points of codimension two of a slipper: the stated errors of their places, beside the places with more steps."""

import pytest

import slipperjax as sj
from slipperjax.orbits import continue_event

pytestmark = pytest.mark.slow


def resonance(steps):
    """The strong resonance 1:3 on the curve of Neimark-Sackers over play and speed."""
    scene = sj.paper_scene(speed=1250.0, clearance=3.1e-3)
    branch = sj.continue_orbit(scene, "clearance", (3.05e-3, 3.3e-3), steps_per_period=steps)
    (birth,) = branch.events_named("NS")
    curve = continue_event(branch, birth, "speed", (1247.0, 1250.5), first_bounds=(3.15e-3, 3.25e-3))
    (event,) = [event for event in curve.events if event.label == "R3"]
    print(steps, event.values, event.stderr)
    return event


def test_the_stated_error_of_a_strong_resonance_covers_the_true_one():
    coarse, fine = (resonance(steps) for steps in (100, 400))
    for name, found, right in zip(("clearance", "speed"), coarse.values, fine.values, strict=True):
        assert abs(found - right) < 2 * (coarse.stderr[name] + fine.stderr[name])
        # an error that covers everything would say nothing
        assert coarse.stderr[name] < 5 * abs(found - right)
