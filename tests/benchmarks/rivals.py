"""What a user writes for each of several tools, on tasks with known answers. A body is what is counted as lines.

An oscillator with a spring as its stop, from rest: x'' + 2 D x' + x + K max(x - GAP, 0) = force cos(W t).
"""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp

from slipperjax.analysis import continue_motion, ode_spectrum, ode_step, switched_step
from slipperjax.analysis.shooting import PeriodicMotions

D, W, GAP, K, PERIODS = 0.05, 0.8, 0.5, 100.0, 10
PERIOD = 2 * np.pi / W
END = PERIOD * PERIODS


def by_switched_step(force, steps):
    away = lambda t, y: jnp.stack([y[1], force * jnp.cos(W * t) - 2 * D * y[1] - y[0]])
    against = lambda t, y: away(t, y) - jnp.stack([0 * t, K * (y[0] - GAP)])
    step = switched_step(against, away, lambda t, y: y[0] - GAP, dt=PERIOD / steps, steps=PERIODS * steps)
    return step(jnp.zeros(2), 0.0)


def by_diffrax_events(force, tolerance, longest):
    def field(t, y, against):
        return jnp.stack([y[1], force * jnp.cos(W * t) - 2 * D * y[1] - y[0] - against * K * (y[0] - GAP)])

    def to_next(carry):
        t, y, against = carry
        term = diffrax.ODETerm(field)
        part = diffrax.diffeqsolve(term, diffrax.Tsit5(), t, END, 0.01, y, args=against, **options)
        return part.ts[-1], part.ys[-1], 1 - against

    height = lambda t, y, args, **_: (1 - 2 * args) * (y[0] - GAP)
    event = diffrax.Event(height, optimistix.Newton(1e-10, 1e-10), direction=True)
    steps = diffrax.PIDController(rtol=tolerance, atol=tolerance, dtmax=longest)
    options = dict(stepsize_controller=steps, event=event, adjoint=diffrax.ForwardMode(), throw=False)
    return jax.lax.while_loop(lambda carry: carry[0] < END, to_next, (0.0, jnp.zeros(2), 0.0))[1]


def by_diffrax_alone(force, tolerance):
    def field(t, y, _):
        return jnp.stack([y[1], force * jnp.cos(W * t) - 2 * D * y[1] - y[0] - K * jnp.maximum(y[0] - GAP, 0.0)])

    steps = diffrax.PIDController(rtol=tolerance, atol=tolerance)
    options = dict(stepsize_controller=steps, adjoint=diffrax.ForwardMode(), max_steps=2**14)
    return diffrax.diffeqsolve(diffrax.ODETerm(field), diffrax.Tsit5(), 0.0, END, 0.01, jnp.zeros(2), **options).ys[
        -1
    ]


def by_scipy_events(force, tolerance):
    def field(t, y):
        return [y[1], force * np.cos(W * t) - 2 * D * y[1] - y[0] - against * K * (y[0] - GAP)]

    t, y, against = 0.0, np.zeros(2), 0
    height = lambda t, y: y[0] - GAP
    height.terminal = True
    while t < END:
        height.direction = 1 - 2 * against
        part = solve_ivp(field, (t, END), y, method="DOP853", rtol=tolerance, atol=tolerance, events=height)
        t, y, against = part.t[-1], part.y[:, -1], 1 - against
    return y


START, DT, INTERVALS = np.array([1.0, 1.0, 20.0]), 0.01, 20_000
"""Of Lorenz's system: ten steps of DT in an interval, as many intervals after a transient of 200."""


def lorenz(t, y, _=None):
    return jnp.stack([10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]])


def lorenz_by_slipperjax():
    return ode_spectrum(lorenz, START, INTERVALS, dt=DT, steps=10, transient=200, align=100).per_second


def lorenz_by_lyapax():
    import lyapax

    problem = lyapax.ode_problem(lambda y: lorenz(0.0, y), state0=jnp.asarray(START), dt=DT)
    return lyapax.lyapunov_spectrum(problem, n_steps=10 * INTERVALS, renorm_every=10, t_transient=20.0).exponents


def lorenz_by_pynamicalsys():
    from pynamicalsys import ContinuousDynamicalSystem

    system = ContinuousDynamicalSystem(model="lorenz system")
    system.integrator("rk4", time_step=DT)
    return system.lyapunov(START, 10 * INTERVALS * DT, parameters=[10.0, 28.0, 8 / 3], transient_time=20.0)


def henon(a):
    return lambda s, k: jnp.stack([a - s[0] ** 2 + 0.3 * s[1], s[0]])


def henon_by_slipperjax():
    branch = continue_motion(PeriodicMotions(henon, jnp.zeros(2), 1.0), (jnp.full(2, 0.6), 0.78), (-1.0, 1.0))
    return {event.label: event.value for event in branch.events}


def henon_by_bifpy():
    from bifpy import auto

    def start(state, parameters, _):
        parameters[0], state[0], state[1] = 0.78, 0.6, 0.6

    step = lambda s, p: [p[0] - s[0] ** 2 + 0.3 * s[1], s[0]]
    settings = dict(ips=auto.IPS_MAP, ndim=2, npar=1, nmx=400, mxbf=0, rl0=-1.0, rl1=1.0)
    settings |= dict(ds=-0.02, dsmin=1e-4, dsmax=0.05, epsl=1e-9, epsu=1e-9, epss=1e-9)
    return of_auto(auto.run(step, start, settings, icu=[1]))


def of_auto(run):
    names = {"FOLD": "LP", "PERIOD_DOUBLING": "PD"}
    points = [point for branch in run.branches for point in branch.ds if point.point_type.name in names]
    return {names[point.point_type.name]: point.parameters[0] for point in points}


def henon_by_jaxcont():
    import jaxcont as jc

    problem = jc.bif_problem(lambda s, a, _: henon(a)(s, 0) - s, u0=jnp.full(2, 0.6), p0=0.78)
    settings = jc.ContinuationPar(ds=-0.02, max_steps=60, newton_tol=1e-10)
    result = jc.continuation(problem, p_span=(0.78, -1.0), settings=settings, events=[jc.Fold()])
    return {"LP": result.events[0].p}


DRIVE = 2 * np.pi / 1.2
"""Period of Duffing's x'' + 0.3 x' - x + x^3 = force cos(1.2 t)."""


def settled():
    """Instants of a period and the motion then at a force of 0.25, with the cosine and sine of the forcing."""
    field = lambda t, y: [y[1], 0.25 * np.cos(1.2 * t) - 0.3 * y[1] + y[0] - y[0] ** 3]
    start = solve_ivp(field, (0.0, 60 * DRIVE), [1.0, 0.0], rtol=1e-9, atol=1e-9).y[:, -1]
    times = np.linspace(0.0, DRIVE, 201)
    motion = solve_ivp(field, (0.0, DRIVE), start, t_eval=times, rtol=1e-9, atol=1e-9).y.T
    return times, np.column_stack([motion, np.cos(1.2 * times), np.sin(1.2 * times)])


def autonomous(s, force):
    """Duffing's oscillator for tools without forcing: two states more go round a circle and give the cosine."""
    x, v, c, d = s[0], s[1], s[2], s[3]
    away = 1 - c**2 - d**2
    return [v, force * c - 0.3 * v + x - x**3, c * away - 1.2 * d, d * away + 1.2 * c]


def duffing(force):
    field = lambda t, y, _: jnp.stack([y[1], force * jnp.cos(1.2 * t) - 0.3 * y[1] + y[0] - y[0] ** 3])
    return ode_step(field, dt=DRIVE / 200, steps=200)


def duffing_by_slipperjax(times, orbit):
    motions = PeriodicMotions(duffing, jnp.zeros(2), 1.0)
    branch = continue_motion(motions, (jnp.asarray(orbit[0, :2]), 0.25), (0.2, 0.32))
    return {event.label: event.value for event in branch.events}


def duffing_by_bifpy(times, orbit):
    from bifpy import auto

    def start(state, parameters, _):
        parameters[0], parameters[10] = 0.25, DRIVE

    field = lambda s, p: autonomous(s, p[0])
    settings = dict(ips=auto.IPS_PERIODIC_ORBIT, ndim=4, npar=11, ntst=40, nmx=200, mxbf=0, rl0=0.2, rl1=0.32)
    settings |= dict(ds=0.005, dsmin=1e-4, dsmax=0.02, epsl=1e-9, epsu=1e-9, epss=1e-8)
    run = auto.run(field, start, settings, icu=[1, auto.PERIOD_INDEX], dat=(times / DRIVE, orbit), transpile=True)
    return of_auto(run)


def duffing_by_jaxcont(times, orbit):
    import jaxcont as jc
    from jaxcont.core.collocation import Collocation
    from jaxcont.problems.periodic import periodic_orbit_problem

    field, mesh = lambda s, force, _: jnp.stack(autonomous(s, force)), Collocation(20, 4)
    problem = periodic_orbit_problem(field, jnp.asarray(orbit), jnp.asarray(times), DRIVE, 0.25, mesh)
    settings = jc.ContinuationPar(ds=0.005, ds_max=0.2, max_steps=20, newton_tol=1e-8)
    result = jc.continuation(problem, p_span=(0.25, 0.32), settings=settings, events=[jc.PeriodDoubling(field, mesh)])
    return {"PD": result.events[0].p}
