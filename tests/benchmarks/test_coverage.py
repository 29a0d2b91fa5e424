"""How often intervals over rails hold the truth, and how often equal designs are told apart, by drawn numbers.

    pytest -m benchmark -s tests/benchmarks/test_coverage.py

A run's number is an effect of its rail, by Gumbel's distribution as that of a maximum, and a normal one of the run.
Nothing is simulated: the numbers go through the functions that results go through.
"""

import numpy as np
import pytest

from slipperjax.analysis.quantiles import estimate, least_rails
from slipperjax.design import RailEnsemble
from slipperjax.design.ensembles import box_corners

from ..analysis.test_quantiles import claimed, held, runs

pytestmark = pytest.mark.benchmark
SHARES = (0.2, 0.5, 2.0)
"""Of what a run has alone, in multiples of what its rail has."""


def test_intervals_of_quantiles():
    """Of one case, of the fewest rails that a quantile takes and of more."""
    print("\n\n95 % intervals that hold a quantile [%], by what runs have alone")
    print("rails  starts  quantile" + "".join(f"{share:8g}" for share in SHARES))
    for rails, quantile in ((8, 0.5), (32, 0.5), (40, 0.9), (80, 0.95), (400, 0.99)):
        assert rails >= least_rails(quantile)
        for starts in (1, 4):
            found = [held(rails, starts, quantile, 1000, share) for share in SHARES]
            print(f"{rails:5}{starts:8}{quantile:10g}" + "".join(f"{100 * share:8.1f}" for share in found))


def test_equal_designs():
    print("\n\ncomparisons of equal designs that call one better [%], of 400")
    print("designs  20 x 4, median  80 x 1, 0.95  40 x 1, mean")
    for cases in (2, 3, 5, 10):
        kinds = ((20, 4, 0.5), (80, 1, 0.95), (40, 1, None))
        print(f"{cases:7}" + "".join(f"{100 * claimed(cases, *of, 400):15.1f}" for of in kinds))


def test_planes_over_rails():
    """Values and slopes of designs within two standard errors, by the number of variables and the kind of track."""
    tracks = {"seeds, 0.95": (RailEnsemble(), 80, 60), "10 surveys, mean": (RailEnsemble(quantile=None), 10, 400)}
    print("\n\nwithin two errors [%]")
    print("rails             variables  value  slopes")
    for name, (ensemble, rails, repeats) in tracks.items():
        for variables in (1, 2, 4):
            corners = box_corners(variables)
            rail = np.arange(ensemble.rails) % rails
            draws = np.random.default_rng(variables)
            many = runs(400_000, 1, 1, draws)
            truth = many.mean() if ensemble.quantile is None else np.quantile(many, ensemble.quantile)
            inside = []
            for _ in range(repeats):
                common = draws.gumbel(size=rails)[rail]
                values = common + 0.5 * draws.normal(size=(len(corners), ensemble.rails))
                plane = ensemble.fit(corners, values[..., None], np.ones_like(values, bool), rail)
                inside.append([abs(plane.value[0] - truth) < 2 * plane.stderr[0]])
                inside[-1] += list(np.abs(plane.slope[0]) < 2 * plane.slope_stderr[0])
            value, *slopes = np.mean(inside, axis=0)
            print(f"{name:18}{variables:9}{100 * value:7.1f}{100 * np.mean(slopes):8.1f}")


def test_intervals_of_differences():
    print("\n\n95 % intervals of a difference between two of some designs that hold it [%], of 400")
    for rails, starts, quantile in ((80, 1, 0.95), (80, 4, 0.95), (20, 4, 0.5)):
        draws, inside = np.random.default_rng(0), []
        for repeat in range(400):
            found = estimate(runs(rails, starts, 2, draws), quantile, resamples=100, seed=repeat)
            inside.append(found.difference_low[1] <= 0 <= found.difference_high[1])
        print(f"{rails} rails x {starts}, quantile {quantile}: {100 * np.mean(inside):.1f}")
