"""Maps with impacts and sections beside closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slipperjax.analysis.floquet import jacobians, multipliers
from slipperjax.analysis.hybrid import impact_step, return_step, share_before, switched_step
from slipperjax.analysis.lyapunov import map_spectrum
from slipperjax.analysis.shooting import shoot

from ..pages import ROOT, blocks
from .systems import Stopped

DAMPING, FREQUENCY, GAP, RESTITUTION = 0.1, 2.2, 0.15, 0.8
PERIOD = 2 * np.pi / FREQUENCY


def swinging(t, s):
    return jnp.stack([s[1], jnp.cos(FREQUENCY * t) - 2 * DAMPING * s[1] - s[0]])


def stopped(restitution=RESTITUTION, steps=400):
    """An oscillator below a rigid stop, over a period."""
    rebound = lambda t, s: jnp.stack([s[0], -restitution * s[1]])
    return impact_step(swinging, lambda t, s: GAP - s[0], rebound, dt=PERIOD / steps, steps=steps)


EXACT = Stopped(*map(jnp.asarray, (DAMPING, FREQUENCY, 1.0, GAP, np.inf, RESTITUTION)))


@pytest.mark.full
def test_impacts_and_their_jacobians_are_those_of_the_closed_form():
    state = jnp.array([0.1, 0.3])
    slopes, (end, touches, _) = jax.jit(jax.jacfwd(lambda s: 2 * (EXACT.followed(s),), has_aux=True))(state)
    assert touches >= 1
    step = stopped()
    np.testing.assert_allclose(eqx.filter_jit(step)(state, 0.0), end, rtol=0, atol=1e-9)  # measured 5e-11
    np.testing.assert_allclose(jacobians(step, state, 1)[0], slopes[0], rtol=0, atol=5e-9)  # measured 3e-10
    reverse = jax.jit(jax.jacrev(lambda s: stopped(steps=40)(s, 0.0)))(state)
    np.testing.assert_allclose(
        reverse, jacobians(stopped(steps=40), state, 1)[0], rtol=0, atol=1e-13
    )  # measured 1e-15


@pytest.mark.full
def test_derivatives_by_what_a_step_closes_over_are_those_of_its_loop():
    state = jnp.array([0.1, 0.3])
    # the second without the rule for both modes, in the forward mode that loops have
    through = lambda e: stopped(e, steps=40)(state, 0.0)[0]
    plain = lambda e: stopped(e, steps=40)._interval(state, 0.0)[0]
    e = jnp.asarray(RESTITUTION)
    expected = jax.jit(jax.jacfwd(plain))(e)
    assert abs(expected) > 0.1
    for mode in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(jax.jit(mode(through))(e), expected, rtol=1e-12)  # measured 2e-16


@pytest.mark.full
def test_an_orbit_with_an_impact_contracts_areas_by_damping_and_restitution():
    orbit = shoot(stopped(), jnp.array([0.1, 0.3]), tolerance=1e-12)
    assert orbit.residual < 1e-12
    np.testing.assert_allclose(
        eqx.filter_jit(EXACT)(orbit.state, 0.0), orbit.state, rtol=0, atol=2e-9
    )  # measured 1e-10
    touches = int(EXACT.followed(orbit.state)[1])
    assert touches == 1
    area = RESTITUTION ** (2 * touches) * np.exp(-2 * DAMPING * PERIOD)
    found = multipliers(jacobians(stopped(), orbit.state, 1))
    np.testing.assert_allclose(np.prod(found), area, rtol=2e-9)  # measured 1e-10


def test_returns_to_a_section_are_those_of_a_focus():
    decay, turn = 0.1, 3.0
    field = lambda t, s: jnp.stack([-decay * s[0] - turn * s[1], turn * s[0] - decay * s[1]])
    step = return_step(field, lambda t, s: -s[1], dt=0.01)  # from y rising through zero
    factor = np.exp(-decay * 2 * np.pi / turn)
    ends = jax.jit(jax.vmap(lambda x: step(jnp.stack([x, 0 * x]), 0.0)))(jnp.array([0.5, 2.0]))
    np.testing.assert_allclose(
        ends, np.array([[0.5, 0.0], [2.0, 0.0]]) * factor, rtol=0, atol=3e-8
    )  # measured 7e-9, of RK4
    found = multipliers(jacobians(step, jnp.array([1e-3, 0.0]), 1))
    np.testing.assert_allclose(found, [factor, 0.0], rtol=0, atol=2e-8)  # measured 4e-9
    lost = return_step(field, lambda t, s: -s[1], dt=0.01, most=100)  # a turn takes 209 steps
    assert np.all(np.isnan(lost(jnp.array([1.0, 0.0]), 0.0)))


GRAVITY = 9.81
BOTH_MODES = [(one, other) for one in (jax.jacfwd, jax.jacrev) for other in (jax.jacfwd, jax.jacrev)]


def falling(restitution, dt, steps, make=impact_step):
    """A ball above a floor; the second form carries the time."""
    field = lambda t, s: jnp.stack([s[1], -GRAVITY * jnp.ones_like(s[1])])
    rebound = lambda t, s: jnp.stack([s[0], -restitution * s[1]])
    return make(field, lambda t, s: s[0], rebound, dt=dt, **({"steps": steps} if make is impact_step else {}))


def bounced(state, restitution, time):
    """The state of the ball after one rebound, in closed form."""
    speed = jnp.sqrt(state[1] ** 2 + 2 * GRAVITY * state[0])
    left, up = time - (state[1] + speed) / GRAVITY, restitution * speed
    return jnp.stack([up * left - GRAVITY * left**2 / 2, up - GRAVITY * left])


def cubics():
    """Coefficients, the lowest first, of gaps that end below zero: falling, rising first, turning, from zero."""
    random = np.random.default_rng(0)
    start = np.concatenate([10.0 ** random.uniform(-12, 0, 300), np.zeros(100), -1e-17 * random.uniform(0, 1, 100)])
    slope = random.normal(size=500) * 10.0 ** random.uniform(-3, 1, 500)
    slope[300:] = np.abs(slope[300:])
    square = random.normal(size=500) * 10.0 ** random.uniform(-3, 1, 500)
    end = -(10.0 ** random.uniform(-9, 1, 500))
    return np.stack([start, slope, square, end - start - slope - square], axis=1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_instant_of_a_crossing_is_where_the_gap_goes_to_its_sign_at_the_end(sign):
    gap = lambda c: lambda t, x: sign * (c[0] + c[1] * x + c[2] * x**2 + c[3] * x**3)
    found = jax.jit(jax.vmap(lambda c: share_before(gap(c), lambda x: x, 0.0, 1.0, jnp.asarray(True))))
    coefficients = cubics()
    shares, kinds = np.asarray(found(coefficients)), set()
    for c, share in zip(coefficients, shares, strict=True):
        slope = np.polyder(np.poly1d(c[::-1]))
        roots = np.roots(c[::-1])
        real = roots[np.abs(roots.imag) < 1e-9].real
        # a start on the surface, from which the gap rises, is not looked for
        falls = [x for x in real if (1e-13 if c[0] <= 0 else 0) < x <= 1 + 1e-9 and slope(x) < 0]
        if not falls:
            continue  # a double root
        kinds.add((slope(0) > 0, c[0] <= 0, len(falls)))
        # rounding of the cubic over its slope
        rounding = 1e-15 * np.abs(c).sum() / -slope(min(falls, key=lambda x: abs(x - share)))
        assert min(abs(x - share) for x in falls) <= 10 * rounding + 1e-13, (c, share, falls)
    assert {(True, True, 1), (True, False, 1), (False, False, 1)} <= kinds


def test_a_gap_that_nearly_touches_before_it_crosses_and_one_that_does_not_cross():
    touching = lambda t, x: ((x - 0.5) ** 2 + 1e-6) * (0.75 - x)
    share = jax.jit(lambda wanted: share_before(touching, lambda x: x, 0.0, 1.0, wanted))(True)
    np.testing.assert_allclose(share, 0.75, rtol=0, atol=1e-13)  # measured: 0
    open_gap = lambda a: share_before(lambda t, x: a, lambda x: x, 0.0, 1.0, a < 0)
    share, slope = jax.jit(jax.value_and_grad(open_gap))(1.0)
    assert (share, slope) == (1.0, 0.0)


@pytest.mark.full
@pytest.mark.parametrize("modes", BOTH_MODES)
def test_derivatives_of_an_instant_to_second_order(modes):
    exact = lambda n: (n[1] + jnp.sqrt(n[1] ** 2 + 4 * n[2] * n[0])) / (2 * n[2])
    found = lambda n: share_before(
        lambda t, x: n[0] + n[1] * x - n[2] * x**2, lambda x: x, 0.0, 1.0, jnp.asarray(True)
    )
    numbers = jnp.array([(1e-4, 0.1, 0.15), (0.0, 0.05, 0.15), (0.1, -0.05, 0.2), (0.1, -0.3, -0.1)])
    one, other = modes
    every = lambda f: jax.jit(jax.vmap(lambda n: (f(n), one(f)(n), one(other(f))(n))))(numbers)
    for ours, theirs, rtol, atol in zip(
        every(found), every(exact), (1e-14, 1e-12, 1e-12), (0, 0, 1e-10), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=atol)  # measured: 2e-16, 1e-15, 5e-13 of 1e3


@pytest.mark.full
@pytest.mark.parametrize("modes", BOTH_MODES)
def test_second_derivatives_of_a_motion_through_an_impact(modes):
    state, (one, other) = jnp.array([0.1, -1.0]), modes
    found = jax.jit(one(other(lambda s: falling(0.8, 0.03, 5)(s, 0.0))))(state)
    exact = jax.hessian(lambda s: bounced(s, 0.8, 0.15))(state)
    np.testing.assert_allclose(found, exact, rtol=1e-12)  # measured: 6e-16


def followed(step, state, count):
    """The states at the ends of so many intervals."""
    ahead = lambda s, k: (lambda end: (end, end))(step(s, k))
    return eqx.filter_jit(lambda s: jax.lax.scan(ahead, s, jnp.arange(float(count)))[1])(state)


@pytest.mark.full
@pytest.mark.parametrize(("dt", "restitution"), [(1e-3, 0.5), (0.01, 0.9), (0.07, 0.5), (0.01, 0.0)])
def test_a_ball_comes_to_rest_on_the_floor_and_never_passes_it(dt, restitution):
    fall = np.sqrt(2 / GRAVITY)
    rest = fall + 2 * restitution * fall / (1 - restitution)  # when its impacts have accumulated
    step, start = falling(restitution, dt, 1), jnp.array([1.0, 0.0])
    states = followed(step, start, np.ceil(rest / dt) + 50)
    times = dt * (np.arange(len(states)) + 1)
    assert np.all(states[:, 0] > -1e-15)  # measured: -2e-18
    np.testing.assert_allclose(states[times > rest], 0.0, atol=1e-15)  # measured: 0
    # before, of a flight longer than a step
    first = (times > fall) & (times < fall * (1 + 2 * restitution))
    if restitution:
        exact = jax.vmap(lambda time: bounced(start, restitution, time))(times[first])
        np.testing.assert_allclose(states[first], exact, rtol=0, atol=1e-12)  # measured: 3e-14
    # at rest all neighbours come to the same; measured: 1e-32
    np.testing.assert_allclose(jax.jacfwd(lambda s: step(s, 0.0))(jnp.zeros(2)), 0.0, atol=1e-30)


def shaken(dt, steps, restitution=0.3):
    """A ball on a table that shakes by 1.5 times its weight: held, thrown off, caught."""
    amplitude, frequency = 1.5 * GRAVITY / (2 * np.pi * 5) ** 2, 2 * np.pi * 5
    field = lambda t, s: jnp.stack([s[1], -GRAVITY * jnp.ones_like(s[1])])
    table = lambda t: (amplitude * jnp.sin(frequency * t), amplitude * frequency * jnp.cos(frequency * t))
    rebound = lambda t, s: jnp.stack([s[0], (1 + restitution) * table(t)[1] - restitution * s[1]])
    return impact_step(field, lambda t, s: s[0] - table(t)[0], rebound, dt=dt, steps=steps), table, frequency


@pytest.mark.full
@pytest.mark.parametrize("steps", [40, 67, 400])
def test_a_ball_on_a_shaking_table_is_thrown_off_where_its_weight_no_longer_holds_it(steps):
    step, table, frequency = shaken(0.2 / steps, 1)
    off = np.arcsin(1 / 1.5) / frequency
    states = followed(step, jnp.array([0.0, table(0.0)[1]]), steps)  # moving with the table
    times = 0.2 / steps * (1 + np.arange(steps))
    place, speed = table(off)
    thrown = lambda left: jnp.stack([place + speed * left - GRAVITY * left**2 / 2, speed - GRAVITY * left])
    free = (times > off) & (times < 0.1)
    np.testing.assert_allclose(
        states[free], jax.vmap(thrown)(times[free] - off), rtol=0, atol=1e-14
    )  # measured: 9e-16
    on = np.stack(table(times[times < off]), axis=1)
    np.testing.assert_allclose(states[times < off], on, rtol=0, atol=1e-15)  # measured: 6e-17
    assert np.all(states[:, 0] - table(times)[0] > -1e-15)


def test_a_reset_that_never_turns_the_motion_gives_nan():
    field = lambda t, s: jnp.stack([s[1], -GRAVITY * jnp.ones_like(s[1])])
    step = impact_step(field, lambda t, s: s[0], lambda t, s: s, dt=0.1, steps=5)
    assert np.all(np.isnan(eqx.filter_jit(step)(jnp.array([0.1, 0.0]), 0.0)))


def test_flights_shorter_than_a_step_are_flights():
    step = falling(0.5, 0.01, None, return_step)
    state, ahead = jnp.array([0.0, -1.0]), jax.jit(lambda s: step(s, 0.0))
    for k in range(40):
        state = ahead(state)
        np.testing.assert_allclose(state[1], -(0.5 ** (k + 1)), rtol=1e-12)  # measured: 1e-14
    slope = jax.jit(jax.jacfwd(lambda s: step(s, 0.0)))(jnp.array([0.0, -1e-3]))
    np.testing.assert_allclose(slope[1, 1], 0.5, rtol=1e-12)  # measured: 4e-16
    plastic = falling(0.0, 0.01, None, return_step)
    assert np.all(np.isnan(plastic(jnp.array([0.0, -1.0]), 0.0)))  # there is no next impact


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_switch_there_and_back_within_one_step_is_noticed(side):
    """A parabola that turns just behind the surface, where its curvature is three times as great."""
    field = lambda curvature: lambda t, s: jnp.stack([s[1], side * curvature * jnp.ones_like(s[1])])
    near, far = field(1.0), field(3.0)
    fields = (near, far) if side > 0 else (far, near)
    step = switched_step(*fields, lambda t, s: s[0], dt=1.0, steps=1)
    end = step(side * jnp.array([0.1, -0.5]), 0.0)
    # meets the surface after 1/2 - root at the speed root, and leaves it as fast after 2 root / 3
    root = 0.05**0.5
    left = 1 - (0.5 - root) - 2 * root / 3
    exact = [root * left + left**2 / 2, root + left]
    np.testing.assert_allclose(side * end, exact, rtol=0, atol=1e-12)  # measured: 6e-17


def rubbing(frequency, friction, steps):
    """Den Hartog's oscillator: x'' + x + friction sign(x') = cos(frequency t), which sticks in every period."""
    push = lambda t, s: jnp.cos(frequency * t) - s[0]
    above = lambda t, s: jnp.stack([s[1], push(t, s) - friction])
    below = lambda t, s: jnp.stack([s[1], push(t, s) + friction])
    return switched_step(above, below, lambda t, s: s[1], dt=2 * np.pi / frequency / steps, steps=steps)


def rubbed(frequency, friction, x, v):
    """Its state after a period by SciPy, from event to event."""
    t, end = 0.0, 2 * np.pi / frequency
    push = lambda t: np.cos(frequency * t) - x
    while t < end:
        sign = np.sign(v) or np.sign(push(t))
        if v == 0 and abs(push(t)) < friction:
            held = lambda t: friction - abs(push(t))
            times = np.linspace(t, end, 2001)
            gone = np.flatnonzero(held(times) < 0)
            if not len(gone):
                break
            t = brentq(held, times[gone[0] - 1], times[gone[0]], xtol=1e-14)
            sign = np.sign(push(t))
        stops = lambda t, s, sign=sign: sign * s[1]
        stops.terminal, stops.direction = True, -1
        rates = lambda t, s, sign=sign: [s[1], np.cos(frequency * t) - s[0] - friction * sign]
        options = dict(method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.1, events=stops)
        slip = solve_ivp(rates, (t, end), [x, v], **options)
        t, (x, v) = slip.t[-1], slip.y[:, -1]
        v = 0.0 if slip.status else v
    return np.array([x, v])


@pytest.mark.full
def test_dry_friction_slides_where_both_fields_point_to_the_surface():
    """The motion sticks: its velocity is zero, and so is every derivative of it."""
    start = np.array([0.5, 0.3])
    exact = rubbed(0.4, 0.6, *start)
    nudged = [rubbed(0.4, 0.6, *(start + sign * 1e-5 * e)) for e in np.eye(2) for sign in (1, -1)]
    slopes = np.stack([nudged[0] - nudged[1], nudged[2] - nudged[3]], axis=1) / 2e-5
    for steps, error in ((400, 3e-7), (1600, 3e-9)):
        step = rubbing(0.4, 0.6, steps)
        end = eqx.filter_jit(step)(jnp.asarray(start), 0.0)
        np.testing.assert_allclose(end, exact, rtol=0, atol=error)
        found = map_spectrum(step, jnp.asarray(start), 40, transient=10)
        # superstable: +4.4 and +22.4, which are no exponents, where the motion was stepped across the surface
        np.testing.assert_allclose(found.weighted[0], -2.985, atol=0.02)
        # what is left is rounding: -292 and below -300, by the version of JAX
        assert found.per_period[1] < -200
    np.testing.assert_allclose(jacobians(rubbing(0.4, 0.6, 400), jnp.asarray(start), 1)[0], slopes, rtol=0, atol=3e-6)


@pytest.mark.full
def test_a_motion_slides_along_an_oblique_surface_and_leaves_it():
    """From (0, 1) down to s = y - x / 4 = 0 along (1, -1), along it, and off where the field below turns away."""
    height = lambda t, s: s[1] - s[0] / 4
    above = lambda t, s: jnp.array([1.0, -1.0])
    below = lambda t, s: jnp.stack([0 * t, 2.0 - t])
    step = switched_step(above, below, height, dt=0.03, steps=100)
    end = eqx.filter_jit(step)(jnp.array([0.0, 1.0]), 0.0)
    # touches at t = 0.8 and x = 0.8; then x' = (2 - t) / (3.25 - t) until t = 2, as rates of s are -1.25 and 2 - t
    x = 0.8 + 1.2 - 1.25 * np.log(2.45 / 1.25)
    # below from then on, with y' = 2 - t
    np.testing.assert_allclose(end, [x, x / 4 - 0.5], rtol=0, atol=1e-8)
    slope = jacobians(step, jnp.array([0.0, 1.0]), 1)[0]
    # a plane of starts ends on a line
    assert abs(np.linalg.det(slope)) < 1e-12


@pytest.mark.slow
def test_the_page_s_oscillator_doubles_its_period_where_the_closed_form_does():
    names = {}
    python = [block for block in blocks(ROOT / "docs" / "how_to" / "own_system.md") if block.language == "python"]
    for block in python[:2]:
        exec(block.text, names)
    x, v, frequency = names["flip"].node.z
    assert abs(frequency - 2.3583) < 1e-4
    exact = Stopped(*map(jnp.asarray, (DAMPING, frequency, 1.0, GAP, np.inf, RESTITUTION)))
    orbit = shoot(lambda s, k: exact(s, k), jnp.array([x, v]))
    np.testing.assert_allclose(orbit.state, [x, v], rtol=0, atol=1e-8)
    np.testing.assert_allclose(multipliers(orbit.matrices)[0], -1.0, rtol=0, atol=1e-7)
    spectrum = map_spectrum(names["oscillator"](2.3), names["orbit"].state, 1000, transient=200)
    assert np.all(spectrum.per_period < 0)
