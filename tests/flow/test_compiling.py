"""Calls from Python compile once: the next ones with other numbers only run."""

import jax
import pytest

import slipperjax as sj

from ..common import compilations, fine
from ..orbits.nominal import STEPS

START = sj.table_2_start()


def scene_of(speed):
    """A scene that compiles soon."""
    plain = sj.paper_scene()
    return sj.Scene(speed, plain.slipper, plain.section, sj.model.StraightTrack(), sj.model.HertzSpring(1e8))


def state_of(speed):
    return sj.initial_state(scene_of(speed), START)


def forces(speed):
    return sj.model.reactions(0.1, state_of(speed), sj.model.Args(scene_of(speed))).contact_force


def mapped(speed):
    return sj.period_map(scene_of(speed), state_of(speed), steps_per_period=20).motion.v_y


def slope(speed):
    scene, state = scene_of(speed), state_of(speed)
    end = lambda c: sj.period_map(scene.replace(clearance=c), state, steps_per_period=20).motion.v_y
    return jax.jacfwd(end)(1e-3)


def simulated(speed):
    return fine(sj.paper_scene(speed)).status


def orbit(speed):
    return sj.periodic_orbit(sj.paper_scene(speed), steps_per_period=STEPS, transient=20).residual


@pytest.mark.full
@pytest.mark.parametrize("call", [state_of, forces, mapped, slope, simulated, orbit], ids=lambda f: f.__name__)
def test_the_second_call_compiles_nothing(call):
    call(900.0)
    call(1000.0)  # small programs for numbers that are arrays from here on
    with compilations() as compiled:
        jax.block_until_ready(call(1250.0))
        assert not compiled
        jax.block_until_ready(jax.jit(lambda x: x + len(compiled) + 1.25)(1.0))  # what is listened to does happen
        assert compiled
