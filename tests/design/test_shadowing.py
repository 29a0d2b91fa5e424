"""Shadowing against ensembles in chaos: on maps with known derivatives, and on the slipper at equal cost.

pytest -m slow -s tests/design/test_shadowing.py
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import slipperjax as sj
from slipperjax.design.gradients import PeriodValues
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.record import RecordSet
from slipperjax.flow.simulate import dynamic_steps
from slipperjax.model.dynamics import State
from slipperjax.model.kinematics import MOTION_SCALES
from slipperjax.model.parameters import at_values
from slipperjax.model.starts import initial_state

from .shadowing import segments_of, slope_of
from .test_calibration import OBJECTIVES_IN_CHAOS, STEPS, settled

pytestmark = pytest.mark.slow
TURN = 2 * jnp.pi
CAT = jnp.array([[2.0, 1.0], [1.0, 1.0]])


def conjugate(x, p):
    """The cat map seen through x + p sin(2 pi x) / (2 pi), to first order in p: averages change as the points do."""
    moved = lambda y: jnp.sin(TURN * y) / TURN
    y = CAT @ x
    y = y + p * (moved(y) - CAT @ moved(x))
    return y - jnp.floor(y), jnp.cos(TURN * x)


def kicked(x, p):
    """The cat map with a kick, which also changes the density along its unstable direction."""
    y = CAT @ x + jnp.stack([p * jnp.sin(TURN * x[0]) / TURN, 0.0 * p])
    return y - jnp.floor(y), jnp.cos(TURN * x)


def slopes(step, p, starts, segments=300, length=8):
    """Derivatives by shadowing from each start."""
    options = dict(count=1, segments=segments, length=length, align=5)
    tangents = jax.jit(jax.vmap(lambda x: segments_of(step, x, p, jnp.ones(2), **options)))(starts)
    return np.array([slope_of(jax.tree.map(lambda a, k=k: np.asarray(a)[k], tangents)) for k in range(len(starts))])


def averages_of(step, p, starts, periods):
    def one(x):
        x = jax.lax.scan(lambda x, _: step(x, p), x, None, length=100)[0]
        return jnp.mean(jax.lax.scan(lambda x, _: step(x, p), x, None, length=periods)[1], axis=0)

    return np.asarray(jax.jit(jax.vmap(one))(starts))


STARTS = np.random.default_rng(0).uniform(size=(16, 2))


def test_shadowing_is_exact_where_a_parameter_moves_points_only():
    shadowing = slopes(conjugate, 0.0, STARTS)
    # -1/2 each; measured -0.502 and -0.501, with a standard error of 0.002
    np.testing.assert_allclose(shadowing.mean(axis=0), -0.5, atol=0.01)


def test_shadowing_misses_what_changes_the_density():
    """No error of the program: the part of the linear response along the unstable direction is not shadowing's."""
    p, h = 0.3, 0.05
    starts = np.random.default_rng(1).uniform(size=(200, 2))
    sides = [averages_of(kicked, p + side, starts, 20000) for side in (-h, h)]
    slope = (sides[1] - sides[0]) / (2 * h)
    mean, error = slope.mean(axis=0), slope.std(axis=0) / np.sqrt(len(slope))
    shadowing = slopes(kicked, p, STARTS)
    print(f"\ndifferences {mean} +- {error}; shadowing {shadowing.mean(axis=0)} +- {shadowing.std(axis=0) / 4}")
    assert abs(shadowing.mean(axis=0)[0] - mean[0]) > 5 * error[0]
    # measured 0.137 for -0.003 +- 0.005


# length [m], speed [m/s], clearance [m]: of `CASES`
SLIPPERS = np.array([(0.10, 1000, 1e-3), (0.11, 1200, 1e-3), (0.12, 1000, 1.5e-3), (0.13, 1300, 1.5e-3)])
NAMES = ("length", "speed", "clearance")
OBJECTIVES = OBJECTIVES_IN_CHAOS[:2]
TRAJECTORIES, SEGMENTS, LENGTH, ALIGN, TANGENTS = 4, 80, 5, 4, 4
"""400 forcing periods that count, with five tangents: 2520 with those that pass first, half of a default ensemble."""


def slipper_slopes(cases):
    """OBJECTIVES and their slopes by length from one trajectory each, (cases, objectives)."""
    records = RecordSet((PeriodValues(OBJECTIVES),))
    start = initial_state(sj.paper_scene(), sj.table_2_start())
    _, unravel = ravel_pytree(start)
    # 1 m/s of a contact's memory counts as one
    scales = State(MOTION_SCALES, jnp.ones(len(start.memory)))
    weights = 1 / ravel_pytree(jax.tree.map(lambda a, b: jnp.broadcast_to(jnp.asarray(a), b.shape), scales, start))[0]

    def one(values, motion):
        scene = at_values(sj.paper_scene(), NAMES, values)

        def step(x, p):
            period_map = PeriodMap(at_values(scene, ("length",), p[None]), dynamic_steps(STEPS, most=STEPS))
            passage = period_map.run(unravel(x), periods=1, records=records)
            return ravel_pytree(passage.state)[0], jnp.stack([a[0] for a in passage.samples[0]])

        x = ravel_pytree(initial_state(scene, motion))[0]
        options = dict(count=TANGENTS, segments=SEGMENTS, length=LENGTH, align=ALIGN)
        return segments_of(step, x, values[0], weights, **options)

    tangents = jax.tree.map(np.asarray, sj.jit(jax.vmap(one))(jnp.asarray(cases), settled(cases).motion))
    pick = lambda k: jax.tree.map(lambda a: a[k], tangents)
    value, slope = tangents.average.mean(axis=1), np.array([slope_of(pick(k)) for k in range(len(cases))])
    growth = np.log(np.abs(np.diagonal(tangents.factor, axis1=2, axis2=3))).mean(axis=1) / LENGTH
    # the first objective is kept as a mean square
    value[:, 0], slope[:, 0] = np.sqrt(value[:, 0]), slope[:, 0] / (2 * np.sqrt(value[:, 0]))
    return slope / value * cases[:, :1], growth


def test_shadowing_of_slippers():
    # trajectories of a case differ by a speed that is next to the same
    cases = np.repeat(SLIPPERS, TRAJECTORIES, axis=0)
    cases[:, 1] += np.tile(np.arange(TRAJECTORIES) * 1e-3, len(SLIPPERS))
    slope, growth = slipper_slopes(cases)
    print("\nd ln(objective) / d ln(length) by shadowing, trajectories side by side; exponents [1/period]\n")
    for j, (length, speed, clearance) in enumerate(SLIPPERS):
        rows = slice(j * TRAJECTORIES, (j + 1) * TRAJECTORIES)
        print(f"{length:.2f} m {speed:5.0f} m/s {clearance * 1e3:.1f} mm", np.round(growth[rows].mean(axis=0), 2))
        for k, one in enumerate(OBJECTIVES):
            print(f"  {one.name:14s}", " ".join(f"{v:11.4g}" for v in slope[rows, k]))
    assert np.all(np.isfinite(slope))
