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
MEDIAN = RailEnsemble(rails=80, quantile=0.5)


def problem(ensemble=FEW, box=BOX):
    options = dict(over=None, robust="worst", constraints=None, transient=0, steps=STEPS, solver=None, start=None)
    return checked_problem(SCENE, "peak_slipper_force", box, ensemble=ensemble, **options)


def surveys(count, end=16.0):
    return [sj.model.SampledTrack([0.0, end], np.zeros(65), 0.0)] * count


def chosen(track, seed=0):
    return RailEnsemble(seed=seed).conditions(track, 2)[1]


def test_each_run_of_a_case_has_its_rail_and_corners_have_the_same():
    assert list(chosen(SCENE.track)) == ["track.seed"]
    np.testing.assert_array_equal(chosen(SCENE.track, seed=2)["track.seed"], np.arange(160, 240))
    joints = sj.model.LocalTrack([6.0], [-3e-4], 0.5, "joint", every=12.0)
    both = chosen(sj.model.SumTrack(sj.model.SumTrack(SCENE.track, joints), sj.model.TrackSet(surveys(3))))
    np.testing.assert_array_equal(both["track.one.one.seed"], np.arange(80))
    np.testing.assert_array_equal(both["track.other.number"][:4], [0, 2, 0, 2])
    # one number chooses both rails
    assert list(chosen(sj.model.RandomRails(SCENE.track, 0.5))) == ["track.seed"]


def test_a_search_does_not_see_every_other_rail_of_a_set():
    track = sj.model.TrackSet(surveys(20))
    # the last judgement, and surroundings, a million batches further
    for seed, first in ((0, 0), (1, 1), (1_000_001, 1)):
        assert set(chosen(track, seed)["track.number"]) == set(range(first, 20, 2))
    # runs over one rail are no further rails
    assert len(np.unique(MEDIAN.conditions(track, 2)[0])) == 10
    assert MEDIAN.unseen(track) == "along 10 rails that the search has not seen"
    assert MEDIAN.unseen(surveys(1)[0]) == "from 80 other starts along the one rail of the search"
    assert MEDIAN.unseen(SCENE.track) == "along 80 rails that the search has not seen"
    scene = dataclasses.replace(SCENE, track=sj.model.TrackSet(surveys(20, 1e4)))
    assert ensemble_for(scene, MEDIAN) == MEDIAN
    with pytest.raises(ValueError, match=r"must be 80 or more for the quantile 0\.95, with 4 of them beyond it"):
        ensemble_for(scene, RailEnsemble())


CORNERS = np.array([[-1.0], [1.0]])
DRAWN = np.random.default_rng(0).normal(size=(1, 40, 1)) + 0.1 * CORNERS[:, None]


def test_runs_along_one_rail_are_drawn_together():
    alone = MEDIAN.fit(CORNERS, DRAWN, np.arange(40))
    # from four starts each, of which all have the same number
    again = MEDIAN.fit(CORNERS, np.tile(DRAWN, (1, 4, 1)), np.tile(np.arange(40), 4))
    for part, other in zip(again, alone, strict=True):
        np.testing.assert_allclose(part[:, 0], other[:, 0], rtol=1e-6)


def test_a_rail_with_a_lost_run_is_left_out_at_all_corners():
    values, rail, left = DRAWN.copy(), np.arange(40), np.delete(np.arange(40), [3, 7])
    values[0, [3, 7]] = np.nan
    found, other = MEDIAN.fit(CORNERS, values, rail), MEDIAN.fit(CORNERS, values[:, left], rail[left])
    np.testing.assert_array_equal(found, other)
    values[0, 8:] = np.nan
    assert np.isnan(MEDIAN.fit(CORNERS, values, rail)).all()


@pytest.mark.full
def test_values_are_quantiles_of_runs_on_the_rails():
    def of(quantile):
        options = dict(ensemble=dataclasses.replace(FEW, quantile=quantile), steps_per_period=STEPS)
        return sensitivities(SCENE, "peak_slipper_force", ["clearance"], **options)

    median, mean = of(0.5), of(None)
    assert median.attrs["method"] == "ensemble"
    assert float(median["domain"][0]) == pytest.approx(5e-5)
    assert float(mean["value"][0]) == pytest.approx(float(median["value"][0]), rel=0.1)  # measured 3.57 and 3.63 kN
    assert float(of(0.25)["value"][0]) < float(mean["value"][0]) != float(median["value"][0])


@pytest.mark.full
def test_a_search_on_common_rails_is_judged_on_others():
    options = dict(ensemble=FEW, starts=1, max_trials=2, steps_per_period=STEPS)
    best = sj.optimise_design(SCENE, "peak_slipper_force", BOX, **options)
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


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: problem(EnsembleSettings()), "Argument `ensemble` must be a slipperjax.design.RailEnsemble"),
        (lambda: problem(RailEnsemble(periods=40)), "Argument `ensemble` must have at most 37 periods"),
        (lambda: RailEnsemble(quantile=2.0), "Argument `quantile` must be a share between 0 and 1"),
        (
            lambda: RailEnsemble(rails=200, quantile=0.99),
            "must be 400 or more for the quantile 0.99, with 4 of them beyond it",
        ),
    ],
)
def test_bad_questions_name_what_is_wrong(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.slow  # 3 minutes
def test_errors_of_slopes_over_rails_are_true():
    """Values and slopes of 40 ensembles, each on rails of its own, against the mean of all and one of 16 times."""
    names = ["clearance", "track.roughness"]

    def of(rails, seed):
        ensemble = RailEnsemble(rails=rails, seed=seed, transient=2, periods=20, quantile=0.9)
        return sensitivities(SCENE, "peak_slipper_force", names, ensemble=ensemble, steps_per_period=STEPS)

    truth = of(16 * 100, 40)  # rails of 1600 * 40 on: none of the others
    found = xr.concat([of(100, seed) for seed in range(40)], "batch")
    inside = lambda name, error: (abs(found[name] - truth[name]) <= 2 * found[error]).mean("batch")
    value, slope = inside("value", "stderr"), inside("gradient", "gradient_stderr")
    print(f"\ntrue within two errors: value {value.values}, slopes {slope.values}")
    print("relative slopes", truth["relative"].values, truth["gradient_stderr"].values / truth["gradient"].values)
    assert min(value.min(), slope.min()) >= 0.85


def test_a_programme_of_speeds_has_an_ensemble():
    scene = dataclasses.replace(sj.paper_scene(), speed=sj.SpeedProgramme([0.0, 100.0], [50.0, 800.0]))
    assert isinstance(ensemble_for(scene, None), RailEnsemble)
