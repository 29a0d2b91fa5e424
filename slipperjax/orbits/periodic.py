"""Periodic motions of one slipper, exact to rounding, with their multipliers and contact signatures."""

import json
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from ..analysis.floquet import circle_error, multipliers
from ..analysis.newton import without_derivatives
from ..analysis.shooting import Shot, minimal_period, shoot
from ..flow.period_map import PeriodMap, tangent_weights
from ..flow.record import RecordSet
from ..flow.status import Status, is_lost, judge_states
from ..model.dynamics import State
from ..model.kinematics import Motion, body_numbers
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene, check_scene
from ..model.starts import initial_state
from ..results.result import AbstractResult
from ..solvers.named import resolve_solver
from ..tools.checks import number, positive, shown_number, whole
from ..tools.compile import jit
from ..tools.tracing import is_traced
from ..tools.types import Whole
from .motions import check_forcing, consistent_state
from .signature import Gaps, GapSamples, Signature, signature
from .simulate import (
    Trajectory,
    default_steps,
    dynamic_steps,
    first_of,
    refuse_periods,
    run_eagerly,
    simulate,
    steps_of_call,
)

TOLERANCE = 1e-10
"""Default scaled residual at which an orbit counts as found [1]: 1e-13 m, 1e-10 m/s."""
MOST_PERIOD = 10_000
"""Longest allowed period of an orbit [forcing periods]."""
DIVISOR = 1e-6
"""Scaled residual below which a motion counts as recurring after a divisor of its period [1]."""


class PeriodicOrbit(eqx.Module, AbstractResult):
    """A motion that recurs after `period` forcing periods."""

    scene: Scene
    state: State
    """State at the start of a forcing period."""
    multipliers: Complex[Array, " size"]
    """Floquet multipliers over the orbit's period [1], the largest modulus first."""
    residual: Float[Array, ""]
    """Greatest change of the state over the period, in multiples of `slipperjax.model.MOTION_SCALES` [1]."""
    iterations: Int[Array, ""]
    """Iterations of Newton's method."""
    status: Whole
    """0 for an orbit, otherwise a code of `slipperjax.Status`."""
    period: int = eqx.field(static=True)
    """Forcing periods after which the motion recurs [1]: the least number, unless the scene was traced."""
    steps_per_period: Whole
    solver: diffrax.AbstractSolver = eqx.field(static=True)

    def __repr__(self) -> str:
        if is_traced(self.state) or np.ndim(self.residual):
            return f"PeriodicOrbit(period={self.period}, residual={shown_number(self.residual)})"
        status = Status(int(self.status))
        text = f"PeriodicOrbit(period {self.period} at {shown_number(self.scene.speed)} m/s"
        if is_lost(status):
            return f"{text}, status {int(status)}: {status})"
        # the three largest
        leading = ", ".join(f"{m:.5g}" for m in np.asarray(self.multipliers)[:3])
        return (
            f"{text}, status {int(status)}: {status}, {'stable' if self.stable else 'unstable'},\n"
            f"  multipliers {leading}, ..., residual {shown_number(self.residual)}, "
            f"{shown_number(self.iterations)} iterations)"
        )

    @property
    def stable(self) -> bool | Array:
        """Whether no multiplier is outside the unit circle by more than its error."""
        inside = abs(self.multipliers[..., 0]) <= 1 + circle_error(self.multipliers)
        return inside if is_traced(inside) else bool(np.all(inside))

    @property
    def exponent(self) -> Array:
        """Largest Lyapunov exponent [1/period], ln |largest multiplier| per forcing period."""
        return jnp.log(jnp.abs(self.multipliers[..., 0])) / self.period

    def trajectory(self, periods: int | None = None, **options: object) -> Trajectory:
        """Simulate the orbit, by default over its period; `options`: of `slipperjax.simulate`."""
        count = self.period if periods is None else periods
        # the caller's options replace the orbit's own
        options = dict(steps_per_period=int(self.steps_per_period), solver=self.solver) | options
        return simulate(self.scene, count, start=self.state, **options)

    @property
    def ds(self) -> Any:
        """The dataset of `trajectory`, with `multiplier_real` and `multiplier_imag` [1], and the
        attributes orbit_period [forcing periods], stable, residual, iterations and signature."""
        mu = np.asarray(self.multipliers)
        words = {"units": "1", "long_name": "Floquet multiplier"}
        parts = {"multiplier_real": ("multiplier", mu.real, words), "multiplier_imag": ("multiplier", mu.imag, words)}
        ds = self.trajectory().ds.assign(parts)
        call = {"function": "periodic_orbit", "period": self.period}
        return ds.assign_attrs(
            call=json.dumps(call),
            orbit_period=self.period,
            stable=int(self.stable),
            residual=float(self.residual),
            iterations=int(self.iterations),
            signature=" ".join(self.signature.points),
        )

    @property
    def signature(self) -> Signature:
        """Touchdowns of the contact points in their order, with their rates; not for use under a transformation."""
        records = RecordSet((GapSamples(),))
        steps = int(self.steps_per_period)
        # the most steps are fixed, for arrays of samples inside the periods
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

    It need not be known which points touch, and when: this may change between iterations. The state has the
    derivatives of the exact motion with respect to all numbers of the scene, in forward and reverse mode.

    **Arguments:**

    - `period`: forcing periods after which the motion recurs. If the motion already recurs after a divisor of this
        number, the divisor is the orbit's `period`.
    - `start`: near the orbit, as for `simulate`; default Table 2's. `transient`: forcing periods simulated from the
        start before Newton's method. By default, for a start that is a motion, 60, and 240 more if no orbit is found;
        for a state none, so that unstable orbits are found from their neighbours.
    - `steps_per_period`, `solver`: as for `simulate`, with constant steps.
    - `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of Newton's method.

    **Returns:** a `PeriodicOrbit`. Its `status` is `Status.NO_ORBIT` where the iterations did not converge; where the
    motion is not finite, derailed or never touched the rail, `status` is the status of the motion.

    **Raises:** `ValueError` that names the wrong argument, also for a track of several wavelengths that does
    not recur with the first.
    """
    scene = check_scene(scene)
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
    step = PeriodMap(scene, steps_of_call(steps, scene, begin), solver)
    state = initial_state(scene, begin)
    scale = tangent_weights(scene)
    options = dict(scale=scale, consistent=consistent_state, tolerance=tolerance, max_iterations=limit)
    # a further transient only if Newton's method finds no orbit after the first transient
    for count in tries:
        if count:
            # the transient, without derivatives
            fixed, state = without_derivatives((step, state))
            later = fixed.run(state, periods=count) if traced else run_eagerly(fixed, state, count, RecordSet())
            state = later.state
        # a residual of zero leaves the status of the motion itself
        if not traced and int(_status(state, jnp.zeros(()), tolerance)) == Status.NOT_FINITE:
            # a motion that is not finite has no Jacobians
            size = sum(np.size(leaf) for leaf in jax.tree.leaves(state))
            nothing = jnp.full((period, size, size), jnp.nan)
            shot = Shot(state, nothing[0, 0, 0], jnp.asarray(0), nothing)
            break
        shot = shoot(step, state, intervals=period, **options)
        # a traced residual cannot be compared, so the first result is the last
        if traced or float(shot.residual) <= tolerance:
            break
    if not traced and period > 1 and float(shot.residual) <= tolerance:
        # the motion may already recur after a divisor of the period
        residuals = minimal_period(step, shot.state, period, scale=scale)
        period = min((n for n, residual in residuals.items() if float(residual) < DIVISOR), default=period)
    # Jacobians over the least period
    matrices = shot.matrices[:period]
    mu = multipliers(matrices if traced else np.asarray(matrices))
    code = _status(shot.state, shot.residual, tolerance)
    # without the smallest multipliers, which belong to the contacts' memory
    in_flight = not traced and not np.any(np.abs(np.abs(mu[: len(MOTION_NUMBERS)]) - 1) > 1e-6)
    if in_flight and np.all(np.isfinite(body_numbers(state.motion))):
        # In free flight all multipliers have modulus one, and the result of Newton's method is arbitrary. Therefore
        # check whether the motion touched the rail.
        moved = simulate(scene, period, start=state, steps_per_period=steps, solver=solver).status
        if moved != Status.FINITE:
            code = moved
        elif code == Status.NOT_FINITE:
            code = jnp.asarray(int(Status.NO_ORBIT))
    return PeriodicOrbit(
        scene, shot.state, jnp.asarray(mu), shot.residual, shot.iterations, code, period, steps, solver
    )


@jit
def _status(state: State, residual: Array, tolerance) -> Array:
    """Return the `Status` of a state with the residual of its recurrence, as one program."""
    code = judge_states(state)
    return jnp.where(
        (code == int(Status.FINITE)) & ~(residual <= tolerance),
        int(Status.NO_ORBIT),
        code,
    )
