"""The step that knows where contacts begin and end, against closed forms, an independent code and itself."""

import dataclasses
import functools
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.kinematics import scaled_size
from slipperjax.solvers.named import resolve_solver

from ..common import among, cases, scaled_errors, scene_of
from ..systems.fields import rebound, rebound_slope
from .pressed import pressed

AT = np.array([1e8, 0.5, 0.7])
"""Stiffness [N/m^1.5], restitution [1] and approach speed [m/s]."""
ROOF = sj.Section(points=[(-0.03, 0.02), (0.03, 0.02)], play=[1e-3], names=("A", "B"), faces=(("A", "B"),))
NOMINAL = cases("reference_states")[0]
# a section of one face has no height that its play could be compared with
pytestmark = pytest.mark.filterwarnings("ignore:.*`clearance`:slipperjax.ImplausibleWarning")


def law_of(law):
    own = {} if law is sj.model.HertzSpring else dict(restitution=AT[1])
    return law(stiffness=AT[0], **own)


def dropped(relative, steps, solver, law):
    """Speed [m/s] of a level slipper after an impact of its roof on a straight rail, from values relative to `AT`."""
    stiffness, restitution, approach = relative * AT
    scene = sj.Scene(100.0, sj.paper_scene().slipper, ROOF, sj.model.StraightTrack(), law, window=1.0)
    scene = scene.replace(stiffness=stiffness)
    if law.has_memory:
        scene = scene.replace(restitution=restitution)
    state = sj.initial_state(scene, sj.Motion(v_z=-approach))
    return sj.period_map(scene, state, steps_per_period=steps, solver=solver).motion.v_z


LAWS = sj.model.Flores, sj.model.HuntCrossley, sj.model.LankaraniNikravesh, sj.model.HertzSpring


# Measured at 50 and 400 steps: Flores 3.1e-6, 4.3e-8; Hunt-Crossley 3.4e-6, 2.5e-8; Lankarani-Nikravesh 1.6e-6,
# 2.7e-8; Hertz 8.3e-6, 4.9e-8; RK4 has 1.7e-4, 9.3e-7 with Flores
@pytest.mark.parametrize("law", among({law.__name__: law for law in LAWS}, "Flores"))
def test_rebound_of_a_level_slipper(law):
    law = law_of(law)
    exact = AT[2] * (rebound(float(law.factor)) if law.has_memory else 1.0)
    coarse, fine = (abs(dropped(np.ones(3), steps, sj.solvers.ImpulseRK4(), law) - exact) for steps in (50, 400))
    assert coarse < 1.5e-5
    assert fine < 1e-7
    assert np.log2(coarse / fine) / 3 > 1.9  # measured 1.96 to 2.5


SCENES = Path(__file__).parents[2] / "docs" / "how_to" / "scenes.md"


@pytest.mark.full
def test_restitution_in_and_rebound_out():
    """The table of docs/how_to/scenes.md: in closed form, and of a drop of a level slipper at 0.7 m/s."""
    given = (0.1, 0.3, 0.5, 0.7, 0.9)
    rows = []
    for law in (sj.model.Flores, sj.model.HuntCrossley, sj.model.LankaraniNikravesh):
        exact = [rebound(float(law(1e8, restitution).factor)) for restitution in given]
        rows.append(f"| `{law.__name__}` | " + " | ".join(f"{value:.2f}" for value in exact) + " |")
        # of 0.1, contact outlasts the run
        relative = [np.array([1.0, restitution / AT[1], 1.0]) for restitution in given[1:]]
        found = [dropped(at, 100, sj.solvers.ImpulseRK4(), law_of(law)) / AT[2] for at in relative]
        np.testing.assert_allclose(found, exact[1:], atol=1e-4)
    print("\n".join(rows))
    text = SCENES.read_text()
    assert all(row in text for row in rows)


@pytest.mark.full
def test_derivatives_of_the_rebound():
    law, factor = law_of(sj.model.Flores), float(law_of(sj.model.Flores).factor)
    exact = [0.0, AT[2] * rebound_slope(factor) * (-8 / (5 * AT[1] ** 2)) * AT[1], AT[2] * rebound(factor)]
    speed = functools.partial(dropped, steps=100, solver=sj.solvers.ImpulseRK4(), law=law)
    found = jax.jacfwd(lambda x: speed(x))(jnp.ones(3))
    # measured 9.6e-6, 4.0e-6, 6.2e-5; RK4 has 9.9e-5, 1.1e-5, 9.0e-4 at these steps
    np.testing.assert_allclose(found, exact, atol=1.5e-4)


@pytest.mark.full
def test_derivatives_are_those_of_the_steps_themselves():
    """So that exponents and Newton's method are exact, however few the steps."""
    scene = scene_of(NOMINAL)
    way = jnp.array([1.0, -0.3])

    def end(x):
        state = sj.initial_state(scene, sj.Motion(v_z=0.5 + x[0], v_y=0.5 + x[1], w_x=0.2, w_y=0.3, w_z=0.4))
        return jnp.array(jax.tree.leaves(sj.period_map(scene, state, steps_per_period=40).motion))

    found = jax.jvp(end, (jnp.zeros(2),), (way,))[1]
    near = [end(h * way) for h in (1e-6, -1e-6)]
    # measured 1e-9 of the greatest, the difference's own error; 4e-7 with the derivative of the exact instants
    np.testing.assert_allclose(found, (near[0] - near[1]) / 2e-6, rtol=0, atol=2e-8 * float(jnp.abs(found).max()))


@pytest.mark.slow
def test_derivatives_are_equal_in_both_modes_to_second_order():
    speed = lambda x: dropped(x, 50, sj.solvers.ImpulseRK4(), law_of(sj.model.Flores))
    twice, mixed = (jax.jacfwd(mode(speed))(jnp.ones(3)) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(mixed, twice, rtol=1e-8, atol=1e-8)
    first, reverse = (mode(speed)(jnp.ones(3)) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(reverse, first, rtol=1e-9, atol=1e-12)


# Measured at 50 and 100 steps: 4.6e-5, 2.8e-6; 9.3e-5, 1.3e-5; 2.1e-5, 3.5e-6; 5.9e-6, 1.5e-6; RK4 at 100 has
# 4.3e-5, 1.8e-4, 3.3e-5, 2.8e-5. With a restitution of 0.5 damping ends the force before the contact ends.
@pytest.mark.full
@pytest.mark.parametrize(
    "law",
    [
        sj.model.Flores(1e8, 0.7, clamp=False),
        sj.model.Flores(1e8, 0.5),
        sj.model.ConstantDamping(1e8, 0.5),
        sj.model.HertzSpring(1e8),
    ],
    ids=("Flores", "limited", "constant", "Hertz"),
)
def test_laws_converge_to_what_rk4_does(law):
    scene = dataclasses.replace(sj.paper_scene(1480.0), contact=law)
    state = sj.initial_state(scene, sj.table_2_start())
    end = lambda n, solver: sj.period_map(scene, state, steps_per_period=n, solver=solver).motion
    exact = end(1600, sj.solvers.RK4())
    apart = lambda motion: float(scaled_size(jax.tree.map(jnp.subtract, motion, exact)))
    ours, plain = (
        np.array([apart(end(n, solver)) for n in (50, 100)]) for solver in (sj.solvers.ImpulseRK4(), sj.solvers.RK4())
    )
    assert np.mean(np.log(ours / plain)) < np.log(0.3)
    assert ours[-1] < 4e-5


def error_of_six_periods(solver):
    run = sj.simulate(scene_of(NOMINAL), 6, steps_per_period=100, saves_per_period=1, solver=solver)
    return scaled_errors(run, NOMINAL, 1).max()


def test_nominal_scene_against_the_independent_code():
    assert error_of_six_periods("ImpulseRK4") < 5e-5  # measured 1.9e-5


TIMES = np.arange(0.0, 0.0101, 0.002)
PRESSES = np.array([-3e3, -9e3, 6e3, -2e4, -3e3, 0.0])
"""Times [s], and forces [N] that press a slipper twice onto its rail, the second time faster."""


def pressing(memory, mass=14.0):
    """A level slipper of which the roof nearly touches a straight rail, and its start."""
    force = np.column_stack([0 * PRESSES, 0 * PRESSES, PRESSES])
    slipper = dataclasses.replace(sj.paper_scene().slipper, mass=mass)
    scene = sj.Scene(100.0, slipper, ROOF, sj.model.StraightTrack(), law_of(sj.model.Flores), memory, window=1.0)
    return dataclasses.replace(scene, load=sj.model.TabulatedLoad(force, time=TIMES)), sj.Motion(
        z=-0.95e-3, v_z=-0.05
    )


def pressed_ends(solver, memory):
    """Compiled once: height [m] and its rate [m/s] after the forces, by steps and mass."""

    @jax.jit
    def run(steps, mass):
        scene, start = pressing(memory)
        scene = scene.replace(mass=mass)
        end = PeriodMap(scene, ConstantSteps(steps=steps), solver, 1)(sj.initial_state(scene, start)).motion
        return jnp.stack([end.z, end.v_z])

    return run


@pytest.mark.full
def test_a_contact_that_is_pressed_again_against_one_split_at_its_events():
    """At 25, 50, 100, 200 and 400 steps, in mm and m/s."""
    law = dict(mass=14.0, stiffness=4 * AT[0], factor=float(law_of(sj.model.Flores).factor))
    (gap, rate), counts = pressed(0.05e-3, -0.05, TIMES, PRESSES, **law)
    assert counts == dict(begins=1, leads=1, holds=2, ends=0)
    exact = np.array([gap - 1e-3, rate])
    for solver in (sj.solvers.RK4(), sj.solvers.ImpulseRK4()):
        run = pressed_ends(solver, sj.model.PeakRateLatch())
        found = [np.max(np.abs(run(float(n), 14.0) - exact) / [1e-3, 1.0]) for n in (25, 50, 100, 200, 400)]
        print(type(solver).__name__, " ".join(f"{error:.1e}" for error in found))
        # measured 3.2 with ImpulseRK4, 2.7 with RK4; 2.6e-7 and 1.6e-6 in the end
        assert np.log2(found[0] / found[-1]) / 4 > 2.4
        assert found[-1] < 5e-6
    # measured 6.4e-6 at 100 steps
    assert found[2] < 3e-5


@pytest.mark.full
def test_tangents_of_a_contact_that_is_pressed_again():
    """Those of the steps themselves, and nearly those of the motion."""
    run = pressed_ends(sj.solvers.ImpulseRK4(), sj.model.PeakRateLatch())
    tangent = jax.jvp(lambda mass: run(200.0, mass), (14.0,), (1.0,))[1]
    near = [run(200.0, 14.0 + h) for h in (1e-5, -1e-5)]
    # measured 2e-9 of the greatest, the difference's own error
    np.testing.assert_allclose(tangent, (near[0] - near[1]) / 2e-5, rtol=0, atol=1e-7 * float(jnp.abs(tangent).max()))
    law = dict(stiffness=4 * AT[0], factor=float(law_of(sj.model.Flores).factor))
    gaps = [pressed(0.05e-3, -0.05, TIMES, PRESSES, mass=14.0 + h, **law)[0] for h in (1e-3, -1e-3)]
    exact = (gaps[0] - gaps[1]) / 2e-3
    np.testing.assert_allclose(tangent, exact, rtol=5e-3)


@pytest.mark.full
def test_an_impact_without_other_loads_is_the_same_with_both_memories():
    speeds = []
    for memory in (sj.model.EventLatch(), sj.model.PeakRateLatch()):
        scene = sj.Scene(
            100.0,
            sj.paper_scene().slipper,
            ROOF,
            sj.model.StraightTrack(),
            law_of(sj.model.Flores),
            memory,
            window=1.0,
        )
        state = sj.initial_state(scene, sj.Motion(v_z=-0.7))
        speeds.append(sj.period_map(scene, state, steps_per_period=50, solver=sj.solvers.ImpulseRK4()).motion.v_z)
    np.testing.assert_allclose(*speeds, rtol=1e-13)  # measured 3e-15 at most, of other speeds and steps, too


@pytest.mark.full
def test_diffrax_solves_with_it():
    scene = scene_of(NOMINAL)
    state = sj.initial_state(scene, sj.table_2_start())
    solve = diffrax.diffeqsolve(
        diffrax.ODETerm(sj.model.vector_field(scene)),
        sj.solvers.ImpulseRK4(),
        0.0,
        1.0,
        0.01,
        state,
        args=sj.model.Args(scene),
    )
    ours = sj.period_map(scene, state, steps_per_period=100, solver=sj.solvers.ImpulseRK4())
    for a, b in zip(jax.tree.leaves(solve.ys), jax.tree.leaves(ours), strict=True):
        np.testing.assert_allclose(a[0], b, rtol=1e-8, atol=1e-10)


class OwnLatch(sj.model.EventLatch):
    """A memory of one's own."""

    def latch(self, memory, before, gap, rate, step, ratio):
        return super().latch(memory, before, gap, rate, step, ratio)


@pytest.mark.full
@pytest.mark.parametrize("memory", [sj.model.SmoothSwitch(), OwnLatch()])
def test_other_memories_are_refused_and_get_rk4_by_default(memory):
    scene = sj.paper_scene(memory=memory)
    assert isinstance(resolve_solver(scene, None), sj.solvers.RK4)
    with pytest.raises(
        ValueError, match=rf"must be another one than ImpulseRK4, .* with memory {type(memory).__name__}"
    ):
        sj.simulate(scene, 1, solver=sj.solvers.ImpulseRK4())
