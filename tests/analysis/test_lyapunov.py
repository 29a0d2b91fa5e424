"""Lyapunov spectra of systems with known exponents, and the functions from which they are computed."""

import dataclasses

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.analysis.floquet import jacobians
from slipperjax.analysis.kinds import KINDS, REGIMES, Regime
from slipperjax.analysis.lyapunov import (
    LyapunovSpectrum,
    dimension_standard_error,
    kaplan_yorke,
    map_spectrum,
    one_motion_standard_error,
    pooled_standard_error,
    regime,
    standard_error,
    weighted_mean,
)
from slipperjax.analysis.ode import ode_spectrum

from ..common import among
from .systems import autoregression, rk4, two_trajectories

LANES = 20


def henon(state, k):
    return {"x": 1 - 1.4 * state["x"] ** 2 + state["y"], "y": 0.3 * state["x"]}


HENON_START = {"x": 0.1, "y": 0.1}


class Rk4(eqx.Module):
    """A step of several classical Runge-Kutta steps, fast to compile."""

    field: object
    dt: float
    steps: int

    def __call__(self, y, k):
        span = self.dt * self.steps
        return rk4(lambda y, t: self.field(k * span + t, y), y, span, self.steps)


def lorenz(t, y):
    return jnp.stack([10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]])


def duffing(t, y):
    return jnp.stack([y[1], 7.5 * jnp.cos(t) - 0.05 * y[1] - y[0] ** 3])


def spread(start, size):
    """Starts of independent runs."""
    return np.asarray(start) + size * np.random.default_rng(5).standard_normal((LANES, len(start)))


def lanes(step, starts, intervals, **options):
    """One run from each start."""
    return sj.jit(jax.vmap(lambda s: map_spectrum(step, s, intervals, **options)))(starts)


def pooled(values, errors):
    """Mean over the lanes, and its standard error."""
    return np.mean(np.asarray(values), axis=0), np.sqrt(np.mean(np.square(errors), axis=0) / len(values))


def scatter(runs):
    """Standard errors as stated, over those that the lanes show; 20 lanes determine the scatter to 16 %."""
    return np.sqrt(np.mean(np.square(runs.stderr), axis=0)) / np.std(runs.per_period, axis=0, ddof=1)


def test_henon_map_and_a_lane_that_diverges():
    first = np.append(spread([0.1], 0.05)[:, 0], 9.0)
    runs = lanes(henon, {"x": first, "y": first}, 4000, align=20)
    assert np.all(np.isnan(runs.history[-1]))
    for values in (runs.per_period, runs.stderr, runs.kaplan_yorke):
        assert np.all(np.isfinite(values[:-1]))
        assert np.all(np.isnan(values[-1]))
    runs = jax.tree.map(lambda a: a[:-1], runs)
    exponents, error = pooled(runs.per_period, runs.stderr)
    np.testing.assert_array_less(np.abs(exponents - [0.41922, -1.62319]), 3 * error)
    assert error.max() < 6e-3  # measured 1.4e-3 and 1.9e-3 on two processors
    np.testing.assert_allclose(np.sum(runs.per_period, axis=-1), np.log(0.3), rtol=1e-12)
    dimension = np.asarray(runs.kaplan_yorke)
    assert abs(dimension.mean() - 1.25827) < 3e-3
    assert np.all((scatter(runs) > 0.6) & (scatter(runs) < 2.5)), scatter(runs)  # measured 1.94
    stated = np.sqrt(np.mean(runs.kaplan_yorke_stderr**2)) / np.std(dimension, ddof=1)
    assert 0.6 < stated < 2.5, stated


LORENZ = Rk4(lorenz, 0.005, 100), spread([1.0, 1.0, 20.0], 3.0), 400, 0.5
UEDA = Rk4(duffing, 2 * np.pi / 400, 400), spread([2.5, 0.0], 0.2), 200, 2 * np.pi
FLOWS = {
    "Lorenz": (LORENZ, [0.9056, 0.0, -14.5723], -41 / 3, 0.012),  # measured 7e-3 to 1e-2 from twelve starts
    "Ueda": (UEDA, [0.1034, -0.1534], -0.05, 4e-3),  # measured 2e-3
}
"""Published exponents, their sum, and the greatest standard error."""


@pytest.mark.parametrize("case", among(FLOWS, "Lorenz"))
def test_exponents_of_flows_are_those_published(case):
    (step, starts, intervals, period), published, total, most = case
    runs = lanes(step, starts, intervals, transient=50, align=50, period=period)
    exponents, error = pooled(runs.per_second, runs.stderr / period)
    np.testing.assert_array_less(np.abs(exponents - published), 3 * error)
    assert error.max() < most
    np.testing.assert_allclose(exponents.sum(), total, atol=2e-4)  # the divergence; measured 6e-6
    # of the first, measured 1.5 to 3.4 from twelve starts; histories of exponents that are zero cancel
    assert 0.6 < scatter(runs)[0] < 4


def decay(t, y, rates):
    return jnp.cos(t) - rates * y


@pytest.mark.full
def test_linear_ode_by_diffrax():
    rates, t0 = jnp.array([1.0, 2.0, 5.0]), 0.3
    options = dict(dt=0.01, steps=100, args=rates, solver=diffrax.Dopri5(), t0=t0, align=30)
    run = ode_spectrum(decay, jnp.ones(3), 20, **options)
    np.testing.assert_allclose(run.per_second, -rates, atol=1e-5)  # measured 9e-11
    assert run.history.shape == (20, 3)
    assert float(run.kaplan_yorke) == 0
    # the steady motion, which shows that the step knows the time
    t = t0 + 50
    np.testing.assert_allclose(run.state, (rates * np.cos(t) + np.sin(t)) / (1 + rates**2), rtol=1e-9)
    by_period = ode_spectrum(decay, jnp.ones(3), 20, period=0.25, **options)
    np.testing.assert_allclose(by_period.per_period, -rates / 4, atol=1e-5)  # an interval of 1 has four periods
    np.testing.assert_allclose(by_period.per_second, -rates, atol=1e-5)


@pytest.fixture(scope="module")
def henon_run():
    return map_spectrum(henon, HENON_START, 30)


def test_the_first_exponent_needs_no_others_and_is_that_of_two_trajectories(henon_run):
    # without the intervals of alignment; few, as chaos amplifies rounding errors
    one = map_spectrum(henon, HENON_START, 20, count=1, align=10)
    np.testing.assert_allclose(one.history[:, 0], henon_run.history[10:, 0], atol=1e-7)  # measured 5e-11
    pair = jax.jit(lambda start: two_trajectories(henon, start, 30))(HENON_START)
    np.testing.assert_allclose(pair, henon_run.history[:, 0], atol=1e-5)  # measured 1.6e-6


def with_memory(state, k):
    """Hénon's map with a memory of x, which has no effect on x or y and is replaced in each step."""
    return {**henon(state, k), "memory": 1e6 * state["x"] * jnp.ones(3)}


def test_a_component_without_weight_is_carried_along(henon_run):
    start = HENON_START | {"memory": np.zeros(3)}
    run = map_spectrum(with_memory, start, 30, count=2, scale=lambda s: {"x": 1.0, "y": 1.0, "memory": 0.0})
    # the first directions may differ, but soon converge
    np.testing.assert_allclose(run.history[20:], henon_run.history[20:], atol=1e-6)  # measured 2e-16
    # y is 0.3 times the previous x, and the memory 1e6 times it; both were divided by the same norms
    expected = np.asarray(run.tangents["y"])[:, None] / 0.3 * 1e6 * np.ones((1, 3))
    np.testing.assert_allclose(run.tangents["memory"], expected, rtol=1e-9)


def test_an_annihilated_direction_starts_anew():
    forget = lambda s, k: jnp.stack([2.0 * s[0], s[1] * 3.0, 0.0 * s[2]])
    run = map_spectrum(forget, jnp.array([0.0, 0.0, 1.0]), 50, align=40)
    np.testing.assert_allclose(run.per_period[:2], np.log([3.0, 2.0]), atol=1e-6)
    assert np.all(run.history[:, 2] < -30)
    tangents = np.asarray(run.tangents)
    np.testing.assert_allclose(tangents @ tangents.T, np.eye(3), atol=1e-14)


def test_index_reaches_the_step():
    grow = lambda s, k: s * jnp.exp(k)
    np.testing.assert_allclose(jacobians(grow, 0.0, 2, index=0.5)[:, 0, 0], np.exp([0.5, 1.5]))
    run = map_spectrum(grow, 0.0, 3, transient=2, align=1, index=10.0, periods=0.5, period=4.0)
    np.testing.assert_allclose(run.history[:, 0], [13.0, 14.0, 15.0])
    np.testing.assert_allclose([run.per_period[0], run.per_second[0]], [28.0, 7.0])


def test_the_error_of_a_dimension_is_that_of_its_change_by_the_exponents():
    first = 0.9 + np.random.default_rng(1).normal(size=4000)
    # where the sum is constant, as here, D = 2 - l1 / l3 with l3 = -13.7 - l1, whose derivative is 13.7 / l3^2
    history = np.stack([first, np.zeros(4000), -13.7 - first], axis=1)
    ratio = dimension_standard_error(history) / one_motion_standard_error(first[:, None])[0]
    np.testing.assert_allclose(ratio, 13.7 / history[:, 2].mean() ** 2, rtol=1e-6)
    assert dimension_standard_error(np.stack([-first, -13.7 - first], axis=1)) == 0


def test_kaplan_yorke_dimension():
    np.testing.assert_allclose(kaplan_yorke([-14.5723, 0.9056, 0.0]), 2 + 0.9056 / 14.5723)
    spectra = [[-1.0, -2.0], [1.0, -0.5], [1.0, -4.0], [0.0, -1.0], [0.0, 0.0], [np.nan, -1.0]]
    np.testing.assert_allclose(kaplan_yorke(spectra), [0.0, 2.0, 1.25, 1.0, 2.0, np.nan])


@pytest.mark.parametrize(("memory", "jump"), [(0.0, 0.0), (0.95, 0.0), (0.0, 3.0)])
def test_standard_error_of_known_processes(memory, jump):
    """White noise, noise with a long memory, and noise plus differences of size `jump`, which cancel in the sum."""
    history, _ = autoregression(memory, 2000, 200)
    history = history + jump * np.diff(np.random.default_rng(4).standard_normal((200, 2001)))
    true = 1 / (1 - memory) / np.sqrt(2000)
    got = standard_error(history[..., None])[:, 0]
    assert 0.8 < np.sqrt(np.mean(got**2)) / true < 1.25  # measured 0.99, 0.99 and 1.04
    assert np.std(got) / true < 0.35  # measured 0.17, 0.23 and 0.22


def logistic(rate, size):
    x, rows = np.random.default_rng(0).uniform(0.1, 0.9, 400), []
    for _ in range(1000 + size):
        rows.append(np.log(np.abs(rate * (1 - 2 * x))))
        x = rate * x * (1 - x)
    rows = np.stack(rows[1000:], axis=1)
    return rows, rows.mean()  # of all motions: its error is a twentieth of that of one


BEFORE_A_TANGENCY = 1 + np.sqrt(8) - 1e-4  # of period 3, with laminar phases of some 300 steps


@pytest.mark.parametrize(
    ("records", "setting", "size", "most"),
    [
        (autoregression, 0.0, 500, 1.15),  # measured 0.80
        (autoregression, 0.98, 500, 1.4),  # measured 1.26, of blocks and quarters alone 1.56
        (autoregression, 0.99, 2000, 1.15),  # measured 1.00, of blocks and quarters alone 1.29
        (logistic, BEFORE_A_TANGENCY, 500, 1.15),  # measured 0.86
    ],
)
def test_errors_of_one_motion_hold_where_its_record_changes_slowly(records, setting, size, most):
    """Root mean squares of errors over stated ones, of 400 records: they scatter by 5 %."""
    history, exact = records(setting, size)
    over = (history.mean(axis=1) - exact) / one_motion_standard_error(history[..., None])[:, 0]
    assert 0.65 < np.sqrt(np.mean(over**2)) < most


def test_errors_of_one_motion_have_the_shape_of_lanes_and_are_those_of_a_drift():
    assert one_motion_standard_error(np.ones((2, 3, 40, 5))).shape == (2, 3, 5)
    for error in (standard_error, one_motion_standard_error):
        assert np.all(np.isnan(error(np.ones((7, 2)))))
        assert np.all(error(np.full((300, 2), 0.25)) == 0)
    # a drift from 0 to 1, of which a record of noise shows nothing else
    drift = np.linspace(0, 1, 800)[:, None] + 1e-6 * np.random.default_rng(0).standard_normal((800, 1))
    assert one_motion_standard_error(drift) > 1 / np.sqrt(12)  # measured 0.33, of blocks and quarters alone 0.16


def test_only_what_a_record_can_know_is_resolved():
    """That an exponent is not positive; not that chaos lasts, and nothing where the errors leave the sign open."""
    random = np.random.default_rng(0)
    of = lambda mean, size=500, noise=0.1: LyapunovSpectrum(
        jnp.asarray(mean + noise * random.standard_normal((size, 1))),
        *(None, None, jnp.asarray(1.0), jnp.asarray(6e-3)),
    )
    for spectrum, words in (
        (of(0.3), "not resolved: one motion does not show whether its chaos lasts"),
        (of(-0.025, size=100), "not resolved: the errors leave the sign open"),
        (of(np.nan), "not resolved"),
        (dataclasses.replace(of(-0.3), status=jnp.asarray(2)), "LyapunovSpectrum(status 2)"),
    ):
        assert not spectrum.resolved
        assert words in repr(spectrum)
    for spectrum in (of(-0.3), of(0.0, noise=1e-3)):
        assert spectrum.resolved
        assert "resolved" not in repr(spectrum)
    lanes = jax.tree.map(lambda a, b: np.stack([a, b]), of(0.3), of(-0.3))
    assert lanes.resolved.tolist() == [False, True]


def ends_late(x, k):
    """A tent map with a hole of one part in a thousand: beyond it the motion falls to a fixed point at 2."""
    tent = 1.999 * jnp.minimum(x, 1 - x) + 1e-3
    return jnp.where((x > 1) | (tent > 0.9995), 2 + 0.5 * (jnp.maximum(x, 1.5) - 2), tent)


def test_chaos_that_ends_after_its_record_is_never_resolved():
    """Of 40 motions most are chaotic for all of 500 iterations, and regular after 20,000 more."""
    starts = np.random.default_rng(0).uniform(0.1, 0.9, 40)
    run = lambda transient: jax.jit(jax.vmap(lambda x: map_spectrum(ends_late, x, 500, transient=transient)))(starts)
    before, after = run(0), run(20_000)
    chaotic = np.asarray(before.per_period)[:, 0] > 0.5
    assert chaotic.sum() >= 15
    assert not before.resolved[chaotic].any()
    assert np.all(np.asarray(after.per_period)[:, 0] < 0)
    assert after.resolved.all()


@pytest.mark.parametrize(
    ("exponent", "stderr", "kind", "trusted", "escapes", "name"),
    [
        (0.30, 0.02, "unresolved", True, 0, "chaotic"),
        (0.30, 0.02, "chaotic", True, 1, "transient chaos"),
        (0.30, 0.02, "chaotic", False, 0, "unresolved"),
        (-0.05, 0.002, "period", True, 0, "periodic"),
        (0.000, 0.001, "torus", True, 0, "regular"),
        (0.50, 0.21, "unresolved", True, 0, "unresolved"),  # neither positive nor known to be zero
        (-0.053, 0.007, "chaotic", True, 0, "unresolved"),  # exponent and recurrence contradict each other
        (0.30, 0.02, "period", True, 0, "unresolved"),
        (np.nan, 0.02, "chaotic", True, 0, "unresolved"),
    ],
)
def test_a_name_needs_an_exponent_that_is_known_and_agrees(exponent, stderr, kind, trusted, escapes, name):
    assert regime(exponent, stderr, kind, trusted, escapes) == name


def test_several_motions_show_correlations_as_long_as_a_record():
    """An autoregression that forgets within 100 of 500 intervals: 300 times of four motions."""
    history = autoregression(np.exp(-1 / 100), 500, 1200)[0].reshape(300, 4, 500, 1)
    scatter = history.mean(axis=(1, 2, 3)).std()
    stated = np.sqrt(np.mean(pooled_standard_error(history) ** 2))
    alone = np.sqrt(np.mean(standard_error(history) ** 2) / 4)
    # measured: 1.02 of several motions, 1.21 of each alone
    assert 0.8 < scatter / stated < 1.25
    assert scatter / alone > 1.1


def test_one_number_stands_for_both_words():
    numbers = Regime.codes(KINDS)
    assert Regime.kind_names(numbers).tolist() == list(KINDS)
    assert Regime.regime_names([*numbers, Regime.TRANSIENT]).tolist() == list(REGIMES)


def test_weighted_mean_of_a_quasi_periodic_series():
    history = 0.3 + np.cos(2 * np.pi * 0.618 * np.arange(300))[:, None]
    assert abs(history.mean() - 0.3) > 1e-4
    np.testing.assert_allclose(weighted_mean(history), 0.3, atol=1e-9)  # measured 7e-16


def test_wrong_arguments():
    for changes, message in (
        (dict(state={}), "`state` must be a pytree of real numbers, but is {}"),
        (dict(count=3), "`count` must be at most 2, the size of the state, but is 3"),
    ):
        with pytest.raises(ValueError, match=message):
            map_spectrum(**(dict(step=henon, state=HENON_START, intervals=10) | changes))
