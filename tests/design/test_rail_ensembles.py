"""Designs over random rails: quantiles with their errors, on common rails and on new ones.

pytest -m slow -s tests/design/test_rail_ensembles.py
"""

import dataclasses

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.design import EnsembleSettings, RailEnsemble, sensitivities
from slipperjax.design.ensembles import ensemble_for
from slipperjax.design.problem import checked_problem
from slipperjax.flow.datasets import load_call

STEPS = 50
SCENE = dataclasses.replace(sj.paper_scene(1000.0), track=sj.RandomTrack.sled(length=300.0))
BOX = {"clearance": (0.5e-3, 3e-3)}
FEW = RailEnsemble(rails=16, transient=0, periods=4, quantile=0.75)
"""All quick tests share its two batches of 16 runs, and with them one program."""


def problem(scene=SCENE, ensemble=FEW, box=BOX, **change):
    arguments = dict(over=None, robust="worst", constraints=None, transient=0, steps=STEPS)
    return checked_problem(
        scene, "peak_slipper_force", box, ensemble=ensemble, solver=None, start=None, **arguments | change
    )


SURVEYS = [sj.model.SampledTrack([0.0, 16.0], np.zeros(65), 0.0)] * 20


def chosen(track, seed=0, rails=80):
    return RailEnsemble(rails=rails, seed=seed).conditions(track, 2)[1]


def test_each_run_of_a_case_has_its_rail_and_corners_have_the_same():
    assert list(chosen(SCENE.track)) == ["track.seed"]
    np.testing.assert_array_equal(chosen(SCENE.track, seed=2)["track.seed"], np.arange(160, 240))
    joints = sj.model.LocalTrack([6.0], [-3e-4], 0.5, "joint", every=12.0)
    both = chosen(sj.model.SumTrack(sj.model.SumTrack(SCENE.track, joints), sj.model.TrackSet(SURVEYS[:3])))
    np.testing.assert_array_equal(both["track.one.one.seed"], np.arange(80))
    np.testing.assert_array_equal(both["track.other.number"][:4], [0, 2, 0, 2])
    # one number chooses both rails
    assert list(chosen(sj.model.RandomRails(SCENE.track, 0.5))) == ["track.seed"]


def test_a_search_does_not_see_every_other_rail_of_a_set():
    track = sj.model.TrackSet(SURVEYS)
    seen, unseen = (set(chosen(track, seed)["track.number"]) for seed in (0, 1))
    assert seen == set(range(0, 20, 2))
    assert unseen == set(range(1, 20, 2))
    # nor do its surroundings, a million batches further
    assert set(chosen(track, 1_000_001)["track.number"]) == unseen
    # runs over one rail are no further rails
    ensemble = RailEnsemble(rails=80, quantile=0.5)
    assert len(np.unique(ensemble.conditions(track, 2)[0])) == 10
    assert ensemble.unseen(track) == "along 10 rails that the search has not seen"
    assert ensemble.unseen(SURVEYS[0]) == "from 80 other starts along the one rail of the search"
    assert ensemble.unseen(SCENE.track) == "along 80 rails that the search has not seen"
    scene = dataclasses.replace(
        SCENE, track=sj.model.TrackSet([sj.model.SampledTrack([0.0, 1e4], np.zeros(65), 0.0)] * 20)
    )
    assert ensemble_for(scene, ensemble) == ensemble
    with pytest.raises(ValueError, match="must come with 80 or more rails, 4 of them beyond it"):
        ensemble_for(scene, RailEnsemble())


CORNERS = np.array([[-1.0], [1.0]])


def test_runs_along_one_rail_are_drawn_together():
    rails = np.random.default_rng(0).normal(size=(1, 40, 1)) + 0.1 * CORNERS[:, None]
    ensemble = RailEnsemble(rails=80, quantile=0.5)
    alone = ensemble.fit(CORNERS, rails, np.ones((2, 40), bool), np.arange(40))
    # from four starts each, of which all have the same number
    again = ensemble.fit(CORNERS, np.tile(rails, (1, 4, 1)), np.ones((2, 160), bool), np.tile(np.arange(40), 4))
    for part, other in zip(again, alone, strict=True):
        np.testing.assert_allclose(part[:, 0], other[:, 0], rtol=1e-6)


def test_a_rail_with_a_lost_run_is_left_out_at_all_corners():
    values = np.random.default_rng(0).normal(size=(2, 40, 1))
    kept = np.ones((2, 40), bool)
    kept[0, [3, 7]] = False
    rail, left = np.arange(40), np.delete(np.arange(40), [3, 7])
    ensemble = RailEnsemble(rails=80, quantile=0.5)
    found = ensemble.fit(CORNERS, values, kept, rail)
    for part, other in zip(found, ensemble.fit(CORNERS, values[:, left], kept[:, left], rail[left]), strict=True):
        np.testing.assert_array_equal(part, other)
    few = ensemble.fit(CORNERS, values, kept & (rail < 8), rail)
    assert all(np.isnan(part).all() for part in few)


@pytest.mark.full
def test_values_are_quantiles_of_runs_on_the_rails():
    options = dict(ensemble=dataclasses.replace(FEW, quantile=0.5), steps_per_period=STEPS)
    ds = sensitivities(SCENE, "peak_slipper_force", ["clearance"], **options)
    assert ds.attrs["method"] == "ensemble"
    assert float(ds["domain"][0]) == pytest.approx(5e-5)
    of = lambda quantile: options | dict(ensemble=dataclasses.replace(FEW, quantile=quantile))
    mean = sensitivities(SCENE, "peak_slipper_force", ["clearance"], **of(None))
    assert float(mean["value"][0]) == pytest.approx(float(ds["value"][0]), rel=0.1)  # measured 3.57 and 3.63 kN
    assert float(mean["value"][0]) != float(ds["value"][0])
    lowest = sensitivities(SCENE, "peak_slipper_force", ["clearance"], **of(0.25))
    assert float(lowest["value"][0]) < float(mean["value"][0])


@pytest.mark.full
def test_a_search_on_common_rails_is_judged_on_others():
    best = sj.optimise_design(
        SCENE, "peak_slipper_force", BOX, ensemble=FEW, starts=1, max_trials=2, steps_per_period=STEPS
    )
    again = problem().evaluate((np.array([[best.design["clearance"]]]) - 0.5e-3) / 2.5e-3, None)
    known = best.history["objective"].values[best.history["taken"].values][-1, 0]
    assert known == pytest.approx(again.value[0, 1], rel=1e-9)
    assert best.objective != pytest.approx(known, rel=1e-3)  # measured 2 % apart
    assert best.stderr > 0
    assert best.judged == "along 16 rails that the search has not seen"
    assert f"judged {best.judged}\n" in repr(best)
    assert 0 < abs(float(best.cases["step_change"][0])) < 0.5  # by half the step, on the same rails
    assert RailEnsemble(*load_call(best.ds)["ensemble"]) == FEW


@pytest.mark.full
def test_bounds_limit_ensembles_too():
    evaluation = problem(box={"clearance": (0.0, 2e-3)}).evaluate(np.array([[0.0]]), None)
    assert np.all(np.isfinite(evaluation.gradient))  # no clearance below zero


def test_too_few_finite_values_have_no_plane():
    values = np.full((2, 16, 1), np.nan)
    values[0, :2] = 1.0
    fit = FEW.fit(CORNERS, values, np.ones((2, 16), bool), np.arange(16))
    assert all(np.all(np.isnan(part)) for part in fit)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(ensemble=EnsembleSettings()), "Argument `ensemble` must be a slipperjax.design.RailEnsemble"),
        (dict(ensemble=RailEnsemble(periods=40)), "Argument `ensemble` must have at most 37 periods"),
    ],
)
def test_bad_questions_name_what_is_wrong(change, words):
    with pytest.raises(ValueError, match=words):
        problem(**change)
    with pytest.raises(ValueError, match="Argument `quantile` must be a share between 0 and 1"):
        RailEnsemble(quantile=2.0)
    with pytest.raises(ValueError, match="Argument `rails` must be a whole number of 2 or more"):
        RailEnsemble(rails=0)
    with pytest.raises(ValueError, match="`quantile` must come with 400 or more rails, 4 of them beyond it"):
        RailEnsemble(rails=200, quantile=0.99)


REPEATS, RAILS = 100, 400


def inside(value, stderr, truth):
    return float(np.mean(np.abs(value - truth) <= 2 * stderr))


@pytest.mark.slow  # 3 minutes
def test_errors_of_slopes_over_rails_are_true():
    """Values and slopes of 40 ensembles, each on rails of its own, against the mean of all and one of 16 times."""
    names, options = ["clearance", "track.roughness"], dict(steps_per_period=STEPS)
    sizes = dict(transient=2, periods=20, quantile=0.9)
    of = lambda rails, seed: sensitivities(
        SCENE, "peak_slipper_force", names, ensemble=RailEnsemble(rails=rails, seed=seed, **sizes), **options
    )
    truth = of(16 * 100, 40)  # rails of 1600 * 40 on: none of the others
    found = xr.concat([of(100, seed) for seed in range(40)], "batch")
    value = inside(found["value"], found["stderr"], truth["value"])
    slope = [
        inside(found["gradient"][:, 0, k], found["gradient_stderr"][:, 0, k], truth["gradient"][0, k]) for k in (0, 1)
    ]
    print(f"\ntrue within two errors: value {value:.3f}, slopes {slope}")
    print("relative slopes", truth["relative"].values, truth["gradient_stderr"].values / truth["gradient"].values)
    assert value >= 0.85
    assert min(slope) >= 0.85


def test_a_programme_of_speeds_has_an_ensemble():
    scene = dataclasses.replace(sj.paper_scene(), speed=sj.SpeedProgramme([0.0, 100.0], [50.0, 800.0]))
    assert isinstance(ensemble_for(scene, None), RailEnsemble)
