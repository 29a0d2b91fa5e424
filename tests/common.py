"""Scales, reference data and small helpers that several tests share."""

import contextlib
import json
import math
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.layout import coordinates
from slipperjax.model.parameters import STARTS

DATA = Path(__file__).parent / "data"
# 1 mm, 10 mrad, 1 m/s, 10 rad/s: a scaled error of one is the size of the motion
SCALES = np.array([1e-3] * 2 + [1e-2] * 3 + [1.0] * 2 + [10.0] * 3)
STEPS = 200
PERIODS = 6
FINEST = 3200
# XLA options for programs that run once: a derivative takes half the time to compile, and is the same
QUICK = {"xla_backend_optimization_level": 0}


CORNERS = [(1.2, 0.9, "left"), (-1.2, 0.9, "left"), (1.2, -0.9, "right"), (-1.2, -0.9, "right")]
"""Places x and y [m] of the four slippers of `sled_on`, and their rails."""


def sled_on(corners=CORNERS, inertia=(150.0, 300.0, 350.0), height=-0.2, **parts):
    """A sled of 400 kg on slippers at some places, at a height below its centre of mass."""
    mounts = [sj.Mount(x, y, height, rail=rail) for x, y, rail in corners]
    return sj.Sled(400.0, inertia, mounts, **parts)


def narrow_sled():
    """A sled whose slippers are 1.2 m apart across the track."""
    return sled_on([(x, 2 / 3 * y, rail) for x, y, rail in CORNERS], (80.0, 320.0, 380.0), -0.25)


def among(known, *every_day, slow=()):
    """Parameters of a test from a table of them by name, marked full but for those of every day and slow ones."""
    mark = lambda name: () if name in every_day else pytest.mark.slow if name in slow else pytest.mark.full
    return [pytest.param(value, id=name, marks=mark(name)) for name, value in known.items()]


def growth(function, size):
    """The calls of functions in `function(4 * size)` beyond those of twice the size, over those of twice beyond once:
    2 where work grows as the size, 4 where it grows as its square, whatever else the machine does."""

    def calls(times):
        count = 0

        def counted(frame, event, argument):
            nonlocal count
            count += event in ("call", "c_call")

        before = sys.getprofile()
        sys.setprofile(counted)
        try:
            function(times * size)
        finally:
            sys.setprofile(before)
        return count

    function(size)  # what happens once, such as imports, is no growth
    once, twice, four_times = map(calls, (1, 2, 4))
    assert once < twice < four_times
    return (four_times - twice) / (twice - once)


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
    return coordinates(trajectory.state)


def fine(scene, start=None):
    """Six periods of 200 steps, all saved: one compilation serves many tests."""
    return sj.simulate(scene, PERIODS, steps_per_period=STEPS, saves_per_period=STEPS, start=start)


def finest(scene, start=None):
    """Six periods of 3200 steps, all saved: what shorter runs are compared with; one compilation, too."""
    return sj.simulate(scene, PERIODS, steps_per_period=FINEST, saves_per_period=FINEST, start=start)


LANES = 16
LANE = dict(
    speed=1250.0,
    clearance=1e-3,
    length=0.2,
    stiffness=1e8,
    restitution=0.9,
    amplitude=1e-3,
    roll_amplitude=math.radians(0.2),
    gravity=0.0,
    **dict(y=0.0, z=0.0, v_y=0.5, v_z=0.5, w_x=0.2, w_y=0.3, w_z=0.4),
)
"""A lane of `in_lanes` where nothing else is given: the paper's scene and start."""

MOTION = {
    "start_v_y": (-0.5, 0.5),
    "start_v_z": (-0.5, 0.5),
    "start_w_x": (-1.0, 1.0),
    "start_w_y": (-1.0, 1.0),
    "start_w_z": (-1.0, 1.0),
}
"""Velocities of starts that are drawn [m/s], [rad/s]."""


def lane_scene():
    """The scene of which the lanes are cases."""
    return sj.paper_scene().replace(gravity=0.0)


def lane_of(case):
    """The values of a lane that a case of reference data has."""
    return {name: case[name] for name in LANE if name in case}


def lane_grid(lanes):
    """The values of up to 16 lanes by name; the last is repeated."""
    lanes = [*lanes, *[lanes[-1]] * (LANES - len(lanes))]
    in_grid = lambda name: f"start_{name}" if f"start_{name}" in STARTS else name
    return {in_grid(name): [lane.get(name, default) for lane in lanes] for name, default in LANE.items()}


def in_lanes(lanes, steps, before=0):
    """States (lanes, 6, 10) at the ends of six periods after `before` (rounded up to tens), and status codes.

    One compilation serves any steps and any values of `LANE`, which each of the `lanes` may replace.
    """
    options = dict(product=False, record="strobe", transient=before, periods=PERIODS, chunk=LANES, workers=1)
    ds = sj.sweep(lane_scene(), lane_grid(lanes), steps_per_period=steps, **options)
    return ds["strobe"].values[: len(lanes)], ds["status"].values[: len(lanes)]


def scaled_errors(trajectory, case, every):
    """Worst scaled error of each period against a reference case."""
    got = columns(trajectory)[every::every]
    count = min(len(got), len(case["states"]))
    return np.max(np.abs(got[:count] - np.array(case["states"])[:count]) / SCALES, axis=1)


def elastic_energy(scene, gap):
    """Energy of the elastic part of each contact's force, the integral of K d^1.5 [J]."""
    return 0.4 * scene.contact.stiffness * jnp.maximum(-gap, 0.0) ** 2.5


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
