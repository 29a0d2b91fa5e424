"""Slippers that excite themselves on rails that bend: the rail's compliance, the criterion, and the warning."""

import dataclasses
import warnings

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.excitation import GROWTH, excites_itself
from slipperjax.model.step_size import contact_depth

from .test_beam import CRITICAL, beam, compliance

pytestmark = pytest.mark.full
STEEL = 5e10


@pytest.mark.parametrize("ratio", [0.5, 1.5, 2.6])
def test_compliance(ratio):
    """Of a force that grows, against Fourier's integral by residues."""
    rates = np.array([50 + 500j, 100 + 3000j, 300 + 6000j])
    found = beam(ring=256.0, shortest=0.1).compliance(np.ones((1, 1)), np.zeros(1), ratio * CRITICAL, rates)
    exact = np.array([compliance(s, ratio * CRITICAL) for s in rates])
    errors = np.abs(found[:, 1, 0, 0] / exact - 1)
    print(f"\ncompliance at {ratio:g} times the critical speed: errors of {errors.max():.1e}")
    assert np.all(errors < 0.03)


def unstable_springs(speed):
    """1 / stiffness [m/N] of springs under a point of 14 kg whose oscillations grow as `GROWTH` says, by residues."""
    rates = (GROWTH + 1j) * np.geomspace(100.0, 20_000.0, 2000)
    springs = -np.array([1 / (14.0 * s**2) + compliance(s, speed) for s in rates])
    real = np.flatnonzero(np.diff(np.signbit(springs.imag)))
    return springs.real[real][springs.real[real] > 0]


def stiffest(scene):
    """The tangent stiffness of a typical impact [N/m]."""
    return float(1.5 * scene.contact.stiffness * contact_depth(scene) ** 0.5)


def excites(scene):
    """Whether a scene's slippers excite themselves at its constant speed."""
    return excites_itself(scene, scene.fastest_travel)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
@pytest.mark.parametrize("ratio", [1.2, 2.0, 3.0])
def test_criterion(ratio):
    """Of a point on two springs side by side, for impacts that are little stiffer or softer than unstable springs."""
    parts = dict(track=sj.model.StraightTrack(), beam=beam(ring=256.0, shortest=0.1), speed=ratio * CRITICAL)
    scene = dataclasses.replace(sj.paper_scene(length=0.005), **parts)
    # one of two springs
    springs = 2 * unstable_springs(ratio * CRITICAL)
    if ratio == 1.2:
        assert not len(springs)
        assert not excites(scene.replace(stiffness=1e12))
        return
    for factor in (0.8, 1.25):
        # this tangent stiffness grows with the power 0.8 of the contacts' stiffness
        times = (factor / springs.max() / stiffest(scene)) ** 1.25
        assert excites(scene.replace(stiffness=times * scene.contact.stiffness)) == (factor > 1)


def on_soft_bed(speed, stiffness=STEEL):
    """A slipper on the crane rail, whose waves it outruns above 605 m/s."""
    return dataclasses.replace(sj.paper_scene(speed, stiffness=stiffness), beam=sj.Beam.crane_rail(bed=1e8))


def warnings_of(call):
    """The texts of warnings that slippers excite themselves."""
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always", sj.ImplausibleWarning)
        call()
    return [str(one.message) for one in given if "excite" in str(one.message)]


@pytest.mark.parametrize(("speed", "warned"), [(600.0, False), (1000.0, False), (2000.0, True)])
@pytest.mark.parametrize("inside", [False, True])
def test_warning(speed, warned, inside):
    """Once, with the speed and the critical speed, and not below it; also inside a program, which knows the scene."""
    scene = on_soft_bed(speed)
    begin = lambda v_z: sj.initial_state(scene, sj.Motion(v_z=v_z))
    texts = warnings_of(lambda: (jax.jit(begin) if inside else begin)(0.1))
    assert len(texts) == warned
    if warned:
        assert "at 2000 m/s, 3.3 times the critical speed of their rails, 605.2 m/s" in texts[0]


@pytest.mark.parametrize(
    ("grid", "warned"),
    [
        ({"speed": [600.0, 1200.0, 700.0]}, "at 1200 m/s"),
        # of this stiffness slippers at 2300 m/s are stable
        ({"speed": [1200.0, 2300.0]}, "at 1200 m/s"),
        ({"stiffness": [1e8, STEEL]}, "at 1800 m/s"),
        ({"speed": [600.0, 1000.0]}, None),
    ],
)
def test_warning_of_a_grid(grid, warned):
    """Of any of its cases, not only of the one that outruns the waves most."""
    scene = on_soft_bed(1800.0, stiffness=1e9)
    options = dict(transient=0, periods=1, steps_per_period=10, record="strobe", probe=False)
    texts = warnings_of(lambda: sj.sweep(scene, grid, **options))
    assert len(texts) == (warned is not None)
    assert not texts or warned in texts[0]


@pytest.mark.parametrize(("fastest", "warned"), [(1200.0, "at 1041 m/s"), (2300.0, "at 1057 m/s"), (1000.0, None)])
def test_warning_of_a_programme(fastest, warned):
    """At any of its speeds, not only at the highest."""
    speed = sj.SpeedProgramme.over_distance([0.0, 100.0], [600.0, fastest])
    scene = dataclasses.replace(on_soft_bed(600.0, stiffness=1e9), speed=speed)
    texts = warnings_of(lambda: sj.initial_state(scene))
    assert len(texts) == (warned is not None)
    assert not texts or warned in texts[0]
