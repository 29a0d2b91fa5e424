"""Solvers on scenes, against reference states and MBDyn; on exact systems see `test_exact_systems`."""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import slipperjax as sj
from slipperjax.flow.record import RecordSet
from slipperjax.model.linearised import LinearSystem, dense_linearised
from slipperjax.solvers.latching import calls_lapack, solver_name
from slipperjax.solvers.named import OWN_SOLVERS
from slipperjax.solvers.twostep import two_step_weights
from slipperjax.sweeps.call import Call, make_plan
from slipperjax.sweeps.grid import Grid

from ..common import cases, scaled_errors, scene_of


@pytest.mark.parametrize("rho_inf", [0.0, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("alpha", [0.7, 1.0, 1.5])
def test_two_step_weights(rho_inf, alpha):
    a1, a2, b0, b1, b2 = two_step_weights(rho_inf, alpha)
    # exact for 1, t and t^2, with the present step as unit of time: t = 1 now, 0 before, -1 / alpha before that
    assert np.isclose(a1 + a2, 1)
    assert np.isclose(-a2 / alpha + b0 + b1 + b2, 1)
    assert np.isclose(a2 / alpha**2 + 2 * b0 - 2 * b2 / alpha, 1)
    radius = lambda z: np.abs(np.roots([1 - z * b0, -(a1 + z * b1), -(a2 + z * b2)])).max()
    # Eq. (18): both roots tend to rho_inf; the error of a double root is the square root of rounding errors
    assert np.isclose(radius(1e12j), rho_inf, atol=1e-4)
    assert np.isclose(radius(-1e12), rho_inf, atol=1e-4)
    if alpha == 1.0:
        assert all(radius(1j * z) < 1 + 1e-9 for z in np.geomspace(1e-3, 1e3, 50))


def test_linearised_contact_and_its_system():
    scene = sj.paper_scene()
    field, args = sj.model.vector_field(scene), sj.model.Args(scene)
    rng = np.random.default_rng(0)
    size = np.array([2e-3, 2e-3, 0.2, 0.2, 0.2, 1, 1, 10, 10, 10])
    motion, right = (sj.Motion(*map(jnp.asarray, rng.normal(size=10) * s)) for s in (size, 1.0))
    memory = -jnp.abs(jnp.asarray(rng.normal(size=20))) - 0.1

    @jax.jit
    def compare(motion, right):
        rates = lambda m: field.evaluate(0.3, sj.State(m, memory), args).motion
        ours = field.linearised(0.3, sj.State(motion, memory), args)
        x = LinearSystem(ours, 0.01).solve(right)
        _, back = jax.jvp(rates, (motion,), (x,))
        rest = jax.tree.map(lambda x, b, r: x - 0.01 * b - r, x, back, right)
        dense = dense_linearised(rates, motion, scene.period)
        return [jnp.array([a.stiffness, a.damping]) for a in (ours, dense)], rest

    (ours, dense), rest = compare(motion, right)
    np.testing.assert_allclose(ours, dense, rtol=0, atol=1e-12 * np.abs(dense).max())  # measured 2.4e-16
    # the unknowns reach 260 and more; measured 5e-13
    assert max(np.abs(leaf) for leaf in jax.tree.leaves(rest)) < 1e-10


NOMINAL = cases("reference_states")[0]
MBDYN = next(c for c in cases("mbdyn_states") if c["name"] == "A")


def error(solver, steps, case=NOMINAL, scene=None, controller=None, periods=6, against=None):
    """Worst scaled error over the first periods of a case; one compilation serves all numbers of steps."""
    scene = scene_of(case) if scene is None else scene
    options = dict(steps_per_period=steps, saves_per_period=1, solver=solver, stepsize_controller=controller)
    trajectory = sj.simulate(scene, periods, **options)
    return scaled_errors(trajectory, case if against is None else against, 1).max()


# measured 4.8e-7 with Rodas4, 4.3e-6 with ROS34PW2; RK4 has 7.2e-6 at 400 steps
@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "steps", "most"),
    [
        (diffrax.Dopri8(), 400, 1e-4),
        (diffrax.Kvaerno5(), 200, 1e-3),
        (sj.solvers.ROS34PW2(), 1000, 3e-5),
        (sj.solvers.Rodas4(), 1000, 3e-5),
    ],
    ids=lambda s: str(s)[:8],
)
def test_states_of_the_nominal_scene(solver, steps, most):
    assert error(solver, steps) < most


@pytest.mark.slow
def test_the_papers_method_lands_as_near_mbdyn_as_the_latch_allows():
    own = error(sj.solvers.TwoStep(), 1000)
    near = error(sj.solvers.TwoStep(), 1000, against=MBDYN)
    print(f"two-step, 1000 steps per period: {own:.2e} from the converged states, {near:.2e} from MBDyn")
    assert own < 5e-4  # measured 2.7e-4: a twentieth of MBDyn's error, whose latch is of first order
    assert near < 1.1 * 5.9e-3  # measured 6.2e-3, and MBDyn itself is 5.9e-3 from the converged states
    assert error(sj.solvers.TwoStep(), 500) / own > 3  # second order


def test_results_name_the_solver_inside_a_wrapper():
    assert solver_name(sj.solvers.RK4()) == "RK4"
    assert solver_name(sj.solvers.Latching(diffrax.HalfSolver(diffrax.Dopri8()))) == "Latching(HalfSolver(Dopri8))"


def test_solvers_that_call_lapack_run_on_one_thread():
    newton = diffrax.Kvaerno5(root_finder=optx.Newton(rtol=1e-9, atol=1e-9))
    for solver in (diffrax.Kvaerno5(), sj.solvers.Latching(newton), diffrax.HalfSolver(diffrax.ImplicitEuler())):
        assert calls_lapack(solver)
    for solver in (
        sj.solvers.RK4(),
        sj.solvers.Latching(diffrax.Dopri8()),
        sj.solvers.Rodas4(),
        sj.solvers.TwoStep(),
    ):
        assert not calls_lapack(solver, tangents=True)
    own = sj.solvers.Latching(diffrax.Kvaerno3())
    assert not calls_lapack(own)
    assert calls_lapack(own, tangents=True)  # by the implicit function theorem, which is diffrax's
    scene = sj.paper_scene()
    grid = Grid(scene, {"speed": np.linspace(1000, 1100, 41)})
    for solver, threads, with_tangents in ((newton, 1, 1), (diffrax.Kvaerno5(), 2, 1), (sj.solvers.RK4(), 2, 2)):
        plan = make_plan(grid, sj.table_2_start(), Call(0, 1, solver=solver), RecordSet())
        assert plan.chunks(chunk=8, workers=2)[1] == threads
        assert plan.chunks(chunk=8, workers=2, tangents=True)[1] == with_tangents


def solve(scene, solver, **options):
    """A period by diffrax's own `diffeqsolve`."""
    options = dict(dt0=0.01, args=sj.model.Args(scene), stepsize_controller=diffrax.ConstantStepSize()) | options
    state, terms = sj.initial_state(scene, sj.table_2_start()), diffrax.ODETerm(sj.model.vector_field(scene))
    return diffrax.diffeqsolve(terms, solver, 0.0, 1.0, y0=state, **options).ys


class OwnMemory(sj.model.EventLatch):
    """A latch of one's own."""


NEEDS_ONE_OF_OURS = "Argument `solver` must be one of slipperjax, or slipperjax.solvers.Latching of one of diffrax's"
FOREIGN = (
    (diffrax.Euler(), OwnMemory()),
    (diffrax.Tsit5(), sj.model.EventLatch()),
    (diffrax.HalfSolver(diffrax.Heun()), sj.model.EventLatch()),
    (diffrax.ReversibleHeun(), sj.model.EventLatch()),
    (diffrax.ImplicitEuler(root_finder=optx.Newton(1e-6, 1e-6)), sj.model.EventLatch()),
)


@pytest.mark.full
@pytest.mark.parametrize(("solver", "memory"), FOREIGN, ids=lambda one: type(one).__name__)
def test_solvers_that_close_no_step_are_refused_for_a_latch(solver, memory):
    with pytest.raises(RuntimeError, match=NEEDS_ONE_OF_OURS):
        solve(sj.paper_scene(memory=memory), solver)


def test_other_integrators_are_refused_for_a_latch():
    scene = sj.paper_scene()
    field, state, args = (
        sj.model.vector_field(scene),
        sj.initial_state(scene, sj.table_2_start()),
        sj.model.Args(scene),
    )
    step = sj.analysis.ode_step(field, dt=0.01, steps=2, args=args)
    for call in (lambda: step(state, 0.0), lambda: field(0.0, state, args)):
        with pytest.raises(RuntimeError, match=NEEDS_ONE_OF_OURS):
            call()
    frozen = field.evaluate(0.0, state, args)  # at one instant the derivative is asked for by name
    assert frozen.memory is None
    assert np.all(np.isfinite(jax.tree.leaves(frozen.motion)))


@pytest.mark.full
@pytest.mark.parametrize(
    "part", [sj.model.SmoothSwitch(), sj.model.HertzSpring(1e8)], ids=lambda part: type(part).__name__
)
def test_any_solver_takes_an_ode(part):
    scene = sj.paper_scene()
    name = "memory" if isinstance(part, sj.model.SmoothSwitch) else "contact"
    scene = dataclasses.replace(scene, **{name: part})
    ours = sj.period_map(scene, sj.initial_state(scene, sj.table_2_start()), steps_per_period=800)
    ends = solve(scene, diffrax.Tsit5(), dt0=1 / 800).motion, ours.motion
    there, here = (np.ravel(jax.tree.leaves(end)) for end in ends)
    np.testing.assert_allclose(there, here, atol=1e-2)


@pytest.mark.full
@pytest.mark.parametrize(
    "solver", [*(kind() for kind in OWN_SOLVERS.values()), sj.solvers.Latching(diffrax.Dopri5())], ids=solver_name
)
def test_own_solvers_take_a_latch_in_diffrax_without_a_check_in_the_program(solver):
    """Also where the controller chooses the first step, for which it asks the solver for a derivative."""
    scene, several = sj.paper_scene(), [{}]
    program = lambda solver, options: str(jax.make_jaxpr(lambda: solve(scene, solver, throw=False, **options))())
    if isinstance(getattr(solver, "solver", solver), diffrax.AbstractAdaptiveSolver):
        several.append(dict(dt0=None, stepsize_controller=diffrax.PIDController(rtol=1e-4, atol=1e-6)))
    assert all("pure_callback" not in program(solver, options) for options in several)
    assert "pure_callback" in program(diffrax.Tsit5(), {})  # which is how it is refused
