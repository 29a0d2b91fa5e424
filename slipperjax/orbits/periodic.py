"""Periodic motions of one slipper as exact objects, with their multipliers and contact signatures."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..analysis.floquet import circle_error, multipliers
from ..analysis.newton import without_derivatives
from ..analysis.shooting import Shot, minimal_period, shoot
from ..flow.period_map import PeriodMap, tangent_weights
from ..flow.record import RecordSet
from ..flow.simulate import (
    Trajectory,
    default_steps,
    dynamic_steps,
    first_of,
    refuse_periods,
    run_eagerly,
    simulate,
)
from ..flow.status import Status, status_of
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State, initial_state
from ..model.kinematics import Motion
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene, check_scene
from ..solvers.named import resolve_solver
from ..tools.checks import number, positive, shown_number, whole
from ..tools.compile import is_traced, jit
from .motions import check_forcing, consistent_state
from .signature import Gaps, GapSamples, Signature, signature

TOLERANCE = 1e-10
"""Default scaled residual at which an orbit counts as found [1]: 1e-13 m, 1e-10 m/s."""
MOST_PERIOD = 10_000
"""Forcing periods of an orbit above which it is refused."""
DIVISOR = 1e-6
"""Scaled residual below which a motion already recurs after a divisor of its period [1]."""


class PeriodicOrbit(eqx.Module):
    """A motion that recurs after `period` forcing periods."""

    scene: Scene
    state: State
    """At the start of a forcing period."""
    multipliers: Any
    """Floquet multipliers over the orbit's period [1], complex, the largest modulus first, shape (size,)."""
    residual: Float[Array, ""]
    """Greatest change of the state over the period, in multiples of `slipperjax.model.MOTION_SCALES` [1]."""
    iterations: Any
    """Iterations of Newton's method."""
    status: Any
    """0 for an orbit, else see `slipperjax.Status`."""
    period: int = eqx.field(static=True)
    """Forcing periods after which the motion recurs [1]: the least, unless the scene was traced."""
    steps_per_period: Any
    solver: diffrax.AbstractSolver = eqx.field(static=True)

    def __repr__(self) -> str:
        if is_traced(self.state) or np.ndim(self.residual):
            return f"PeriodicOrbit(period={self.period}, residual={shown_number(self.residual)})"
        status = Status(int(self.status))
        # the three largest
        leading = ", ".join(f"{m:.5g}" for m in np.asarray(self.multipliers)[:3])
        return (
            f"PeriodicOrbit(period {self.period} at {shown_number(self.scene.speed)} m/s, "
            f"{'stable' if self.stable else 'unstable'},\n  multipliers {leading}, ..., residual "
            f"{shown_number(self.residual)}, {shown_number(self.iterations)} iterations,\n"
            f"  status {int(status)}: {status})"
        )

    @property
    def stable(self) -> Any:
        """True where no multiplier lies outside the unit circle by more than its error, see `circle_error`."""
        inside = abs(self.multipliers[..., 0]) <= 1 + circle_error(self.multipliers)
        return inside if is_traced(inside) else bool(np.all(inside))

    @property
    def exponent(self) -> Any:
        """Largest Lyapunov exponent [1/period], ln |largest multiplier| per forcing period."""
        return jnp.log(jnp.abs(self.multipliers[..., 0])) / self.period

    def trajectory(self, periods: int | None = None, **options: Any) -> Trajectory:
        """Simulate the orbit, by default over its period; `options`: of `slipperjax.simulate`."""
        count = self.period if periods is None else periods
        # what is given counts more than the orbit's own
        options = dict(steps_per_period=int(self.steps_per_period), solver=self.solver) | options
        return simulate(self.scene, count, start=self.state, **options)

    def to_xarray(self) -> Any:
        """Return the dataset of `trajectory`, with `multiplier_real` and `multiplier_imag` [1], and the
        attributes orbit_period [forcing periods], stable, residual and signature."""
        mu = np.asarray(self.multipliers)
        words = {"units": "1", "long_name": "Floquet multiplier"}
        parts = {"multiplier_real": ("multiplier", mu.real, words), "multiplier_imag": ("multiplier", mu.imag, words)}
        ds = self.trajectory().to_xarray().assign(parts)
        return ds.assign_attrs(
            orbit_period=self.period,
            stable=int(self.stable),
            residual=float(self.residual),
            iterations=int(self.iterations),
            signature=" ".join(self.signature.points),
        )

    @property
    def signature(self) -> Signature:
        """Touchdowns of the points in their order, with their rates; not for use under a transformation."""
        records = RecordSet((GapSamples(),))
        steps = int(self.steps_per_period)
        # with samples inside the periods
        map_ = PeriodMap(self.scene, dynamic_steps(steps, most=steps), self.solver)
        ((gap, rate),) = run_eagerly(map_, self.state, self.period, records).samples
        return signature(self.scene, Gaps.of(gap, rate, steps, float(self.scene.period)))


def periodic_orbit(
    scene: Scene,
    period: int = 1,
    *,
    start: Motion | State | Trajectory | None = None,
    transient: int | None = None,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    tolerance: float = TOLERANCE,
    max_iterations: int = 30,
) -> PeriodicOrbit:
    """Find a periodic motion of one scene, stable or not, by Newton's method with derivatives through touchdowns.

    The set of closed contacts may change between iterations: which points touch, and when, need not be given.
    The state has the exact motion's derivatives with respect to all numbers of the scene, in both modes.

    **Arguments:**

    - `period`: forcing periods after which the motion recurs. Where it recurs after a divisor of it, the orbit's
        `period` is that.
    - `start`: near the orbit, as for `simulate`; default Table 2's. `transient`: forcing periods simulated from there
        before Newton's method, by default 60 after a start that is a motion, 240 more where these do not do, and
        none after a state, so that unstable orbits are found from their neighbours.
    - `steps_per_period`, `solver`: as for `simulate`, steps being constant.
    - `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of Newton's method.

    **Returns:** a `PeriodicOrbit`. Its `status` is `Status.NO_ORBIT` where the iterations ended elsewhere, and that
    of the motion where it left the finite numbers or the rail, or never touched it.

    **Raises:** `ValueError` that names the argument which is wrong, also for a track of several wavelengths that does
    not recur with the first.
    """
    check_scene(scene)
    period = whole("period", period, 1, MOST_PERIOD)
    limit = whole("max_iterations", max_iterations, 1)
    tolerance = number(positive, "tolerance", tolerance)
    check_forcing(scene)
    steps = default_steps(scene, steps_per_period)
    solver = resolve_solver(scene, solver)
    begin = first_of(start)
    traced = is_traced((scene, begin))
    if transient is not None:
        tries = [whole("transient", transient, 0)]
        refuse_periods(transient, steps)
    elif isinstance(begin, State):
        tries = [0]
    else:
        tries = [60] if traced else [60, 240]
    # differentiated in both modes, or by one program for all numbers of steps
    stepping = ConstantSteps(steps) if traced else dynamic_steps(steps)
    step, state = PeriodMap(scene, stepping, solver), initial_state(scene, begin)
    options: dict[str, Any] = dict(intervals=period, tolerance=tolerance, max_iterations=limit)
    options |= dict(scale=tangent_weights(scene), consistent=consistent_state)
    # one more transient where Newton's method finds no orbit after the first
    for count in tries:
        state = _simulated(step, state, count, traced)
        if not traced and int(_status(state, jnp.zeros(()), tolerance)) == Status.NOT_FINITE:
            # a motion that is lost has no Jacobians
            size = sum(np.size(leaf) for leaf in jax.tree.leaves(state))
            nothing = jnp.full((period, size, size), jnp.nan)
            shot = Shot(state, nothing[0, 0, 0], jnp.asarray(0), nothing)
            break
        shot = shoot(step, state, **options)
        if traced or float(shot.residual) <= tolerance:
            break
    if not traced and period > 1 and float(shot.residual) <= tolerance:
        # the motion may recur after a divisor of the period already
        residuals = minimal_period(step, shot.state, period, scale=options["scale"])
        period = min((n for n, residual in residuals.items() if float(residual) < DIVISOR), default=period)
    # those of the least period
    matrices = shot.matrices[:period]
    mu = multipliers(matrices if traced else np.asarray(matrices))
    code = _status(shot.state, shot.residual, tolerance)
    in_flight = not traced and not np.any(np.abs(np.abs(mu[: len(MOTION_NUMBERS)]) - 1) > 1e-6)
    if in_flight and np.isfinite(state.motion.y):
        # all multipliers are one in free flight, where Newton's method gets lost, or stays: did it touch the rail?
        moved = simulate(scene, period, start=state, steps_per_period=int(steps), solver=solver).status
        if moved != Status.FINITE:
            code = moved
        elif code == Status.NOT_FINITE:
            code = jnp.asarray(int(Status.NO_ORBIT))
    return PeriodicOrbit(
        scene, shot.state, jnp.asarray(mu), shot.residual, shot.iterations, code, period, steps, solver
    )


@jit
def _status(state: State, residual: Array, tolerance) -> Array:
    """Judge a state with the residual of its recurrence, as one program."""
    code = status_of(state)
    return jnp.where(
        (code == int(Status.FINITE)) & ~(residual <= tolerance),
        int(Status.NO_ORBIT),
        code,
    )


def _simulated(step: PeriodMap, state: State, periods: int, traced: bool) -> State:
    """Return the state some forcing periods later, without derivatives."""
    if not periods:
        return state
    step, state = without_derivatives((step, state))
    return step.run(state, periods=periods).state if traced else run_eagerly(step, state, periods, RecordSet()).state
