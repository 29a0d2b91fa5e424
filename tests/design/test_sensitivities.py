"""Derivatives of objectives against differences of orbits that were found anew, and between methods."""

import sys

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.ensembles import EnsembleSettings
from slipperjax.design.judge import judge_on_orbits
from slipperjax.design.objectives import OBJECTIVES
from slipperjax.design.sensitivities import sensitivities

MODULE = sys.modules[sensitivities.__module__]
NAMES = ("clearance", "length")
EVERY = (
    *("speed", "length", "mass", "inertia_y", "stiffness", "restitution", "amplitude", "roll_amplitude"),
    *("section.play.0", "section.play.2"),
)
STEPS_ASIDE = (1e-5, 1e-6, 1e-4, 1e-7)
"""Relative changes of a parameter, in the order in which they are tried."""


def test_numbers_that_a_scene_has_not_are_refused():
    with pytest.raises(ValueError, match=r"^Argument `names` must be of numbers that the scene has"):
        sensitivities(sj.paper_scene(), "peak_force", ["gravity"])


@pytest.mark.slow
def test_a_motion_off_the_orbit_is_not_taken_for_one():
    """At 0.13 m the motion is chaotic."""
    options = dict(method="orbit", steps_per_period=50, transient=60)
    with pytest.raises(ValueError, match=r"^Argument `method` must be 'ensemble' here, but is 'orbit': after 60"):
        sensitivities(sj.paper_scene(length=0.13), ["peak_force", "rms_a_z"], NAMES, **options)


def random_scenes(count, seed=3):
    """Scenes with a stable orbit of period 1, of random speed, clearance, length and per-face play."""
    draws = np.random.default_rng(seed)
    scenes = []
    while len(scenes) < count:
        scene = sj.paper_scene(draws.uniform(1150, 1900), draws.uniform(0.4e-3, 2e-3), draws.uniform(0.18, 0.4))
        scene = scene.replace(**{"section.play.2": float(scene.section.play[2]) * draws.uniform(0.8, 1.2)})
        orbit = sj.periodic_orbit(scene, steps_per_period=100)
        if int(orbit.status) == 0 and orbit.stable and orbit.period == 1:
            scenes.append((scene, orbit))
    return scenes


@pytest.fixture
def on_the_same_steps(monkeypatch):
    """Derivatives on the steps that the orbit was found with."""
    monkeypatch.setattr(MODULE, "_on_finer_steps", judge_on_orbits)


def slopes_by_differences(scene, name, objectives, options):
    """Central differences of fourth order, for one step after the other."""
    value = float(scene.value(name))
    of = lambda scene: sensitivities(scene, objectives, (name,), **options)["value"].values
    at = lambda change: of(scene.replace(**{name: value * (1 + change)}))
    for h in STEPS_ASIDE:
        near, far = (at(k * h) - at(-k * h) for k in (1, 2))
        yield (8 * near - far) / (12 * h * value)


@pytest.mark.slow
@pytest.mark.usefixtures("on_the_same_steps")
def test_every_objective_by_every_parameter_at_ten_random_designs():
    objectives, worst = list(OBJECTIVES), np.zeros(len(OBJECTIVES))
    for scene, orbit in random_scenes(10):
        options = dict(start=orbit.state, transient=0, steps_per_period=100)
        ds = sensitivities(scene, objectives, EVERY, **options)
        assert ds.attrs["method"] == "orbit"
        for name in EVERY:
            gradient, errors = ds["gradient"].sel(parameter=name).values, np.inf
            # values have 12 digits, so that of slopes far below value / parameter differences have fewer
            least = 0.1 * np.abs(ds["value"].values / float(scene.value(name)))
            for slope in slopes_by_differences(scene, name, objectives, options):
                errors = np.minimum(errors, np.abs(gradient - slope) / np.maximum(np.abs(slope), least))
                if np.max(errors) < 1e-7:
                    break
            worst = np.maximum(worst, errors)
    print({name: f"{error:.1e}" for name, error in zip(objectives, worst, strict=True)})
    # the exponent needs the smallest steps: where two multipliers collide it bends within a millionth of a parameter
    assert worst.max() < 1e-6, worst


def stable_orbits(count, seed=11):
    """Yields scenes with stable periodic orbits, four of them chosen and the others random."""
    yield sj.paper_scene(1480.0, restitution=0.7)
    yield sj.paper_scene(1255.0, length=0.28, clearance=0.8e-3)
    yield sj.paper_scene(1330.0)
    yield sj.paper_scene(1610.0, stiffness=2.5e8)
    draws = np.random.default_rng(seed)
    for _ in range(count - 4):
        shape = dict(clearance=draws.uniform(0.5e-3, 2e-3), length=draws.uniform(0.15, 0.35))
        contact = dict(stiffness=draws.uniform(1e8, 3e8), restitution=draws.uniform(0.6, 0.9))
        yield sj.paper_scene(draws.uniform(1000, 2000), **shape, **contact)


@pytest.mark.slow
def test_stated_errors_on_orbits_hold_the_true_ones(monkeypatch):
    """Against eight times as many steps as those of the finest derivatives."""
    names, objectives = ("clearance", "restitution"), ["peak_force", "rms_a_z", "rms_alpha_y", "contact_load"]
    rows = []
    for scene in stable_orbits(22):
        of = lambda steps, scene=scene: sensitivities(
            scene, objectives, names, method="orbit", steps_per_period=steps
        )
        try:
            ds, truth = of(None), of(320)
        except ValueError:  # no stable orbit there, or not with all steps
            continue
        if ds.attrs["period"] == truth.attrs["period"]:
            with monkeypatch.context() as patch:
                patch.setattr(MODULE, "_on_finer_steps", judge_on_orbits)
                coarse = of(None)
            slope = truth["gradient"]
            rows.append([ds["gradient"] / slope - 1, ds["gradient_stderr"] / slope, coarse["gradient"] / slope - 1])
    errors, stated, plain = np.abs(np.moveaxis(rows, 1, 0)).reshape(3, -1)
    shown = lambda e: f"median {np.median(e):.1e}, 90 % {np.quantile(e, 0.9):.1e}, worst {np.max(e):.1e}"
    within = [float(np.mean(errors <= k * stated)) for k in (1, 3)]
    print(f"\n{len(rows)} orbits, {len(errors)} slopes; at the motion's steps: {shown(plain)}")
    print(f"at twelve times as many: {shown(errors)}; within one and three stated errors: {within}")
    assert len(errors) >= 120
    assert np.median(errors) < 1e-3
    assert np.quantile(errors, 0.9) < 1e-2
    assert within[1] >= 0.95


@pytest.mark.slow
def test_ensembles_agree_with_orbits_where_motions_are_periodic():
    of = lambda **how: sensitivities(sj.paper_scene(), ["peak_force", "rms_a_z"], NAMES, steps_per_period=50, **how)
    ds, ensemble = of(), of(method="ensemble", ensemble=EnsembleSettings(16, 400, 50))
    away = np.abs(ensemble["gradient"] - ds["gradient"]) / np.abs(ds["gradient"])
    assert float(away.max()) < 0.02, away
