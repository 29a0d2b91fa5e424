"""Simplified Newton iterations in diffrax's implicit methods: the same stages, without LAPACK, on several threads."""

from concurrent.futures import ThreadPoolExecutor

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.model.dynamics import Args, vector_field
from slipperjax.model.kinematics import scaled_size
from slipperjax.model.step_size import settle_memory
from slipperjax.solvers.latching import _FrozenField
from slipperjax.solvers.simplified_newton import SimplifiedNewton, with_root_finder

from ..common import STEPS, fine

EXACT = optx.Newton(rtol=1e-12, atol=1e-12, norm=optx.max_norm)
LATCHED, SMOOTH = sj.paper_scene(), sj.paper_scene(memory=sj.model.SmoothSwitch())
FINER = SimplifiedNewton(tolerance=1e-11)
STEP = 1 / 100
"""Forcing periods."""


class OneStep:
    """A step of a diffrax solver from any state of a scene; with an event latch the memory is frozen."""

    def __init__(self, scene, solver):
        self.scene, self.tableau, field = settle_memory(scene), getattr(solver, "tableau", None), vector_field(scene)
        self.frozen = scene.latches_memory
        of_motion = lambda t, motion, memory: field.evaluate(t, sj.State(motion, memory), Args(self.scene)).motion
        whole = lambda t, state, _: field(t, state, Args(self.scene))
        self.rates = sj.jit(of_motion if self.frozen else whole)
        terms = diffrax.ODETerm(_FrozenField(field) if self.frozen else field)

        def step(t, h, y, memory):
            args = (memory, Args(self.scene)) if self.frozen else Args(self.scene)
            begin = solver.init(terms, t, t + h, y, args)
            y1, _, dense, _, result = solver.step(terms, t, t + h, y, args, begin, False)
            return y1, dense.get("k"), result

        begin = self.start(sj.initial_state(scene, sj.table_2_start()))
        self.lowered = jax.jit(step).lower(0.0, STEP, *begin)
        self.step = self.lowered.compile()

    def start(self, state):
        return (state.motion, state.memory) if self.frozen else (state, None)

    def misses(self, t, state, h=STEP):
        """Gives the scaled residual of the stages' equations, and whether all converged."""
        y, memory = self.start(state)
        y1, k, result = self.step(t, h, y, memory)
        if k is None:  # the implicit Euler method
            stages, weights, nodes = [jax.tree.map(jnp.subtract, y1, y)], np.ones((1, 1)), np.ones(1)
        else:
            stages = [jax.tree.map(lambda a, i=i: a[i], k) for i in range(len(self.tableau.b_sol))]
            weights = np.diag(np.asarray(self.tableau.a_diagonal))
            for i, row in enumerate(self.tableau.a_lower):
                weights[i + 1, : i + 1] = row
            nodes = np.append(0.0, self.tableau.c)
        worst = 0.0
        for row, node, stage in zip(weights, nodes, stages, strict=True):
            at = jax.tree.map(lambda a, *ks, row=row: a + row @ np.stack(ks), y, *stages)
            rest = jax.tree.map(lambda k, f: k - h * f, stage, self.rates(t + node * h, at, memory))
            worst = max(worst, float(scaled_size(rest if self.frozen else rest.motion)))
            if not self.frozen:
                worst = max(worst, float(np.max(np.abs(rest.memory))))
        return worst, bool(result == diffrax.RESULTS.successful)


@pytest.fixture(scope="module")
def euler():
    return OneStep(LATCHED, diffrax.ImplicitEuler(root_finder=FINER))


@pytest.fixture(scope="module")
def kvaerno():
    return OneStep(LATCHED, diffrax.Kvaerno5(root_finder=SimplifiedNewton()))


@pytest.fixture(scope="module")
def smooth():
    return OneStep(SMOOTH, diffrax.Kvaerno3(root_finder=FINER))


@pytest.fixture(scope="module")
def instants():
    """Times and states of two periods, in flight and in contact."""
    run = fine(LATCHED)
    at = np.arange(3, 2 * STEPS, 17)
    pick = jax.tree.map(lambda a: np.asarray(a)[at], run.state)
    assert np.sum(np.any(pick.memory < 0, axis=1)) > 10
    return [(float(run.period[k]), jax.tree.map(lambda a, i=i: jnp.asarray(a[i]), pick)) for i, k in enumerate(at)]


@pytest.mark.full
@pytest.mark.parametrize(("name", "most"), [("kvaerno", 1e-6), ("euler", 1e-10)])
def test_stages_solve_their_equations(name, most, instants, request):
    one = request.getfixturevalue(name)
    worst, good = zip(*(one.misses(t, state) for t, state in instants), strict=True)
    assert all(good)
    assert max(worst) < most  # measured: 4e-9, 7e-12


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # starts amid a motion
def test_stages_with_an_integrated_memory_solve_their_equations(smooth, instants):
    for t, state in instants:
        # the rate at touchdown of closed points, that of now of open ones
        rate = sj.initial_state(SMOOTH, state.motion).memory
        memory = jnp.where(state.memory < 0, 1 / jnp.where(state.memory < 0, state.memory, 1.0), rate)
        worst, good = smooth.misses(t, sj.State(state.motion, memory), STEP / 4)  # the switch is narrow
        assert good
        assert worst < 1e-8  # measured: 9e-10


@pytest.mark.full
def test_iterations_that_fail_are_marked(euler, instants):
    """Half a period is far too long a step for any contact."""
    t, state = next((t, state) for t, state in instants if np.any(state.memory < 0))
    assert not euler.misses(t, state, 0.5)[1]


@pytest.mark.full
def test_nothing_calls_lapack(euler, kvaerno, smooth):
    for one in (euler, kvaerno, smooth):
        assert "lapack" not in one.lowered.as_text()
    exact = sj.solvers.Latching(diffrax.ImplicitEuler(root_finder=EXACT))
    field, begin = vector_field(LATCHED), sj.initial_state(LATCHED, sj.table_2_start())
    args = Args(LATCHED)
    step = lambda t: exact.step(
        diffrax.ODETerm(field), t, t + STEP, begin, args, field.open_step(t, begin, args), False
    )[0]
    assert "lapack" in jax.jit(step).lower(0.0).as_text()


def end_of(scene, solver, steps=100):
    found = sj.simulate(scene, 2, steps_per_period=steps, solver=solver, loads=False, saves_per_period=1)
    assert int(found.status) == Status.FINITE
    return np.array(jax.tree.leaves(found.end.motion))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "kind"),
    [(LATCHED, diffrax.ImplicitEuler), (LATCHED, diffrax.Kvaerno5), (SMOOTH, diffrax.Kvaerno3)],
    ids=["latched, order 1", "latched, order 5", "smooth, order 3"],
)
def test_runs_are_those_of_newtons_method(scene, kind):
    ours, exact = end_of(scene, kind()), end_of(scene, kind(root_finder=EXACT))
    finer = end_of(scene, kind(root_finder=FINER))
    print(f"{kind.__name__}: {np.abs(ours - exact).max():.1e}, {np.abs(finer - exact).max():.1e} from Newton's")
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-6)  # measured: 5e-8, 2e-8, 5e-9
    np.testing.assert_allclose(finer, exact, rtol=0, atol=1e-8)  # measured: 5e-10


def test_other_equations_are_refused():
    term, solver = diffrax.ODETerm(lambda t, y, args: -y), diffrax.Kvaerno3(root_finder=SimplifiedNewton())
    with pytest.raises(ValueError, match="`root_finder` must be another one than SimplifiedNewton"):
        diffrax.diffeqsolve(term, solver, 0.0, 1.0, 0.1, jnp.ones(2), stepsize_controller=diffrax.ConstantStepSize())


def test_it_is_the_default_and_others_stay():
    assert isinstance(with_root_finder(diffrax.Kvaerno5()).root_finder, SimplifiedNewton)
    assert with_root_finder(diffrax.Kvaerno5(root_finder=EXACT)).root_finder is EXACT
    assert isinstance(sj.solvers.Latching(diffrax.Kvaerno4()).solver.root_finder, SimplifiedNewton)


def sweeps(count, solver):
    """Sweeps of two chunks at once, on two threads."""
    grid, options = {"speed": np.linspace(1200.0, 1300.0, 16)}, dict(transient=0, periods=1, steps_per_period=20)
    run = lambda: sj.sweep(LATCHED, grid, record="strobe", loads=False, solver=solver, chunk=8, workers=2, **options)
    first = run()["strobe"].values
    for _ in range(count):
        np.testing.assert_array_equal(run()["strobe"].values, first)


@pytest.mark.full
def test_threads_do_not_wait_for_each_other():
    with ThreadPoolExecutor(1) as pool:
        pool.submit(sweeps, 20, diffrax.ImplicitEuler()).result(timeout=300)
