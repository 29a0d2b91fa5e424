"""Features of known signals, and a likelihood of features beside the exact one."""

import re

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.fitting import BandRms, ContactFraction, CorrelationIntegral, Features, ImpactRate, Peaks
from slipperjax.fitting.likelihood import WIDER, _Emulator, _Known, _Likely, _records_near

from .records import record

RNG = np.random.default_rng(0)
WHITE = RNG.normal(size=(3, 4000))


def test_bands_of_white_noise_are_as_wide_as_they_have_lines():
    names, values = BandRms(4).of(WHITE[0])
    found = values(WHITE)
    assert found.shape == (3, len(names)) == (3, 4)
    # the upper band has most lines; doubling a signal doubles all
    assert np.all(np.diff(found, axis=1) > 0)
    np.testing.assert_allclose(values(2 * WHITE), found + np.log(2.0))
    sine = np.sin(2 * np.pi * 500 * np.arange(4000) / 4000)
    assert values(sine[None])[0].argmax() == 3 - (np.geomspace(4, 2001, 5)[3] > 500)


PULSES = np.where(np.arange(1000) % 100 == 50, 1.0, 0.0)
FORCE = np.repeat([0.0, 3.0], [300, 100])
KNOWN = {
    # of normal deviates, here within 4 %
    "peaks are quantiles": (Peaks((0.5, 0.9)), WHITE, [0.674, 1.645], 0.06),
    "impacts are counted": (ImpactRate((1.0,)), PULSES[None], 10.5, 1e-7),
    "contact is where a force is": (ContactFraction((0.2,)), FORCE[None], 100.5 / 300.5, 1e-7),
    # radii are those of the record
    "correlations are shares of pairs": (CorrelationIntegral((0.1, 0.3)), WHITE[:1], [0.1, 0.3], 0.01),
    "also of other signals": (CorrelationIntegral((0.1, 0.3)), WHITE, [0.1, 0.3], 0.15),
}


@pytest.mark.parametrize("case", KNOWN)
def test_features_of_known_signals(case):
    feature, signals, exact, within = KNOWN[case]
    names, values = feature.of(signals[0])
    found = np.exp(values(signals))
    assert found.shape[1] == len(names)
    np.testing.assert_allclose(found, np.broadcast_to(exact, found.shape), rtol=within)


def test_the_likelihood_of_normal_features_is_the_exact_one():
    # features are A level + noise of a known covariance, of which the posterior has a closed form
    slope = np.array([[1.0, 0.3], [0.2, -0.8], [0.5, 0.5]])
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.1, 0.4]])
    rng = np.random.default_rng(1)
    level = rng.normal(size=(400, 2))
    values = (level @ slope.T)[:, None] + rng.normal(size=(400, 16, 3)) @ root.T
    target = slope @ np.array([0.4, -0.7])
    known = _Known(level, values)
    found = _Likely(np.zeros(2), np.eye(2) / WIDER**2, level[:0])
    for _ in range(4):
        found = _Emulator.of(known, target, found).likely()
    inverse = np.linalg.inv(root @ root.T)
    covariance = np.linalg.inv(slope.T @ inverse @ slope + np.eye(2))
    error = np.sqrt(np.diag(covariance))
    # 0.05 standard errors, and 3 % of the errors
    np.testing.assert_allclose((found.mean - covariance @ slope.T @ inverse @ target) / error, 0.0, atol=0.2)
    np.testing.assert_allclose(found.stderr / error, 1.0, rtol=0.12)
    assert _records_near(known, target, found)[2] > 0.01
    assert _records_near(known, target + 5.0 * np.array([1.0, -1.0, 1.0]), found)[2] < 0.01


def test_lost_ensembles_are_left_out_with_a_word():
    known = _Known(np.empty((0, 2)), np.empty((0, 4, 3)))
    values = np.ones((5, 4, 3))
    values[:2, 1] = np.nan
    with pytest.warns(sj.ImplausibleWarning, match="2 of 5 ensembles have lost runs, and are left out"):
        assert len(known.with_more(np.zeros((5, 2)), values).level) == 3
    need = r"`unknowns` must have bounds within which runs are not lost, .* such for 0"
    with pytest.warns(sj.ImplausibleWarning, match="5 of 5"), pytest.raises(ValueError, match=need):
        known.with_more(np.zeros((5, 2)), np.full((5, 4, 3), np.nan))


@pytest.mark.full
def test_features_need_kinds_the_noise_and_equal_times():
    scene = sj.paper_scene(2300.0)
    measured = record(scene, [sj.model.Sensor("az")], 4, settled=0)
    holes = measured.isel(time=np.flatnonzero(RNG.random(120) > 0.2))
    method = Features(members=4, proposals=16, rounds=1, transient=0)
    fit = lambda ds, noise: sj.fit(
        scene, ds, {"stiffness": (3e7, 3e8)}, [sj.model.Sensor("az", noise=noise)], method=method
    )
    short = np.sin(np.arange(30.0) / 2)
    for make, words in (
        (lambda: fit(measured, None), "`noise` must be given of the sensor az for features"),
        (lambda: fit(holes, 1.0), "of which at most 5 % are missing"),
        (lambda: Features(features=()), "`features` must have one kind or more"),
        (lambda: CorrelationIntegral(dimension=20).of(short), "`dimension` must be at most 10 for a record of 30"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            make()


@pytest.mark.slow
def test_a_chaotic_record_tells_of_its_parameters():
    scene = sj.paper_scene(2300.0)
    clean = [sj.model.Sensor("az"), sj.model.Sensor("z", "displacement")]
    measured = record(scene, clean, 200, settled=300, noise=0.05)
    sensors = [sj.model.Sensor(one.name, one.measures, noise=0.05 * float(measured[one.name].std())) for one in clean]
    far = scene.replace(stiffness=6e7, clearance=1.5e-3)
    bounds = {"stiffness": (3e7, 3e8), "clearance": (5e-4, 2e-3)}
    found = sj.fit(far, measured, bounds, sensors, method=Features(members=8, proposals=32))
    errors = np.sqrt(np.diag(found.posterior.covariance))
    for level, error, one in zip(found.posterior.level, errors, found.problem.unknowns, strict=True):
        assert abs(level - one.level(float(scene.value(one.name)))) < 3 * error
        assert error < 0.5
    assert not found.misfit
    assert np.isfinite(found.ds["density"]).any()
    assert found.plot().shape == (2, 2)
    # no trajectory stays near this record
    assert sj.fit(far, measured.isel(time=slice(0, 40 * 30)), bounds, sensors).misfit
