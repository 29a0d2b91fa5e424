"""What rails of samples cost, and do to slippers: `pytest -m benchmark -s tests/benchmarks/test_rails.py`."""

import dataclasses
import functools

import numpy as np
import pytest

import slipperjax as sj

from .timing import in_turns

pytestmark = pytest.mark.benchmark
SCENE = sj.paper_scene(1000.0)
RAIL = dataclasses.replace(SCENE, track=sj.RandomTrack.sled(length=800.0))
SAMPLED = sj.model.SampledTrack(
    np.linspace(0, 8, 65), *[1e-3 * np.sin(np.linspace(0, 2 * np.pi, 65))] * 2, ends="repeat"
)
OPTIONS = dict(transient=0, periods=90, steps_per_period=80, record="peak_force")


def test_sweeps_on_rails_beside_the_harmonic_one():
    cases, speeds = {"restitution": np.linspace(0.85, 0.95, 200)}, {"speed": np.linspace(800.0, 1400.0, 241)}
    kinds = {
        "harmonic, 200 cases": (SCENE, cases),
        "one random rail, 200 cases": (RAIL, cases),
        "200 random rails": (RAIL, {"track.seed": np.arange(200.0)}),
        "harmonic, 241 speeds": (SCENE, speeds),
        "sampled sine, 241 speeds": (dataclasses.replace(SCENE, track=SAMPLED), speeds),
    }
    runs = {name: lambda of=of: sj.sweep(*of, **OPTIONS) for name, of in kinds.items()}
    medians = {name: timed.median for name, timed in in_turns(runs, 5).items()}
    for name, base in zip(kinds, ["harmonic, 200 cases"] * 3 + ["harmonic, 241 speeds"] * 2, strict=True):
        print(f"{name}: {medians[name]:.2f} s, {medians[name] / medians[base]:.2f} of the harmonic one")


def test_sweeps_on_rails_that_bend():
    # long enough for the time before the first step to count little
    options = dict(transient=0, periods=100, steps_per_period=100, record="strobe", workers=1)
    for name, grid in (("restitution", np.linspace(0.8, 0.95, 64)), ("speed", np.linspace(500.0, 2000.0, 64))):
        rings = [beam_of(ring) for ring in (32.0, 64.0, 128.0)]
        beams = {"rigid": None} | {f"{len(beam.wave_numbers)} waves": beam for beam in rings}
        runs = {
            kind: functools.partial(sj.sweep, dataclasses.replace(SCENE, beam=beam), {name: grid}, **options)
            for kind, beam in beams.items()
        }
        medians = {kind: timed.median for kind, timed in in_turns(runs, 3).items()}
        for kind, time in medians.items():
            print(f"64 values of {name}, {kind}: {time:.2f} s, {time / medians['rigid']:.1f} of a rigid rail")


def beam_of(ring):
    return dataclasses.replace(sj.Beam.crane_rail(), ring=ring)


def test_accelerations_on_a_sled_rail_beside_a_straight_one():
    """The table of docs/how_to/rails.md: what others measured is 3 to 5 times the straight rail's RMS,
    and 8 times from 100 to 700 m/s."""
    scene, speeds = dataclasses.replace(sj.paper_scene(), gravity=9.81), [100.0 + 200.0 * k for k in range(8)]
    rails = {
        "rough": (sj.RandomTrack.sled(length=2000.0), {"speed": speeds, "track.seed": np.arange(16.0)}),
        "straight": (sj.model.StraightTrack(), {"speed": speeds}),
    }
    found = {}
    for name, (track, grid) in rails.items():
        on_rail = dataclasses.replace(scene, track=track)
        found[name] = sj.sweep(on_rail, grid, transient=10, periods=200, record=["rms_a_z", "peak_force"])
        assert np.all(found[name]["status"] == 0)
    rough, straight = found["rough"], found["straight"]
    rms = rough["rms_a_z"].mean("track.seed").values
    force = rough["peak_force"].max(("end", "point")).values / 1e3
    for k, speed in enumerate(speeds):
        print(
            f"{speed:.0f} m/s: RMS {rms[k]:.0f} m/s^2, straight {float(straight['rms_a_z'][k]):.1f}; "
            f"highest force {np.median(force[k]):.1f} kN in the median, {force[k].max():.1f} at most"
        )
    print(f"from 100 to 700 m/s {rms[3] / rms[0]:.1f} times")
