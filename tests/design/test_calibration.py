"""Standard errors of slopes by ensembles in chaos, against ensembles sixteen times as large.

pytest -m slow -s tests/design/test_calibration.py
"""

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.ensembles import EnsembleSettings
from slipperjax.design.judge import ensemble_averages
from slipperjax.design.objectives import OBJECTIVES, Evaluation, EvaluationPlan
from slipperjax.flow.period_map import advance, initial_states
from slipperjax.orbits.simulate import dynamic_steps
from slipperjax.sweeps.grid import Cases
from slipperjax.sweeps.orbits import rows_of

STEPS = 50
SEEDS = 17
"""Ensembles of each case: each is judged by all the others together."""
OBJECTIVES_IN_CHAOS = (OBJECTIVES["rms_a_z"], OBJECTIVES["contact_load"], OBJECTIVES["peak_force"].smooth)
# length [m], speed [m/s], clearance [m]: those of 1050 and 1250 m/s were chosen between chaotic neighbours, the
# others are chaotic by recurrence over 448 periods after 400
CASES = np.array(
    [
        *((0.10, speed, 1e-3) for speed in (1000, 1050, 1100, 1200, 1300)),
        *((0.11, speed, 1e-3) for speed in (1000, 1100, 1200)),
        *((0.12, speed, 1e-3) for speed in (1000, 1200)),
        (0.13, 1300, 1e-3),
        (0.11, 1200, 1.5e-3),
        *((0.12, speed, 1.5e-3) for speed in (1000, 1100, 1200, 1250, 1300, 1400)),
        *((0.13, speed, 1.5e-3) for speed in (1200, 1300)),
    ]
)


class Calibration(NamedTuple):
    """Slopes by length over the objective and the length [1], arrays (seeds, cases, objectives)."""

    slope: np.ndarray
    stderr: np.ndarray

    @property
    def others(self) -> np.ndarray:
        """The mean slope of all other seeds."""
        return (self.slope.sum(axis=0) - self.slope) / (len(self.slope) - 1)

    @property
    def score(self) -> np.ndarray:
        """Differences from all other seeds, over the standard error of the difference."""
        square = self.stderr**2
        others = (square.sum(axis=0) - square) / (len(square) - 1) ** 2
        return (self.slope - self.others) / np.sqrt(square + others)


def grid_of(cases):
    return dict(zip(("length", "speed", "clearance"), np.transpose(cases), strict=True))


def kinds(cases):
    """Kinds of motion of cases."""
    options = dict(product=False, steps_per_period=STEPS, transient=400, periods=448)
    return sj.sweep(sj.paper_scene(), grid_of(cases), record="motion", **options)["kind"].values


def settled(cases, periods=200):
    """States of cases after some forcing periods."""
    runs = Cases(sj.paper_scene(), grid_of(cases), sj.table_2_start(), product=False)
    scenes, starts = runs.take(np.arange(len(cases)))
    options = dict(solver=sj.solvers.RK4(), periods=periods)
    return advance(scenes, initial_states(scenes, starts), 0.0, dynamic_steps(STEPS), **options).state


def calibration(cases, objectives=OBJECTIVES_IN_CHAOS, seeds=SEEDS, settings=EnsembleSettings()):
    """Slopes by `seeds` ensembles of each case, one after the other."""
    # one reach for all, the default at their median length
    reach = {"length": EnsembleSettings.relative_reach * float(np.median(cases[:, 0]))}
    rows, evaluations = rows_of(settled(cases)), []
    options = dict(scene=sj.paper_scene(), names=("length",), objectives=objectives, start=sj.table_2_start())
    options |= dict(solver=sj.solvers.RK4(), steps=STEPS, most_steps=STEPS, reach=reach, transient=200)
    for seed in range(seeds):
        plan = EvaluationPlan(ensemble=dataclasses.replace(settings, seed=seed), **options)
        evaluations.append(ensemble_averages(plan, grid_of(cases), Evaluation.of_states(plan, rows)))
    value = np.mean([one.value for one in evaluations], axis=0)
    size = value / cases[:, :1]
    of = lambda name: np.stack([getattr(one, name)[..., 0] for one in evaluations]) / size
    return Calibration(of("gradient"), of("gradient_stderr"))


def show(cases, slopes, objectives=OBJECTIVES_IN_CHAOS):
    """Prints a row for each case, and the shares of all."""
    print("\nd ln(objective) / d ln(length): all ensembles; ensemble 0 with its standard error; share of ensembles")
    print("within two standard errors of all the others\n")
    for k, one in enumerate(objectives):
        print(f"{one.name}\n  length   speed  clearance      all       ensemble 0        share")
        inside = np.abs(slopes.score[..., k]) <= 2
        for j, (length, speed, clearance) in enumerate(cases):
            every = slopes.slope[:, j, k]
            mean, error = every.mean(), every.std(ddof=1) / np.sqrt(len(every))
            print(
                f"  {length:.2f} m {speed:5.0f} m/s {clearance * 1e3:.1f} mm {mean:7.2f} +- {error:4.2f} "
                f"{slopes.slope[0, j, k]:7.2f} +- {slopes.stderr[0, j, k]:4.2f}  {inside[:, j].mean():5.2f}"
            )
        print(
            f"  ensemble 0: {inside[0].sum()} of {len(cases)} cases; all: {inside.mean():.3f}; "
            f"standard deviation of the scores {slopes.score[..., k].std():.2f}"
        )


@pytest.mark.slow
def test_the_slope_of_large_ensembles_is_within_two_standard_errors():
    assert np.sum(kinds(CASES) == "chaotic") >= 18  # two were chosen between neighbours, and not looked at alone
    slopes = calibration(CASES)
    show(CASES, slopes)
    share = np.mean(np.abs(slopes.score) <= 2, axis=(0, 1))
    # Student's t with 30 degrees of freedom: 94.5 %; measured 97.1, 94.1 and 94.7 % of 340
    assert np.all(share > 0.9), share
