"""Simplified Newton iterations in diffrax's implicit methods: the same motions, without LAPACK, on threads."""

from concurrent.futures import ThreadPoolExecutor

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.solvers.simplified_newton import SimplifiedNewton, with_root_finder

EXACT = optx.Newton(rtol=1e-12, atol=1e-12, norm=optx.max_norm)
LATCHED, SMOOTH = sj.paper_scene(), sj.paper_scene(memory=sj.model.SmoothSwitch())


def simulated(scene, solver, steps=100):
    return sj.simulate(scene, 2, steps_per_period=steps, solver=solver, loads=False, saves_per_period=1)


METHODS = {
    "order 1": pytest.param(LATCHED, diffrax.ImplicitEuler, marks=pytest.mark.full),
    "order 5": pytest.param(LATCHED, diffrax.Kvaerno5, marks=pytest.mark.slow),
    "smooth": pytest.param(SMOOTH, diffrax.Kvaerno3, marks=pytest.mark.slow),
}


@pytest.mark.parametrize(("scene", "kind"), METHODS.values(), ids=METHODS)
def test_motions_are_those_of_newtons_method(scene, kind):
    runs = [simulated(scene, kind(**own)) for own in ({}, {"root_finder": EXACT})]
    runs.append(simulated(scene, kind(root_finder=SimplifiedNewton(tolerance=1e-11))))
    assert [int(run.status) for run in runs] == [Status.FINITE] * 3
    ours, exact, finer = (np.array(jax.tree.leaves(run.end.motion)) for run in runs)
    np.testing.assert_allclose(ours, exact, atol=1e-6)  # measured: 5e-8, 2e-8, 5e-9
    np.testing.assert_allclose(finer, exact, atol=1e-8)  # measured: 5e-10


@pytest.mark.full
def test_iterations_that_fail_are_marked():
    """Half a period is far too long a step for any contact."""
    assert int(simulated(LATCHED, diffrax.ImplicitEuler(), 2).status) == Status.NOT_FINITE


@pytest.mark.full
@pytest.mark.parametrize("scene", [LATCHED, SMOOTH], ids=["latched", "smooth"])
def test_nothing_calls_lapack(scene):
    state = sj.initial_state(scene, sj.table_2_start())
    for finder, calls in (({}, False), ({"root_finder": EXACT}, True)):
        solver = diffrax.Kvaerno3(**finder)
        end = lambda state, solver=solver: sj.period_map(scene, state, steps_per_period=10, solver=solver)
        assert ("lapack" in jax.jit(end).lower(state).as_text()) == calls


def test_other_equations_are_refused():
    term, solver = diffrax.ODETerm(lambda t, y, args: -y), diffrax.Kvaerno3(root_finder=SimplifiedNewton())
    with pytest.raises(ValueError, match="`root_finder` must be another one than SimplifiedNewton"):
        diffrax.diffeqsolve(term, solver, 0.0, 1.0, 0.1, jnp.ones(2), stepsize_controller=diffrax.ConstantStepSize())


def test_it_is_the_default_and_others_stay():
    assert isinstance(with_root_finder(diffrax.Kvaerno5()).root_finder, SimplifiedNewton)
    assert with_root_finder(diffrax.Kvaerno5(root_finder=EXACT)).root_finder is EXACT
    assert isinstance(sj.solvers.Latching(diffrax.Kvaerno4()).solver.root_finder, SimplifiedNewton)


@pytest.mark.full
def test_threads_do_not_wait_for_each_other():
    """In sweeps of two chunks at once, on two threads."""
    grid, options = {"speed": np.linspace(1200.0, 1300.0, 16)}, dict(transient=0, periods=1, steps_per_period=20)
    options |= dict(record="strobe", loads=False, solver=diffrax.ImplicitEuler(), chunk=8, workers=2)
    run = lambda: sj.sweep(LATCHED, grid, **options)["strobe"].values
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(lambda: [run() for _ in range(21)]).result(timeout=300)
    assert all(np.array_equal(one, found[0]) for one in found)
