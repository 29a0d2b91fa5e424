"""Every solver against every system with a solution in closed form: states, orders and derivatives."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.stepping import ConstantSteps

from ..common import QUICK, among
from ..systems.fields import Ball, Smooth, rebound, rebound_slope

pytestmark = pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # a stiffness of one

compiled = functools.partial(jax.jit, compiler_options=QUICK)
DOPRI = sj.solvers.Latching(diffrax.Dopri5())
SOLVERS = {"RK4": sj.solvers.RK4(), "Tsit5": sj.solvers.Tsit5(), "Dopri5": DOPRI, "TwoStep": sj.solvers.TwoStep()}
SOLVERS |= {"Rodas4": sj.solvers.Rodas4(), "ROS34PW2": sj.solvers.ROS34PW2()}
"""All of them, with one of diffrax's."""


@functools.cache
def smooth_end(solver):
    """The motion at the last of some times, by the solver's own `init` and `step`."""
    terms, args = diffrax.ODETerm(Smooth()), sj.model.Args(Smooth.scene)

    @compiled
    def end(times):
        first = sj.State(sj.Motion(*map(jnp.asarray, Smooth.exact(0.0))), None)
        begin = first, solver.init(terms, times[0], times[1], first, args)

        def one(carry, ends):
            y, state = carry
            return solver.step(terms, *ends, y, args, state, False)[::3], None

        return jax.lax.scan(one, begin, (times[:-1], times[1:]))[0][0].motion

    return end


def even(n):
    return np.linspace(0.0, 1.0, n + 1)


def uneven(n):
    """Steps whose ratio to the previous step is up to 1.6 or down to its inverse; equally smooth for every n."""
    x = even(n)
    return x + 0.1 * np.sin(2 * np.pi * x) + 0.15 / n * np.sin(np.pi * np.arange(n + 1) / 2) * (x * (1 - x) > 0)


# Measured: orders 4.06, 4.77, 4.94, 2.00, 1.99, 2.01, 4.12, 3.01;
# errors at 64 steps 1.2e-8, 3.3e-12, 2.3e-11, 2.3e-4, 4.1e-4, 3.5e-4, 1.0e-9, 2.2e-6
ORDERS = {
    "RK4": (sj.solvers.RK4(), even, 4, 3e-8),
    "Tsit5": (sj.solvers.Tsit5(), even, 5, 1e-11),
    "Dopri5": (DOPRI, even, 5, 6e-11),
    "TwoStep": (sj.solvers.TwoStep(), even, 2, 1e-3),
    "TwoStep, uneven": (sj.solvers.TwoStep(), uneven, 2, 1e-3),
    "TwoStep without damping": (sj.solvers.TwoStep(rho_inf=1.0), uneven, 2, 1e-3),
    "Rodas4": (sj.solvers.Rodas4(), even, 4, 3e-9),
    "ROS34PW2": (sj.solvers.ROS34PW2(), even, 3, 5e-6),
}


@pytest.mark.parametrize("case", among(ORDERS, "RK4", "ROS34PW2", slow=["TwoStep without damping"]))
def test_order_on_a_smooth_motion(case):
    solver, times, order, most = case
    error = lambda times: np.abs(np.array(jax.tree.leaves(smooth_end(solver)(times))) - Smooth.exact(times[-1])).max()
    coarse, fine = error(times(32)), error(times(64))
    assert fine < most
    assert order - 0.25 < np.log2(coarse / fine) < order + 0.7


LAWS = (sj.model.Flores, sj.model.HuntCrossley, sj.model.LankaraniNikravesh)
AT = np.array([1e8, 0.5, 0.7])
"""Stiffness [N/m^1.5], restitution [1] and approach speed [m/s]."""


def after_impact(relative, stepping, solver, law=sj.model.Flores):
    """Speed [m/s] of a ball after its impact on the plane, from values relative to `AT`."""
    plain = sj.paper_scene()
    stiffness, restitution, approach = relative * AT
    scene = sj.Scene(100.0, plain.slipper, plain.section, sj.model.StraightTrack(), law(1.0, 0.5), window=1.0)
    scene = scene.replace(stiffness=stiffness, restitution=restitution)
    motion = jax.tree.map(lambda v: jnp.asarray(v, float), sj.Motion(z=1e-3, v_z=-approach))
    state = sj.State(motion, jnp.zeros(1))
    terms, args, solver = diffrax.ODETerm(Ball()), sj.model.Args(scene), stepping.prepared(solver)
    begin = stepping.begin(terms, solver, state, args)
    return stepping.period(terms, solver, state, begin, args, None).end.motion.v_z


def factor(law):
    return float(law(1.0, AT[1]).factor)


# Measured: orders 2.5, 2.5, 2.5, 1.9, 2.5, 2.5;
# errors at 800 steps 4.5e-8, 4.3e-8, 4.5e-8, 1.8e-6, 5.6e-8, 6.2e-8 m/s
REBOUNDS = {name: (solver, sj.model.Flores) for name, solver in SOLVERS.items()}
REBOUNDS |= {law.__name__: (sj.solvers.RK4(), law) for law in LAWS[1:]}


@pytest.mark.parametrize("case", among(REBOUNDS, "RK4", "Tsit5", *(law.__name__ for law in LAWS)))
def test_rebound_of_a_ball(case):
    solver, law = case
    run = compiled(lambda steps: after_impact(jnp.ones(3), ConstantSteps(None, steps), solver, law))
    exact = AT[2] * rebound(factor(law))
    coarse, fine = (abs(float(run(jnp.asarray(steps))) - exact) for steps in (100.0, 800.0))
    assert fine < (4e-6 if isinstance(solver, sj.solvers.TwoStep) else 1.5e-7)
    assert np.log2(coarse / fine) / 3 > 1.85


def exact_slopes():
    """Derivatives of the speed after the impact with respect to values relative to `AT`."""
    c_r, e, slope = AT[1], rebound(factor(sj.model.Flores)), rebound_slope(factor(sj.model.Flores))
    return np.array([0.0, AT[2] * slope * (-8 / (5 * c_r**2)) * c_r, AT[2] * e])


MODES = {"jacfwd": jax.jacfwd, "jacrev": jax.jacrev}
DERIVATIVES = {f"{name} {mode}": (SOLVERS[name], MODES[mode]) for name in SOLVERS for mode in MODES}
QUICKLY_COMPILED = {"RK4 jacfwd", "RK4 jacrev", "TwoStep jacfwd"}


@pytest.mark.parametrize("case", among(DERIVATIVES, slow=DERIVATIVES.keys() - QUICKLY_COMPILED))
def test_derivatives_of_a_balls_rebound(case):
    solver, differentiate = case
    found = compiled(differentiate(lambda x: after_impact(x, ConstantSteps(800), solver)))(jnp.ones(3))
    np.testing.assert_allclose(found, exact_slopes(), atol=1e-4)  # measured: 3e-5 and less
