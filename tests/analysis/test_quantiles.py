"""Quantiles over conditions, and their errors, on samples whose quantiles are known."""

import numpy as np
import pytest
import scipy.stats
import xarray as xr

import slipperjax as sj
from slipperjax.analysis.quantiles import (
    bootstrap,
    check_quantile,
    estimate,
    mean_plane,
    quantile_interval,
    quantile_plane,
    range_factor,
    sample_fit,
)
from slipperjax.flow.status import Status
from slipperjax.sweeps import over_rails

CORNERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])


def test_a_plane_has_its_share_of_the_values_below():
    draws = np.random.default_rng(0)
    signs = np.repeat(CORNERS, 500, axis=0)
    system, scale = np.column_stack([np.ones(len(signs)), signs]), 2 + 0.5 * signs[:, 0]
    values = 1e4 * (5 + signs[:, 1] + scale * draws.gumbel(size=len(signs)))
    plane = quantile_plane(system, values, 0.9, np.ones(len(signs)))
    assert np.mean(values <= system @ plane + 1e-6) == pytest.approx(0.9, abs=2e-3)
    q = scipy.stats.gumbel_r.ppf(0.9)
    # the true plane; measured 1.1, 3.8 and 0.7 % of the intercept off, with standard errors of 4.3, 2.2 and 1.5 %
    np.testing.assert_allclose(plane, 1e4 * np.array([5 + 2 * q, 0.5 * q, 1.0]), rtol=0, atol=0.05e4 * (5 + 2 * q))
    twice = quantile_plane(system, values, 0.9, np.full(len(signs), 2.0))
    np.testing.assert_allclose(twice, plane, rtol=1e-9)


def test_a_mean_plane_is_that_of_least_squares():
    draws, signs = np.random.default_rng(0), np.repeat(CORNERS, 5, axis=0)
    system, values = np.column_stack([np.ones(len(signs)), signs]), draws.normal(size=20)
    weights = draws.integers(0, 3, 20).astype(float)
    again = np.repeat(np.arange(20), weights.astype(int))
    expected = np.linalg.lstsq(system[again], values[again], rcond=None)[0]
    np.testing.assert_allclose(mean_plane(system, values, weights), expected, rtol=0, atol=1e-12)


def test_the_bootstrap_gives_the_error_of_a_mean():
    values = np.random.default_rng(0).normal(size=400)
    value, drawn = bootstrap(lambda w: np.atleast_1d(w @ values / w.sum()), len(values), resamples=2000)
    assert value[0] == pytest.approx(values.mean())
    # closed form; measured 0.6 % apart
    assert drawn.std(ddof=1) == pytest.approx(values.std() / np.sqrt(len(values)), rel=0.05)


def runs(rails, starts, cases, draws, share=0.5):
    """Runs of equal cases over the same rails: an effect of the rail, and one of each run."""
    return draws.gumbel(size=(rails, 1, 1)) + share * draws.normal(size=(rails, starts, cases))


def held(rails, starts, quantile, repeats, share=0.5):
    """Return the share of 95 % intervals that hold a quantile."""
    draws = np.random.default_rng(0)
    truth = np.quantile(runs(200_000, 1, 1, draws, share), quantile)
    inside = []
    for _ in range(repeats):
        low, high = quantile_interval(runs(rails, starts, 1, draws, share), quantile)
        inside.append(low[0] <= truth <= high[0])
    return np.mean(inside)


@pytest.mark.parametrize(("rails", "starts", "quantile"), [(20, 1, 0.5), (20, 4, 0.5), (80, 1, 0.95), (80, 4, 0.95)])
def test_intervals_hold_a_quantile_where_runs_share_their_rails(rails, starts, quantile):
    # measured 0.95 to 0.98, with an error of 0.01
    assert held(rails, starts, quantile, 300) > 0.92


def test_standard_errors_are_the_scatter_of_quantiles():
    draws = np.random.default_rng(0)
    found = [estimate(runs(80, 1, 1, draws), 0.95, resamples=40) for _ in range(300)]
    # measured 1.17, and 1.52 for a quarter of the interval, with an error of 0.05
    ratio = np.mean([one.stderr for one in found]) / np.std([one.value for one in found])
    assert 0.9 < ratio < 1.35


def test_runs_that_are_equal_are_worth_one():
    rails = np.random.default_rng(0).normal(size=(100, 1, 1))
    np.testing.assert_array_equal(quantile_interval(np.tile(rails, (1, 4, 1)), 0.9), quantile_interval(rails, 0.9))


def claimed(cases, rails, starts, quantile, repeats):
    """Return in what share of comparisons of equal cases the lowest one is claimed to be lower than another."""
    draws = np.random.default_rng(0)
    claims = []
    for repeat in range(repeats):
        numbers = runs(rails, starts, cases, draws)
        best = int(np.argmin(sample_fit(numbers, quantile)(np.ones(rails))))
        found = estimate(numbers, quantile, best, resamples=60, seed=repeat)
        claims.append(np.any(found.difference_low > 0))
    return np.mean(claims)


def test_the_best_of_equal_cases_is_seldom_called_better():
    # Tukey's factors, as tables have them
    factors = [range_factor(cases, 10_000) for cases in (2, 3, 5, 10)]
    np.testing.assert_allclose(factors, [1.960, 2.344, 2.728, 3.164], atol=2e-3)
    # measured 0.05; with two errors either side 0.69
    assert claimed(10, 40, 1, None, 150) < 0.15


def sample(rails, seed, shift=0.3):
    """Values of three designs that have most of their randomness in common."""
    draws = np.random.default_rng(seed)
    common, own = draws.gumbel(size=rails), draws.normal(size=(3, rails))
    values = 10 + common + shift * np.arange(3)[:, None] + 0.2 * own
    return xr.DataArray(values, dims=("clearance", "track.seed"), attrs={"units": "kN"})


def test_rails_with_a_lost_run_are_left_out_in_all_cases():
    values = sample(100, 0)
    lost = values.copy()
    lost[1, [4, 7]] = np.nan
    with pytest.warns(sj.ImplausibleWarning, match="2 of 100 rails are left out, .*: track.seed 4 and 7"):
        found = over_rails(lost, 0.9)
    xr.testing.assert_identical(found, over_rails(values.drop_isel({"track.seed": [4, 7]}), 0.9))
    assert found.attrs["rails"] == 98
    for quantile, left in ((0.9, 39), (None, 1)):
        with pytest.warns(sj.ImplausibleWarning, match=f"{100 - left} of 100 rails"):
            few = over_rails(values.where(np.arange(100) < left), quantile)
        assert all(np.isnan(few[name]).all() for name in few)


@pytest.mark.parametrize(("quantile", "least"), [(0.5, 8), (0.9, 40), (0.95, 80), (0.99, 400), (0.05, 80)])
def test_four_rails_lie_beyond_a_quantile(quantile, least):
    check_quantile(quantile, least)
    with pytest.raises(
        ValueError, match=f"`rails` must be {least} or more for the quantile {quantile}, with 4 of them"
    ):
        check_quantile(quantile, least - 1)
    # no interval by order statistics would have both ends with less than three
    beyond = max(quantile, 1 - quantile) ** least
    assert 0.003 < beyond < 0.025


def test_more_steps_that_change_a_quantile_are_told():
    """In chaos a run with half the step is another one: only the distribution may be compared."""
    values = sample(400, 0).assign_coords({"track.seed": np.arange(400)})
    seeds = np.arange(300, 400)[::-1]
    other = sample(100, 1).assign_coords({"track.seed": seeds})
    alike = over_rails(values, 0.9, finer=other)
    assert np.all(alike["status"] == Status.FINITE)
    assert np.all(np.abs(alike["step_change"]) < 3 * alike["step_change_stderr"])
    lower = over_rails(values, 0.9, finer=0.7 * other.transpose("track.seed", "clearance"))
    assert np.all(lower["status"] == Status.INACCURATE)
    np.testing.assert_allclose(lower["step_change"], -0.3, atol=0.1)
    # compared on the same rails: those with more steps, in their order
    same = over_rails(values, 0.9, finer=1.2 * values.sel({"track.seed": seeds}))
    np.testing.assert_allclose(same["step_change"], 0.2, rtol=1e-12)
    np.testing.assert_allclose(same["step_change_stderr"], 0.0, atol=1e-12)
    assert np.all(same["status"] == Status.INACCURATE)
    lost = over_rails(values, 0.9, finer=other.where(other < 10))
    assert np.isnan(lost["step_change"]).all()
    assert np.all(lost["status"] == Status.INACCURATE)
    for wrong, words in (
        (other.assign_coords({"track.seed": seeds + 300}), "on rails that are among those of `values`"),
        (other.isel(clearance=0), "have the dimensions track.seed, clearance"),
        (3.0, "be an xarray.DataArray"),
    ):
        with pytest.raises(ValueError, match=f"Argument `finer` must .*{words}"):
            over_rails(values, 0.9, finer=wrong)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(quantile=1.0), "Argument `quantile` must be a share between 0 and 1, or None"),
        (dict(dim="seed"), "Argument `dim` must be one of clearance, track.seed"),
    ],
)
def test_bad_questions_name_what_is_wrong(change, words):
    arguments = dict(values=sample(10, 0), quantile=0.5) | change
    with pytest.raises(ValueError, match=words):
        over_rails(**arguments)
