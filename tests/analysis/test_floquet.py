"""Floquet multipliers: exact products of matrices, oscillators with semi-analytic orbits, and numbers of segments."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from slipperjax.analysis.floquet import multipliers
from slipperjax.analysis.shooting import shoot

from .systems import Stopped, linear


def sort(values):
    """Largest modulus first, of a pair the one with the positive imaginary part."""
    values = np.asarray(values, complex)
    return values[np.lexsort((-values.imag, -np.round(np.log10(np.abs(values) + 1e-300), 6)))]


def plain(matrices):
    """Multipliers by the product of all matrices."""
    return sort(np.linalg.eigvals(functools.reduce(lambda total, matrix: matrix @ total, matrices)))


def unimodular(rng, size):
    """A matrix of small integers, and its inverse, which is of integers too."""
    lower, upper = np.eye(size), np.eye(size)
    for k in range(size - 1):
        lower[k + 1, k], upper[k, k + 1] = rng.choice([-1, 1], 2)
    matrix = lower @ upper
    return matrix, np.rint(np.linalg.inv(matrix))


def chain(blocks, rng):
    """Matrices S_{k+1} D_k S_k^-1 with given D_k; exact where these hold powers of two."""
    bases = [unimodular(rng, blocks[0].shape[0]) for _ in blocks]
    ends = [*bases[1:], bases[0]]
    return np.stack([end[0] @ block @ start[1] for start, end, block in zip(bases, ends, blocks, strict=True)])


def spread(powers, segments, rng):
    """Diagonal matrices of powers of two, whose product has the given ones."""
    shares = np.array([np.diff(np.round(np.linspace(0, p, segments + 1))) for p in powers])
    return [np.diag(2.0**column) for column in rng.permutation(shares.T)]


def test_small_multipliers_keep_their_relative_accuracy():
    powers = np.array([10, 3, 0, -1, -13, -27, -40])  # 1024 to 9e-13
    errors = {multipliers: [], plain: []}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        matrices = chain(spread(powers, 16, rng), rng)
        for way, found in errors.items():
            found.append(np.abs(way(matrices) / 2.0**powers - 1).max())
    assert max(errors[multipliers]) < 1e-11  # measured: 3e-12
    # the smallest has no correct digit in the product
    assert max(errors[plain]) > 1e-3


@pytest.mark.parametrize("segments", [8, 64, 256])
def test_accuracy_does_not_depend_on_the_number_of_segments(segments):
    rng = np.random.default_rng(1)
    powers = np.linspace(10, -40, 12).round()
    found = multipliers(chain(spread(powers, segments, rng), rng))
    np.testing.assert_allclose(found, 2.0**powers, rtol=1e-10)  # measured: 2e-12


def test_complex_pairs_and_equal_moduli():
    rng = np.random.default_rng(2)
    turn, half = np.array([[1.0, -1.0], [1.0, 1.0]]), np.array([[0.5, -0.5], [0.5, 0.5]])
    # per segment a pair of modulus 2^(1/2), the values 1 and -1, a pair of 2^(-1/2), and one of 1/8
    blocks = [block_diag(turn, 1.0, -1.0 if k == 0 else 1.0, half, 0.125) for k in range(9)]
    pair = np.array([(1 + 1j) ** 9, (1 - 1j) ** 9])
    expected = np.concatenate([pair, [1.0, -1.0], pair / 2.0**9, [0.125**9]])
    found = multipliers(chain(blocks, rng))
    assert np.all(np.diff(np.abs(found)) < 1e-9)
    distance = np.abs(found[:, None] - expected[None]).min(axis=0) / np.abs(expected)
    assert distance.max() < 1e-11  # measured: 2e-13


def test_a_product_without_full_rank():
    rng = np.random.default_rng(3)
    blocks = spread([3, -2, -12, -20], 6, rng)
    matrices = chain([block_diag(block, 0.0, 0.0) for block in blocks], rng)
    found = multipliers(matrices)
    np.testing.assert_allclose(found[:4], 2.0 ** np.array([3, -2, -12, -20]), rtol=1e-11)  # measured: 1e-14
    np.testing.assert_allclose(found[4:], 0.0, rtol=0, atol=1e-30)  # measured: 1e-93
    # a component that is replaced in each segment gives a zero column
    memory = np.zeros((5, 3, 3))
    memory[:, :2, :2], memory[:, 2, 0] = [[0.0, 1.0], [-0.5, 0.3]], 7.0
    expected = np.append(np.linalg.eigvals(memory[0, :2, :2]) ** 5, 0.0)
    found = multipliers(memory)
    np.testing.assert_allclose(sort(found)[:2], sort(expected)[:2], rtol=1e-13)  # measured: 5e-15
    assert abs(found[2]) < 1e-30  # measured: 7e-79
    assert np.all(multipliers(np.zeros((3, 2, 2))) == 0.0)


def test_matrices_with_nan_and_under_jit():
    assert np.all(np.isnan(multipliers(np.stack([np.eye(3), np.full((3, 3), np.nan)]))))
    matrices = np.random.default_rng(4).standard_normal((3, 4, 4))
    found = jax.jit(multipliers)(jnp.asarray(matrices))
    np.testing.assert_allclose(sort(found), sort(multipliers(matrices)), rtol=1e-10)  # measured: 2e-15


@eqx.filter_jit
def touches(system, state):
    return system.followed(state)[1]


def stopped(damping, frequency, gap, stop=np.inf, restitution=0.0):
    return Stopped(*map(jnp.asarray, (damping, frequency, 1.0, gap, stop, restitution)))


@pytest.mark.parametrize(("frequency", "gap"), [(2.8, 0.05), (2.0, 0.0)])
def test_an_impact_oscillators_orbit_and_multipliers(frequency, gap):
    """The motion with one impact in a period in closed form (Shaw and Holmes 1983, doi:10.1016/0022-460X(83)90407-8).

    At the impact s = (gap, v) becomes (gap, -r v), and after the period T it is s again: with the steady part of
    amplitude a and the flow M of the free oscillator, steady = (gap, 0) + v q, q = (1 - M)^-1 ((0, 1) + r M (0, 1)).
    """
    damping, restitution = 0.05, 0.7
    system = stopped(damping, frequency, gap, restitution=restitution)
    period = 2 * np.pi / frequency
    flow, matrix = linear(1.0, damping, 0.0, 1.0, frequency)
    through = expm(period * matrix)
    q = np.linalg.solve(np.eye(2) - through, np.array([0.0, 1.0]) + restitution * through[:, 1])
    gain = 1 / (1 - frequency**2 + 2j * damping * frequency)
    v = np.roots([q[0] ** 2 + (q[1] / frequency) ** 2, 2 * gap * q[0], gap**2 - abs(gain) ** 2]).real.max()
    steady = np.array([gap, 0.0]) + v * q
    impact = (np.angle(steady[0] - 1j * steady[1] / frequency) - np.angle(gain)) / frequency % period
    start = flow(np.array([gap, -restitution * v]), impact, period - impact)
    found = shoot(system, jnp.asarray(start + 1e-3))
    np.testing.assert_allclose(found.state, start, rtol=0, atol=1e-11)  # measured: 1e-14
    assert int(touches(system, found.state)) == 1
    # a deviation is carried over an impact by the matrix of Aizerman and Gantmakher
    force = lambda speed: np.cos(frequency * impact) - 2 * damping * speed - gap
    jump = (restitution * force(v) + force(-restitution * v)) / v
    exact = np.linalg.eigvals(through @ np.array([[-restitution, 0.0], [jump, -restitution]]))
    # measured: 4e-14
    np.testing.assert_allclose(sort(multipliers(np.asarray(found.matrices))), sort(exact), rtol=0, atol=1e-11)


def test_second_derivatives_of_multipliers():
    """The largest multiplier is the root of a quadratic; the third one is 0.1 for any a."""
    matrix = lambda a: jnp.array([[a, 2.0, 0.0], [1.0, 0.5, 0.0], [0.0, 1.0, 0.1]])
    found = lambda a: multipliers(jnp.stack([matrix(a), jnp.eye(3)])).real[0]
    exact = lambda a: (a + 0.5) / 2 + jnp.sqrt((a - 0.5) ** 2 / 4 + 2.0)
    three = lambda f: jax.jit(lambda a: jnp.stack([f(a), jax.jacrev(f)(a), jax.jacfwd(jax.jacrev(f))(a)]))
    np.testing.assert_allclose(three(found)(1.3), three(exact)(1.3), rtol=1e-12)  # measured: 5e-16
