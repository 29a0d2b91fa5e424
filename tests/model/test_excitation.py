"""Slippers that excite themselves on rails that bend: the rail's compliance, the criterion, and the warning."""

import dataclasses
import warnings

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


def unstable_softness(speed):
    """1 / stiffness [m/N] of springs under a point of 14 kg whose oscillations grow as `GROWTH` says, by residues."""
    rates = (GROWTH + 1j) * np.geomspace(100.0, 20_000.0, 2000)
    softness = -np.array([1 / (14.0 * s**2) + compliance(s, speed) for s in rates])
    real = np.flatnonzero(np.diff(np.signbit(softness.imag)))
    return softness.real[real][softness.real[real] > 0]


def stiffest(scene):
    """The tangent stiffness of a typical impact [N/m]."""
    return float(1.5 * scene.contact.stiffness * contact_depth(scene) ** 0.5)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
@pytest.mark.parametrize("ratio", [1.2, 2.0, 3.0])
def test_criterion(ratio):
    """Of a point on two springs side by side, for impacts that are little stiffer or softer than unstable springs."""
    parts = dict(track=sj.model.StraightTrack(), beam=beam(ring=256.0, shortest=0.1), speed=ratio * CRITICAL)
    scene = dataclasses.replace(sj.paper_scene(length=0.005), **parts)
    # one of two springs
    softness = 2 * unstable_softness(ratio * CRITICAL)
    if ratio == 1.2:
        assert not len(softness)
        assert not excites_itself(scene.replace(stiffness=1e12))
        return
    for factor in (0.8, 1.25):
        # this tangent stiffness grows with the power 0.8 of the contacts' stiffness
        times = (factor / softness.max() / stiffest(scene)) ** 1.25
        assert excites_itself(scene.replace(stiffness=times * scene.contact.stiffness)) == (factor > 1)


@pytest.mark.parametrize(("speed", "warned"), [(600.0, False), (1000.0, False), (2000.0, True)])
def test_warning(speed, warned):
    """Once, with the speed and the critical speed, and not below the critical speed of 605 m/s."""
    scene = dataclasses.replace(sj.paper_scene(speed, stiffness=STEEL), beam=sj.Beam.crane_rail(bed=1e8))
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always", sj.ImplausibleWarning)
        sj.initial_state(scene)
    texts = [str(one.message) for one in given if "excite" in str(one.message)]
    assert len(texts) == warned
    if warned:
        assert "at 2000 m/s, 3.3 times the critical speed of their rails, 605.2 m/s" in texts[0]


def test_warning_of_a_sweep():
    """Of the fastest case, at the highest speed of its programme."""
    scene = dataclasses.replace(sj.paper_scene(600.0, stiffness=STEEL), beam=sj.Beam.crane_rail(bed=1e8))
    options = dict(transient=0, periods=1, steps_per_period=10, record="strobe", probe=False)
    with pytest.warns(sj.ImplausibleWarning, match="Slippers excite themselves at 2000 m/s"):
        sj.sweep(scene, {"speed": [600.0, 2000.0, 700.0]}, **options)
    faster = sj.SpeedProgramme.over_distance([0.0, 100.0], [600.0, 1900.0])
    with pytest.warns(sj.ImplausibleWarning, match="Slippers excite themselves at 1900 m/s"):
        sj.initial_state(dataclasses.replace(scene, speed=faster))
