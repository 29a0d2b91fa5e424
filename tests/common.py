"""Scales, reference data and small helpers that several tests share."""

import contextlib
import json
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import slipperjax as sj

DATA = Path(__file__).parent / "data"
# 1 mm, 10 mrad, 1 m/s, 10 rad/s: a scaled error of one is the size of the motion
SCALES = np.array([1e-3] * 2 + [1e-2] * 3 + [1.0] * 2 + [10.0] * 3)
STEPS = 200
PERIODS = 6


def cases(name):
    return json.loads((DATA / f"{name}.json").read_text())["cases"]


def scene_of(case, **options):
    waves = [w for w in (case.get("wavelength", 8), case.get("wavelength2")) if w]
    return sj.paper_scene(
        case["speed"],
        case["clearance"],
        case["length"],
        stiffness=case.get("stiffness", 1e8),
        restitution=case.get("restitution", 0.9),
        wavelengths=waves,
        roll_amplitude=math.radians(case.get("roll_amplitude_deg", 0.2)),
        **options,
    )


def columns(trajectory):
    """The ten columns of the reference data, (saves, 10)."""
    m = trajectory.state.motion
    return np.stack([m.y, m.z, *trajectory.euler_angles, m.v_y, m.v_z, m.w_x, m.w_y, m.w_z], axis=-1)


def fine(scene, start=None):
    """Six periods of 200 steps, all saved: one compilation serves many tests."""
    return sj.simulate(scene, PERIODS, steps_per_period=STEPS, saves_per_period=STEPS, start=start)


def scaled_errors(trajectory, case, every):
    """Worst scaled error of each period against a reference case."""
    got = columns(trajectory)[every::every]
    count = min(len(got), len(case["states"]))
    return np.max(np.abs(got[:count] - np.array(case["states"])[:count]) / SCALES, axis=1)


def elastic_energy(scene, gap):
    """Energy of the elastic part of each contact's force, the integral of K d^1.5 [J]."""
    return 0.4 * scene.contact.stiffness * jnp.maximum(-gap, 0.0) ** 2.5


def rebound(factor, stored=0.0):
    """Rebound over approach speed e of F = K d^1.5 (1 + c v/v0), from a depth that stores `stored` times m v0^2 / 2.

    m v dv = -K d^1.5 (1 + c v/v0) dd gives: integral of u / (1 + c u) from -e to 1 is -stored / 2.
    """
    if factor == 0:
        return math.sqrt(1 + stored)
    primitive = lambda u: u / factor - np.log1p(factor * u) / factor**2
    return brentq(lambda e: primitive(1.0) - primitive(-e) + stored / 2, 0.0, min(9.0, (1 - 1e-12) / factor))


@contextlib.contextmanager
def compilations():
    """A list to which the seconds of every compilation in the block are added."""
    seconds = []

    def listen(event, duration, **_):
        if event == "/jax/core/compile/backend_compile_duration":
            seconds.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seconds
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
