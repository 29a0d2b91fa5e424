"""Tools of others beside ours on tasks with known answers: the figures of docs/lab/rivals.md.

    pip install '.[test,peers]' bifpy
    pytest -m benchmark -s tests/benchmarks/test_rivals.py

Tools that are not installed are left out. bifpy is AUTO-07p from Python; it is built from source, by gfortran.
"""

import functools
import inspect
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis import map_spectrum, switched_step

from ..analysis.systems import HENON_AT, Stopped, two_trajectories
from ..analysis.test_lyapunov import Rk4
from . import rivals
from .rivals import GAP, PERIOD, PERIODS, D, K, W
from .timing import in_turns

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("default")]


def free(t, y):
    return jnp.stack([y[1], jnp.cos(2.6 * t) - 0.04 * y[1] - y[0]])


def touching(t, y):
    return free(t, y) + jnp.stack([0 * t, jnp.maximum(-100 * y[0] - 4 * y[1], 0.0)])


def lines(function):
    return len([line for line in inspect.getsource(function).splitlines()[1:] if line.strip()])


FORCES = np.linspace(0.3, 0.5, 241)
BATCHED = {
    "switched_step, 400 steps": (rivals.by_switched_step, (400,)),
    "switched_step, 800 steps": (rivals.by_switched_step, (800,)),
    "diffrax, events, 1e-6": (rivals.by_diffrax_events, (1e-6, None)),
    "diffrax, events, 1e-8, T/80": (rivals.by_diffrax_events, (1e-8, PERIOD / 80)),
    "diffrax alone, 1e-8": (rivals.by_diffrax_alone, (1e-8,)),
}
SCIPY = "SciPy, events, 1e-6"


def exact(force):
    step = Stopped(*map(jnp.asarray, (D, W)), force, *map(jnp.asarray, (GAP, K, 1.0)), passes=8)
    return jax.lax.fori_loop(0, PERIODS, lambda k, state: step(state, k), jnp.zeros(2))


def quantiles(misses):
    return " ".join(f"{q:.1e}" for q in np.quantile(np.max(np.abs(misses), axis=1), (0.5, 0.9, 1.0)))


def test_an_oscillator_with_a_stop():
    true, slopes = (jax.jit(jax.vmap(f))(FORCES) for f in (exact, jax.jacfwd(exact)))
    size = np.median(np.max(np.abs(slopes), axis=1))
    runs = {name: (lambda force, f=f, of=of: f(force, *of)) for name, (f, of) in BATCHED.items()}
    many = {name: functools.partial(jax.jit(jax.vmap(run)), FORCES) for name, run in runs.items()}
    one = {name: functools.partial(jax.jit(run), FORCES[0]) for name, run in runs.items()}
    each = lambda forces: np.array([rivals.by_scipy_events(force, 1e-6) for force in forces])
    many[SCIPY], one[SCIPY] = lambda: each(FORCES), lambda: each(FORCES[:1])
    jax.clear_caches()
    many, one = in_turns(many, 5), in_turns(one, 15)
    derivatives = {name: jax.jit(jax.vmap(jax.jacfwd(run)))(FORCES) for name, run in runs.items()}
    derivatives[SCIPY] = (each(FORCES + 1e-3) - each(FORCES - 1e-3)) / 2e-3
    print(f"\n{len(FORCES)} oscillators with a stop, {PERIODS} periods; errors: median, 90 %, worst")
    for name, timed in many.items():
        user = lines(BATCHED[name][0] if name in BATCHED else rivals.by_scipy_events)
        cost = 1e6 * timed.median / len(FORCES) / PERIODS, 1e6 * one[name].median / PERIODS
        print(
            f"  {name:28} {user:2} lines, first {timed.first:5.2f} s, then {cost[0]:6.1f} us per case and period, "
            f"{cost[1]:5.0f} us for a single case; {quantiles(timed.result - true)}; "
            f"derivatives {quantiles((derivatives[name] - slopes) / size)}"
        )
    assert np.max(np.abs(many["switched_step, 400 steps"].result - true)) < 1e-4  # measured: 1.2e-5


LORENZ = np.array([0.9056, 0.0, -14.5723])


@pytest.mark.parametrize("rival", ["lyapax", "pynamicalsys"])
def test_lorenz(rival):
    pytest.importorskip(rival)
    runs = {name: getattr(rivals, f"lorenz_by_{name}") for name in ("slipperjax", rival)}
    print(f"\nLorenz's three exponents and their errors; {rival} {version(rival)}")
    jax.clear_caches()
    for name, timed in in_turns(runs, 5).items():
        errors = " ".join(f"{error:.1e}" for error in np.abs(timed.result - LORENZ))
        print(
            f"  {name:12} {lines(runs[name])} lines, first {timed.first:5.2f} s, then {timed.median:.3f} s; {errors}"
        )
        assert abs(timed.result[0] - LORENZ[0]) < 0.03


def test_a_force_that_jumps():
    lyapax = pytest.importorskip("lyapax")
    period, start = 2 * np.pi / 2.6, jnp.array([0.5, 0.0])
    split = switched_step(free, touching, lambda t, y: y[0], dt=period / 200, steps=200)
    blind = Rk4(lambda t, y: jnp.where(y[0] >= 0, free(t, y), touching(t, y)), period / 200, 200)
    options = dict(transient=100, align=20, period=period)
    theirs = lambda step: lyapax.lyapunov_spectrum(
        lambda y: step(y, 0.0), start, period, n_steps=2000, t_transient=100 * period
    )
    print("\nExponents of an impact oscillator whose force jumps, per unit of time")
    apart = two_trajectories(split, start, 2120)[120:] / period
    print("  two trajectories, switched_step:", np.mean(apart))
    print("  slipperjax, switched_step:      ", map_spectrum(split, start, 2000, **options).per_second)
    print("  lyapax, given switched_step:    ", theirs(split).exponents)
    print("  lyapax, a step without a split: ", theirs(blind).exponents)


DUFFING_FLIP = 0.2655817860556
"""By SciPy's DOP853 at 1e-13 with the variational equations, Newton's method and Brent's."""
TRUE = {"henon": {label: value(0.3) for label, value in HENON_AT.items()}, "duffing": {"PD": DUFFING_FLIP}}


@pytest.mark.parametrize("rival", ["bifpy", "jaxcont"])
@pytest.mark.parametrize("system", TRUE)
def test_bifurcations_on_a_branch(rival, system):
    pytest.importorskip(rival)
    guess = rivals.settled() if system == "duffing" else ()
    users = {name: getattr(rivals, f"{system}_by_{name}") for name in ("slipperjax", rival)}
    runs = {name: functools.partial(user, *guess) for name, user in users.items()}
    print(f"\nBifurcations of {system} and the errors of their places; {rival} {version(rival)}")
    jax.clear_caches()
    for name, timed in in_turns(runs, 3 if system == "henon" else 1).items():
        found, count = timed.result, lines(users[name])
        errors = {label: abs(found[label] - true) for label, true in TRUE[system].items() if label in found}
        told = ", ".join(f"{label} {error:.1e}" for label, error in errors.items())
        print(f"  {name:12} {count:2} lines, first {timed.first:5.2f} s, then {timed.median:6.3f} s; {told}")
        assert errors
        assert max(errors.values()) < 1e-6
