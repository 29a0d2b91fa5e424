"""The smallest shock that leaves a basin, beside the saddle's stable manifold and beside plain searches."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from slipperjax import analysis
from slipperjax.analysis import shocks
from slipperjax.tools.compile import call_compiled

pytestmark = pytest.mark.full
C = 0.05
POINTS = np.sort(np.roots([1.0, 0.0, -1.0, -C]).real)
"""The fixed points x = y of the map: two attractors, and the saddle between them."""


def duffing(s, k):
    """Holmes's map, like Hénon's, with a cubic term."""
    return jnp.stack([s[1], -0.2 * s[0] + 2.2 * s[1] - s[1] ** 3 + C])


def manifold_distance(point, units):
    """Returns the distance of a point from the saddle's stable manifold, by the inverse map."""
    saddle = POINTS[1]
    slope = 2.2 - 3 * saddle**2
    # of the contracting direction (1, rate)
    rate = (slope - np.sqrt(slope**2 - 0.8)) / 2
    near = 1e-6

    def distance(log_length, way, times):
        length = way * near * rate**-log_length
        x, y = saddle + length, saddle + rate * length
        for _ in range(times):
            x, y = (2.2 * x - x**3 + C - y) / 0.2, x
        return np.hypot((x - point) / units[0], (y - point) / units[1])

    found = []
    for way in (-1.0, 1.0):
        for times in range(12):
            coarse = np.linspace(0, 1, 4001)
            with np.errstate(over="ignore", invalid="ignore"):
                k = int(np.nanargmin(distance(coarse, way, times)))
            bounds = coarse[max(k - 1, 0)], coarse[min(k + 1, 4000)]
            options = dict(bounds=bounds, args=(way, times), method="bounded", options={"xatol": 1e-12})
            found.append(minimize_scalar(distance, **options).fun)
    return min(found)


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("units", [(1.0, 1.0), (0.3, 1.0), (1.0, 0.3)])
def test_distance_to_the_stable_manifold(number, units):
    point = POINTS[number]
    shock = analysis.smallest_shock(duffing, jnp.full(2, point), jnp.array(units), longest=3.0)
    exact = manifold_distance(point, units)
    print(f"{units}: {shock.length:.10f}, manifold {exact:.10f}, angle {shock.angle:.1e}")
    assert shock.found == "gradient"
    # an angle of 1e-3 lengthens a ray by 5e-7 to first order; measured 5e-8
    assert shock.length == pytest.approx(exact, rel=1e-6)
    assert 0 < shock.length - shock.returns < 2e-8 * shock.length
    assert np.linalg.norm(shock.change / np.array(units)) == pytest.approx(shock.length)
    # to the other attractor
    assert shock.period == 1
    np.testing.assert_allclose(shock.state, POINTS[2 - number], rtol=0, atol=1e-9)


def odd(s, k):
    """Holmes's map with the other sign and no constant, whose points +-(1, 1) alternate."""
    return -duffing(s, k).at[1].add(-C)


def test_two_phases_are_one_motion():
    # beyond the basin of both points motions grow without bound
    shock = analysis.smallest_shock(odd, jnp.ones(2), jnp.array([0.0, 1.0]), longest=3.0)
    assert (shock.period, shock.found, float(shock.change[0])) == (-1, "gradient", 0.0)
    # a plain scan of the line, on which shocks in between lead to the other phase
    lengths = np.linspace(-3, 3, 60_001)
    x, y = np.ones_like(lengths), 1 + lengths
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(1000):
            x, y = -y, 0.2 * x - 2.2 * y + y**3
    gone = np.abs(lengths[~np.isfinite(y)]).min()
    print(f"{shock.length:.6f}, scan {gone:.4f}")
    assert 0 <= gone - shock.length < 1.01e-4


def newton(s, k):
    """Newton's iteration for z^3 = 1, whose basins have a fractal boundary and conformal derivatives."""
    z = s[0] + 1j * s[1]
    z = z - (z**3 - 1) / (3 * z**2)
    return jnp.stack([z.real, z.imag])


def test_a_fractal_boundary_is_searched_by_rays():
    shock = analysis.smallest_shock(newton, jnp.array([1.0, 0.0]), jnp.ones(2), transient=60, rays=64, longest=2.0)
    side = np.linspace(-0.7, 0.7, 1401)
    z = 1 + side + 1j * side[:, None]
    start = np.abs(z - 1)
    for _ in range(60):
        z = z - (z**3 - 1) / (3 * z**2)
    brute = start[np.abs(z - 1) > 1e-3].min()
    print(f"{shock.length:.6f}, plain search {brute:.6f}, angle {shock.angle:.3f}")
    assert shock.found == "rays"
    assert shock.returns < shock.length
    # a plain search misses tongues that are narrower than its squares
    assert shock.length == pytest.approx(brute, rel=2e-2)


def test_any_number_of_rays_needs_one_program(monkeypatch):
    shapes = set()

    def call(function, tree, static, amounts):
        shapes.add((function, amounts.shape))
        return call_compiled(function, tree, static, amounts)

    monkeypatch.setattr(shocks, "call_compiled", call)
    options = dict(longest=3.0, transient=60, rays=30)
    analysis.smallest_shock(duffing, jnp.full(2, POINTS[0]), jnp.ones(2), **options)
    # motions, and their derivatives
    assert len(shapes) == 2


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(state=jnp.full(2, POINTS[1])), "`state` must be on a stable periodic motion"),
        (dict(state=jnp.array([0.9, 1.0])), "`state` must be on a stable periodic motion"),
        (dict(longest=0.1), "`longest` must let a shock on one of the rays leave the basin, but is 0.1"),
        (dict(shocks=jnp.ones(3)), "`shocks` must have 2 numbers as the state has, but has 3"),
        (dict(shocks=jnp.zeros(2)), "`shocks` must change some number"),
        (dict(rays=8), "`rays` must be a whole number of 20 or more, but is 8"),
        (dict(longest=-1.0), "`longest` must be positive"),
    ],
)
def test_wrong_inputs(changed, message):
    given = dict(state=jnp.full(2, POINTS[2]), shocks=jnp.ones(2)) | changed
    with pytest.raises(ValueError, match=message):
        analysis.smallest_shock(duffing, **given)
