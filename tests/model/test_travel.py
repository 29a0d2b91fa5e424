"""A travel whose speed changes with the place: the seam for speed programmes."""

import dataclasses

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model import rail_frame
from slipperjax.model.travel import Travel

GAIN = 0.05
"""Speed gained per forcing period, in multiples of the speed at the start."""


class Accelerating(sj.Scene):
    """A scene whose speed rises in proportion to the distance."""

    def travel(self, phase):
        return Travel(self.speed * (1 + GAIN * phase), self.track.wavelength)


def accelerating(**values):
    return Accelerating(**vars(sj.paper_scene(**values)))


@pytest.mark.parametrize("solver", [None, "RK4", "Rodas4", "TwoStep", "Kvaerno5"])
def test_free_flight_takes_the_time_of_the_travel(solver):
    # so much play that nothing touches
    scene = accelerating(clearance=30e-3)
    start, periods = sj.Motion(v_y=0.1), 4
    end = sj.simulate(scene, periods, start=start, solver=solver, steps_per_period=100).end.motion
    seconds = float(scene.period) * np.log(1 + GAIN * periods) / GAIN
    # measured: 4e-8 with TwoStep, of second order; 1e-14 with the others
    np.testing.assert_allclose(float(end.y), 0.1 * seconds, rtol=1e-6 if solver == "TwoStep" else 1e-12)


def test_the_rail_moves_with_the_speed_at_the_place():
    slow, fast = rail_frame(sj.paper_scene(), 3.3), rail_frame(accelerating(), 3.3)
    np.testing.assert_allclose(fast.velocity, (1 + GAIN * 3.3) * slow.velocity, rtol=1e-14)


@pytest.mark.parametrize("memory", [sj.EventLatch(), sj.SmoothSwitch()])
def test_rates_and_reactions_are_those_of_a_constant_speed_there(memory):
    scene = dataclasses.replace(accelerating(), memory=memory)
    start, args = sj.initial_state(scene, sj.Motion(z=-8e-4, v_z=-0.5)), sj.Args(scene, 3.0)
    there = dataclasses.replace(sj.paper_scene(), memory=memory).replace(speed=scene.travel(3.25).speed)
    rates = [jax.tree.leaves(sj.vector_field(s)(0.25, start, sj.Args(s, 3.0)).motion) for s in (scene, there)]
    np.testing.assert_allclose(*rates, rtol=1e-12)
    forces = [sj.reactions(0.25, start, a).contact_force for a in (args, args._replace(scene=there))]
    assert np.max(forces[0]) > 0
    np.testing.assert_allclose(*forces, rtol=1e-12)
