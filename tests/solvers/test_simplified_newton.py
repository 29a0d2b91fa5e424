"""Simplified Newton iterations in diffrax's implicit methods: the same stages, without LAPACK, on several threads."""

from concurrent.futures import ThreadPoolExecutor

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.model.dynamics import Args, vector_field
from slipperjax.model.step_size import settle_memory
from slipperjax.solvers.simplified_newton import SimplifiedNewton, with_root_finder

EXACT = optx.Newton(rtol=1e-12, atol=1e-12, norm=optx.max_norm)
LATCHED, SMOOTH = sj.paper_scene(), sj.paper_scene(memory=sj.SmoothSwitch())


def end_of(scene, solver, steps=100):
    found = sj.simulate(scene, 2, steps_per_period=steps, solver=solver, loads=False, saves_per_period=1)
    assert int(found.status) == Status.FINITE
    return np.array(jax.tree.leaves(found.end.motion))


@pytest.mark.parametrize(
    ("scene", "kind"),
    [
        (LATCHED, diffrax.ImplicitEuler),
        pytest.param(LATCHED, diffrax.Kvaerno5, marks=pytest.mark.slow),
        pytest.param(SMOOTH, diffrax.Kvaerno3, marks=pytest.mark.slow),
    ],
    ids=["latched, order 1", "latched, order 5", "smooth, order 3"],
)
def test_stages_are_those_of_newtons_method(scene, kind):
    ours, exact = end_of(scene, kind()), end_of(scene, kind(root_finder=EXACT))
    finer = end_of(scene, kind(root_finder=SimplifiedNewton(tolerance=1e-11)))
    print(f"{kind.__name__}: {np.abs(ours - exact).max():.1e}, {np.abs(finer - exact).max():.1e} from Newton's")
    np.testing.assert_allclose(ours, exact, atol=1e-6)  # measured: 5e-8, 2e-8, 5e-9
    np.testing.assert_allclose(finer, exact, atol=1e-8)  # measured: 5e-10


@pytest.mark.slow
def test_an_additive_method_takes_it():
    """Weight in the explicit part, everything else in the implicit one."""
    scene = settle_memory(sj.paper_scene(memory=sj.SmoothSwitch()))
    field = vector_field(scene)
    state = sj.initial_state(scene, sj.table_2_start())

    def weight(t, y, args):
        nothing = jax.tree.map(jnp.zeros_like, y)
        return eqx.tree_at(lambda s: s.motion.v_z, nothing, -9.81 * scene.period)

    def end(terms, solver, steps):
        how = dict(args=Args(scene, 0.0), stepsize_controller=diffrax.ConstantStepSize(), max_steps=4096)
        found = diffrax.diffeqsolve(terms, solver, 0.0, 1.0, 1 / steps, state, **how)
        return np.array(jax.tree.leaves(found.ys.motion))[:, -1]

    parts = diffrax.MultiTerm(diffrax.ODETerm(weight), diffrax.ODETerm(field))
    ours, exact = (end(parts, diffrax.KenCarp4(root_finder=finder), 100) for finder in (SimplifiedNewton(), EXACT))
    print(f"additive method: {np.abs(ours - exact).max():.1e} from Newton's")
    np.testing.assert_allclose(ours, exact, atol=1e-6)  # measured: 1e-8
    both = lambda t, y, args: jax.tree.map(jnp.add, field(t, y, args), weight(t, y, args))
    explicit = end(diffrax.ODETerm(both), diffrax.Dopri5(), 800)
    np.testing.assert_allclose(ours[5:], explicit[5:], atol=0.05)  # the switch is narrow; measured: 2e-3
    assert abs(ours[6] - end(diffrax.ODETerm(field), diffrax.Dopri5(), 800)[6]) > 0.01  # weight counts


def test_other_equations_are_refused():
    term, solver = diffrax.ODETerm(lambda t, y, args: -y), diffrax.Kvaerno3(root_finder=SimplifiedNewton())
    with pytest.raises(ValueError, match="`root_finder` must be another one than SimplifiedNewton"):
        diffrax.diffeqsolve(term, solver, 0.0, 1.0, 0.1, jnp.ones(2), stepsize_controller=diffrax.ConstantStepSize())


def test_it_is_the_default_and_others_stay():
    assert isinstance(with_root_finder(diffrax.Kvaerno5()).root_finder, SimplifiedNewton)
    assert with_root_finder(diffrax.Kvaerno5(root_finder=EXACT)).root_finder is EXACT
    assert isinstance(sj.Latching(diffrax.Kvaerno4()).solver.root_finder, SimplifiedNewton)


def test_nothing_calls_lapack():
    def end(speed, finder):
        scene = sj.paper_scene().replace(speed=speed)
        state = sj.initial_state(scene, sj.table_2_start())
        solver = sj.Latching(diffrax.Kvaerno3(root_finder=finder))
        return sj.period_map(scene, state, steps_per_period=20, solver=solver).motion.v_y

    text = lambda finder: jax.jit(lambda v: end(v, finder)).lower(1250.0).as_text()
    assert "lapack" not in text(SimplifiedNewton())
    assert "lapack" in text(EXACT)


def test_iterations_that_fail_are_marked():
    """Two steps per period are far too long for any contact."""
    solver = diffrax.ImplicitEuler(root_finder=SimplifiedNewton(), root_find_max_steps=2)
    found = sj.simulate(sj.paper_scene(), 4, steps_per_period=2, solver=solver, loads=False)
    assert int(found.status) == Status.NOT_FINITE


def sweeps(count, solver):
    """Sweeps of two chunks at once, on two threads."""
    grid, options = {"speed": np.linspace(1200.0, 1300.0, 16)}, dict(transient=0, periods=1, steps_per_period=20)
    run = lambda: sj.sweep(LATCHED, grid, record="strobe", loads=False, solver=solver, chunk=8, workers=2, **options)
    first = run()["v_y"].values
    for _ in range(count):
        np.testing.assert_array_equal(run()["v_y"].values, first)


def test_threads_do_not_wait_for_each_other():
    with ThreadPoolExecutor(1) as pool:
        pool.submit(sweeps, 20, diffrax.ImplicitEuler()).result(timeout=300)


@pytest.mark.slow
def test_a_thousand_calls_on_two_threads_end():
    with ThreadPoolExecutor(1) as pool:
        pool.submit(sweeps, 1000, diffrax.Kvaerno5()).result(timeout=1800)
