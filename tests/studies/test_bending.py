"""What a rail that bends does to the forces: tables of docs/lab/applicability.md.

    pytest -m slow -s tests/studies/test_bending.py

Rails, speeds and peak forces are those of tests/studies/test_applicability.py.
"""

import dataclasses
import functools

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.tools.files import table_lines

from .test_applicability import ENSEMBLES, MEMBERS, percent, with_part

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")]
STEEL = 5e10
STIFFNESSES = (1e8, 1e9, STEEL)
"""Stiffness of the contacts [N/m^1.5]."""
SPEEDS = (1000.0, 2000.0)
CRANE = sj.Beam.crane_rail(bed=1e8)
RAILS = {"rigid": None, "bends": CRANE}
FEWER = 128
"""Members where a change of the rail's numbers or of the method is looked at."""


def on(rail, stiffness=STEEL, restitution=0.9):
    def change(scene):
        return with_part(beam=rail)(scene).replace(stiffness=stiffness, restitution=restitution)

    return change


@functools.cache
def forces(speed, kind, stiffness=STEEL, restitution=0.9):
    """The highest force of each member on a kind of rail [N]."""
    return ENSEMBLES[f"sled rail, {speed:g} m/s"].peaks(on(RAILS[kind], stiffness, restitution))


def kilo(forces, share):
    return f"{np.quantile(forces, share) / 1e3:.3g}"


def test_forces_with_and_without_the_rail():
    rows = []
    for stiffness in STIFFNESSES:
        for speed in SPEEDS:
            rigid, bends = (forces(speed, kind, stiffness) for kind in RAILS)
            row = {"stiffness [N/m^1.5]": f"{stiffness:.0e}", "speed [m/s]": f"{speed:g}"}
            for name, share in (("median", 0.5), ("95 %", 0.95)):
                both = f"{kilo(rigid, share)}, {kilo(bends, share)}"
                row |= {f"{name}: rigid, bends [kN]": both, f"{name}: change [%]": percent(rigid, bends, share)}
            rows.append(row)
            print("\n".join(table_lines(rows)[0 if len(rows) == 1 else -1 :]), flush=True)
    assert np.median(forces(1000.0, "bends")) < 0.7 * np.median(forces(1000.0, "rigid"))


RESTITUTIONS = (0.9, 0.8, 0.7, 0.6, 0.5)


def equal_restitution(tails, wanted):
    """The highest restitution whose 95 % force on a rigid rail is the wanted one, between those of a falling table."""
    for (high, above), (low, below) in zip(
        zip(RESTITUTIONS, tails, strict=True), zip(RESTITUTIONS[1:], tails[1:], strict=True), strict=False
    ):
        if below <= wanted <= above:
            return high - (high - low) * (above - wanted) / (above - below)
    return np.nan


@pytest.mark.parametrize("speed", SPEEDS)
def test_restitution_of_a_rigid_rail_that_gives_the_same_force(speed):
    rigid = [forces(speed, "rigid", restitution=value) for value in RESTITUTIONS]
    bends = forces(speed, "bends")
    print(f"\n{speed:g} m/s: 95 % [kN] by restitution on a rigid rail, last on the rail that bends")
    print(", ".join(f"{value}: {kilo(of, 0.95)}" for value, of in zip(RESTITUTIONS, rigid, strict=True)))
    print(kilo(bends, 0.95))
    rng = np.random.default_rng(0)
    tail = lambda of: np.quantile(rng.choice(of, len(of)), 0.95)
    value = equal_restitution([np.quantile(of, 0.95) for of in rigid], np.quantile(bends, 0.95))
    found = [equal_restitution([tail(of) for of in rigid], tail(bends)) for _ in range(400)]
    print(f"the same with {value:.2f}, twice the standard error {2 * np.nanstd(found):.2f}")
    print(f"none of that force in {np.mean(np.isnan(found)):.0%} of 400 resamplings", flush=True)


def test_other_rails_and_steps():
    """At steel's stiffness and 1000 m/s."""
    speed, rows = 1000.0, []
    scene = ENSEMBLES[f"sled rail, {speed:g} m/s"]
    steps = sj.model.default_steps_per_period(on(CRANE)(scene.scene))
    others = {
        "ring of 128 m": (dataclasses.replace(CRANE, ring=128.0), {}),
        "four times the steps": (CRANE, dict(steps_per_period=4 * steps)),
        "bed of 1e9 N/m^2": (sj.Beam.crane_rail(bed=1e9), {}),
    }
    before = forces(speed, "bends")
    for name, (rail, options) in others.items():
        after = scene.peaks(on(rail), FEWER, **options)
        rows.append({"change": name, "median [%]": percent(before, after), "95 % [%]": percent(before, after, 0.95)})
        print("\n".join(table_lines(rows)[0 if len(rows) == 1 else -1 :]), flush=True)


def drop(stiffness, speed, rail, restitution=None):
    """Highest force [N] and speed of the rebound [m/s] of the paper's slipper that falls at 1 m/s, a travelling one.

    The slipper is a point: its two track nodes are 5 mm apart. Its four points act as one spring, and its play is
    so large that it rebounds freely.
    """
    scene = sj.paper_scene(length=0.005, clearance=0.05)
    law = sj.model.HertzSpring(stiffness / 4)
    if restitution is not None:
        law = sj.model.Flores(stiffness / 4, restitution)
    window = 3 * speed * float(sj.model.contact_duration(scene.replace(stiffness=stiffness)))
    parts = dict(track=sj.model.StraightTrack(), contact=law, beam=rail, speed=speed, window=window)
    scene = dataclasses.replace(scene, **parts)
    start = sj.Motion(z=-scene.section.play[0], v_z=-1.0)
    run = sj.simulate(scene, start=start, periods=1, steps_per_period=1000, probe=0)
    force = 2 * np.asarray(run.loads.peak_force).sum(axis=(0, 1)).max()
    return force, float(run.end.motion.v_z)


def test_drops_on_a_travelling_load():
    """Force and apparent restitution of a drop of 14 kg, by speed."""
    rows = []
    long = dataclasses.replace(CRANE, ring=128.0, shortest=0.2)
    for stiffness in STIFFNESSES:
        rigid, _ = drop(stiffness, 1.0, None)
        row = {"stiffness [N/m^1.5]": f"{stiffness:.0e}", "rigid rail [kN]": f"{rigid / 1e3:.3g}"}
        for speed in (1.0, *SPEEDS):
            force, rebound = drop(stiffness, speed, long)
            row[f"{speed:g} m/s"] = f"{100 * (force / rigid - 1):+.0f} %, {rebound:.2f}"
        rows.append(row)
        print("\n".join(table_lines(rows)[0 if len(rows) == 1 else -1 :]), flush=True)
