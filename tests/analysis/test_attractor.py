"""Classification of known attractors: maps, linear oscillators and tori."""

import tracemalloc

import numpy as np
import pytest

from slipperjax.analysis.attractor import classify, mean_turn, rotation_number, zero_one_test
from slipperjax.analysis.kinds import KINDS

GOLDEN = (5**0.5 - 1) / 2


def logistic(rates, periods=500, transient=300):
    """Shape (rates, periods, 1), and the Lyapunov exponents."""
    r = np.asarray(rates, dtype=float)
    x, out = np.full(r.shape, 0.4), []
    for _ in range(transient + periods):
        x = r * x * (1 - x)
        out.append(x)
    strobe = np.stack(out[transient:], -1)
    exponent = np.log(np.maximum(abs(r[:, None] * (1 - 2 * strobe)), 1e-12)).mean(-1)
    return strobe[..., None], exponent


def torus(rotation, periods=500):
    """A closed curve on the section, with a constant rotation along it."""
    a = 2 * np.pi * rotation * np.arange(periods) + 0.1
    r = 1 + 0.3 * np.cos(2 * a) + 0.1 * np.sin(3 * a)
    return np.stack([r * np.cos(a) + 0.2 * np.cos(a) ** 2, 0.5 * r * np.sin(a)], -1)


def spiral(rate, turn, periods):
    """A linear oscillator that approaches a forced motion of period 1."""
    z = np.exp((-rate + 1j * turn) * np.arange(periods))
    return np.stack([1 + 0.5 * z.real, 0.3 + 0.5 * z.imag], -1)


def names(result):
    return [f"{kind} {n}" if n else str(kind) for kind, n in zip(result.kind, result.period, strict=True)]


def test_logistic_periods():
    rates = [2.95, 2.99, 3.01, 3.2, 3.44, 3.46, 3.5, 3.54, 3.55, 3.566, 3.83, 3.845]
    periods = [1, 1, 2, 2, 2, 4, 4, 4, 8, 16, 3, 6]
    result = classify(logistic(rates)[0])
    assert names(result) == [f"period {n}" for n in periods]
    assert "recurs after 2 periods" in str(result.evidence[2])
    assert np.all(result.residual < 1e-4)  # found: 3e-5 [scales], at 2.99, which still decays


def test_logistic_chaos():
    strobe, exponent = logistic([3.575, 3.58, 3.6, 3.65, 3.7, 3.8, 3.9, 4.0])  # the first four in 2 to 8 bands
    assert np.all(exponent > 0.05)
    result = classify(strobe)
    assert names(result) == ["chaotic"] * 8
    assert np.all(result.k > 0.9)  # found: 0.979 and more
    # by intermittency it is never regular
    assert set(classify(logistic([3.8282, 3.8283, 3.8284], transient=1000)[0]).kind) <= {"chaotic", "unresolved"}


def test_at_period_doublings_and_above_the_greatest_period_nothing_is_claimed():
    # the first three doublings, where transients are not geometric; 2e-5 to both sides of them; periods 32 and 64;
    # the end of the cascade, where chaos in many narrow bands looks regular
    doublings = np.array([3.0, 3.449490, 3.544090])
    rates = [*doublings, *(doublings - 2e-5), *(doublings + 2e-5), 3.569, 3.5696, 3.569946, 3.57]
    for transient in (0, 300):
        result = classify(logistic(rates, transient=transient)[0])
        assert names(result) == ["unresolved"] * len(rates)
    # slightly away from the doublings, motions settle within 5000 periods
    strobe, _ = logistic([2.998, 3.002, 3.448, 3.451], transient=5000)
    assert names(classify(strobe)) == ["period 1", "period 2", "period 2", "period 4"]


@pytest.mark.parametrize("turn", [1.3, 2.9])
def test_slow_transients_are_not_tori(turn):
    # 100 periods are five times the decay time: settled to 1 %
    result = classify(spiral(0.05, turn, 100))
    assert (result.kind, result.period) == ("period", 1)
    # the rate of the decay; found: 0.0493 and 0.0505
    rate = str(result.evidence).split("decays by ")[1].split()[0]
    assert float(rate) == pytest.approx(0.05, rel=0.1)
    settled = classify(spiral(0.05, turn, 600))
    assert (settled.kind, settled.period) == ("period", 1)
    assert "recurs" in str(settled.evidence)
    # too slow for the record to show the final motion, but never a torus
    for rate in (2e-3, 5e-4, 1e-4, 2e-5):
        assert classify(spiral(rate, turn, 300)).kind == "unresolved"


def applied(step, x, periods=400):
    """States of a map of one number, (periods, 1)."""
    out = []
    for _ in range(periods):
        out.append([x])
        x = step(x)
    return np.array(out)


@pytest.mark.parametrize("step", [lambda x: 2 * x % 1, lambda x: 1 - 2 * abs(x), lambda x: 10 * x % 1])
def test_a_map_that_loses_its_digits_has_no_period(step):
    """At round numbers after some 53 steps: an artefact of floating point, which a longer record shows no more."""
    strobe = applied(step, 0.7 / np.pi)
    for begin in (0, 10):
        found = classify(strobe[begin:])
        assert (found.kind, found.period) == ("unresolved", 0)
        assert "binary digits step by step, as where a map loses a binary digit" in str(found.evidence)
    found = classify(strobe[100:])
    assert "at round numbers, as at rest, or as where a map loses a binary digit" in str(found.evidence)


def test_what_such_a_map_drives_has_no_period_either():
    """A skew product of a doubling map and a contraction, which goes on to decay at numbers that are not round."""
    x = applied(lambda x: 2 * x % 1, 0.7 / np.pi, 120)[:, 0]
    for rate in (0.3, 0.9):
        driven = np.zeros(len(x))
        for k in range(len(x) - 1):
            driven[k + 1] = rate * driven[k] + x[k] + 0.1
        found = classify(np.stack([x, driven], axis=1))
        assert (found.kind, found.period) == ("unresolved", 0)
        # without the record of the map that drives it, it is a decay
        assert classify(driven[60:, None]).kind == "period"


@pytest.mark.parametrize("digits", [53, 24, 16])
def test_coming_to_rest_from_chaos_loses_no_digits(digits):
    """As by dry friction, and by signals of so many binary digits."""
    for seed in range(20):
        x = np.random.default_rng(seed).random(100)
        x[60:] = 0.5
        found = classify(np.ldexp(np.round(np.ldexp(x, digits)), -digits)[:, None])
        assert (found.kind, found.period) == ("period", 1)


@pytest.mark.parametrize(
    ("step", "period"), [(lambda x: 2 * x * (1 - x), 1), (lambda x: min(2 * min(x, 1 - x), 0.75), 2)]
)
def test_superstable_motions_at_round_numbers_keep_their_period(step, period):
    """A parabola with its top on the diagonal, and a tent without its top; the second after a chaotic transient."""
    for x in (0.1234567, 1 / np.pi, 0.77):
        found = classify(applied(step, x))
        assert "round numbers" in str(found.evidence)
        assert (found.kind, found.period) == ("period", period)
    # a superstable motion at other numbers leaves no doubt
    top = (1 + 5**0.5) / 4
    found = classify(applied(lambda x: 4 * top * x * (1 - x), 0.3))
    assert (found.kind, found.period) == ("period", 2)
    assert "round" not in str(found.evidence)


def test_tori():
    strobe = np.stack([torus(x) for x in (GOLDEN, 2**0.5 - 1, 0.1003, 0.0123)])
    result = classify(strobe)
    assert names(result) == ["torus"] * 4
    assert np.all(abs(result.k) < 0.15)  # found: 0.107
    # two torus frequencies beside the forcing, in ten states of very different units
    a = 2 * np.pi * np.arange(800) * np.array([[GOLDEN], [2**0.5 / 7]])
    waves = np.concatenate([np.cos(a), np.sin(a), np.cos(a[:1] + a[1:])])
    units = 10.0 ** np.linspace(-6, 2, 10)
    states = (np.random.default_rng(0).standard_normal((10, 5)) @ waves).T * units
    assert classify(states, scales=units).kind == "torus"
    # a locked torus of a long period, and one so close to locking that it does not complete a turn
    assert set(classify(np.stack([torus(34 / 55), torus(0.2501)])).kind) == {"unresolved"}
    assert classify(torus(3 / 11)).period == 11


def test_motions_that_are_no_torus_have_the_true_reason():
    turn = np.arange(4000)[:, None] * (np.pi - 3) * 2 * np.pi
    # close to 16 turns in 113 periods: 4000 periods show this, and 1000 do not
    rigid = np.hstack([np.cos(turn), np.sin(turn)])
    assert classify(rigid[:1000]).kind == "torus"
    reason = "but states of the second half are 9 times as far from those of the first half as from each other: "
    assert str(classify(rigid).evidence).endswith(f"{reason}a slow drift, or a torus near a long period")
    assert "but the states still drift" in str(
        classify(torus(GOLDEN, 1000) + np.linspace(0, 0.05, 1000)[:, None]).evidence
    )
    assert "residuals over all lags change together" in str(classify(spiral(1e-4, 2.0, 1000)).evidence)


def test_neimark_sacker_bifurcation():
    # x_{k+1} = a x_k (1 - x_{k-1}): a torus bifurcates from the fixed point at a = 2, and locks to 7 periods at 2.2
    rates = {1.95: "period 1", 2.0: "unresolved", 2.05: "torus", 2.15: "torus", 2.2: "period 7", 2.27: "chaotic"}
    a = np.array(list(rates))
    x, y, out = np.full(6, 0.5), np.full(6, 0.51), []
    for _ in range(2500):
        x, y = a * x * (1 - y), x
        out.append((x, y))
    assert names(classify(np.moveaxis(np.array(out[2000:]), -1, 0))) == list(rates.values())


def test_short_records_are_periodic_or_unresolved():
    strobe = np.stack([torus(GOLDEN, 100), np.repeat(logistic([4.0], 100)[0][0], 2, axis=1)])
    result = classify(strobe)
    assert names(result) == ["unresolved", "unresolved"]
    assert all("too few" in text for text in result.evidence)
    assert np.isnan(result.k).all()
    assert names(classify(logistic([3.5, 3.83], 40)[0])) == ["period 4", "period 3"]


def test_shapes_and_cases_that_are_not_finite():
    r = [[2.9, 3.2, 3.5], [3.8, 3.83, 3.9]]
    strobe = logistic(np.ravel(r))[0].reshape(2, 3, 500, 1).copy()
    strobe[1, 2, 40:] = np.nan
    result = classify(strobe)
    assert all(np.shape(x) == (2, 3) for x in result)
    assert result.kind.tolist() == [["period"] * 3, ["chaotic", "period", "unresolved"]]
    assert result.period.tolist() == [[1, 2, 4], [0, 3, 0]]
    assert set(result.kind.ravel()) <= set(KINDS)
    assert "non-finite states from period 40" in result.evidence[1, 2]
    one = classify(strobe[0, 1], scales=strobe[..., :1, :].max((0, 1, 2), initial=0, where=strobe[..., :1, :] > 0))
    assert one.kind.shape == ()
    assert one.period == 2


def test_rounding_of_a_state_that_is_zero_by_symmetry_does_not_count():
    strobe = np.tile([1.0, 0.0], (300, 1))
    strobe[:, 1] = 1e-17 * np.random.default_rng(0).standard_normal(300)
    assert names(classify(strobe[None])) == ["period 1"]
    # but its growth counts: the symmetric motion is unstable
    strobe[:, 1] = 1e-13 * np.exp(0.04 * np.arange(300)) * np.cos(np.arange(300))
    result = classify(strobe, scales=[1.0, 1.0])
    assert result.kind == "unresolved"
    assert "grows" in str(result.evidence)
    # a motion just above the floor is never classified as chaotic
    strobe[:, 1] = 1e-5 * logistic([4.0], 300)[0][0, :, 0]
    result = classify(strobe, scales=[1.0, 1.0])
    assert result.kind == "unresolved"
    assert "near the floor" in str(result.evidence)


@pytest.mark.parametrize("states", [1, 4])
def test_noise_is_not_chaos(states):
    result = classify(np.random.default_rng(0).standard_normal((500, states)))
    assert result.kind == "unresolved"
    assert result.k > 0.95


def test_rotation_numbers():
    angle = 2 * np.pi * GOLDEN * np.arange(400)
    wobble = angle + 0.3 * np.sin(angle)
    both = np.stack([wobble, np.angle(np.exp(1j * wobble)), -wobble])
    # of a plain mean 1e-4
    np.testing.assert_allclose(mean_turn(both), np.mod([GOLDEN, GOLDEN, -GOLDEN], 1), rtol=0, atol=1e-10)
    # turns to both sides of none
    assert mean_turn(0.5 * np.sin(angle)) == pytest.approx(0.0, abs=1e-8)
    assert mean_turn(2 * np.pi / 3 * np.arange(10)) == pytest.approx(1 / 3)


def test_rotation_numbers_of_states():
    phase = 2 * np.pi * GOLDEN * np.arange(1000)
    curve = np.stack([np.cos(phase) + 0.2 * np.cos(2 * phase), np.sin(phase), 0.3 * np.sin(3 * phase)], axis=-1)
    # in any direction, from 0 to 1/2
    found = rotation_number(np.stack([curve, curve[::-1], curve[:, ::-1]]))
    np.testing.assert_allclose(found, min(GOLDEN, 1 - GOLDEN), rtol=0, atol=1e-10)  # measured 1e-16
    assert np.isnan(rotation_number(np.random.default_rng(0).standard_normal((500, 2))))
    with pytest.raises(ValueError, match="`states` must be of three periods or more and of two numbers or more"):
        rotation_number(curve[:, :1])


def test_long_records_take_no_memory_of_all_pairs():
    """529 MB at 4000 periods with a matrix of all distances."""
    x = logistic([3.9], 4000)[0][0]
    tracemalloc.start()
    found = classify(x)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(found.kind) == "chaotic"
    assert peak < 3e7  # measured 5e6


def test_zero_one_test():
    k = np.arange(1000)
    noise = np.random.default_rng(0).standard_normal(1000)
    chaos = logistic([4.0], 1000)[0][0, :, 0]
    series = np.stack([np.cos(2 * np.pi * GOLDEN * k), chaos, k % 4, np.ones(1000), noise])
    result = zero_one_test(series)
    # found: -0.009, 0.997, -0.008, 0 and 0.998
    assert np.all(abs(result[[0, 2, 3]]) < 0.05)
    assert np.all(result[[1, 4]] > 0.98)
    # equal to the sums as written by Gottwald and Melbourne
    c = np.random.default_rng(5).uniform(np.pi / 5, 4 * np.pi / 5, 1)[0]
    phi = series[1, :100]
    p, q = np.cumsum(phi * np.cos(c * k[:100])), np.cumsum(phi * np.sin(c * k[:100]))
    steps = np.arange(1, 11)
    mean = [np.mean((p[n : n + 90] - p[:90]) ** 2 + (q[n : n + 90] - q[:90]) ** 2) for n in steps]
    damped = mean - phi.mean() ** 2 * (1 - np.cos(steps * c)) / (1 - np.cos(c))
    expected = np.corrcoef(steps, damped)[0, 1]
    assert zero_one_test(phi, samples=1, seed=5) == pytest.approx(expected, abs=1e-10)  # found: 4e-16
    assert np.isnan(zero_one_test(np.full((2, 50), np.nan))).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: classify(x[:, 0]), "`strobe` must be of shape"),
        (lambda x: classify(x[:, :1] + 1j * x[:, 1:2]), "`strobe` must be real: .* real and imaginary parts"),
        (lambda x: mean_turn(x[:2, 0]), "`angle` must be of three periods or more"),
        (lambda x: classify(x[:15]), "`strobe` must be of shape .* with 16 periods or more"),
        (lambda x: classify(x, scales=[1.0, 2.0, 3.0]), "`scales` must be of shape"),
        (lambda x: classify(x, scales=[1.0, 0.0]), "`scales` must be positive"),
        (lambda x: zero_one_test(x[:39, 0]), "`series` must be of 40 periods or more"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call(torus(GOLDEN, 50))
