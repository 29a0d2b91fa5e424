"""Periodic motions of one slipper as exact objects, with their multipliers and contact signatures."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..analysis import minimal_period, multipliers, shoot
from ..flow import (
    ConstantSteps,
    PeriodMap,
    Status,
    Strobe,
    Trajectory,
    default_steps,
    first_of,
    room_for,
    run_compiled,
    simulate,
    status_of,
    steps_of_program,
    tangent_weights,
)
from ..model import EventLatch, Motion, Scene, State, check_scene, contacts, initial_state, rail_frame
from ..solvers import resolve_solver
from ..tools import is_traced, number, positive, shown_number, whole
from .signature import Gaps, Signature, signature

TOLERANCE = 1e-10
"""Default scaled residual at which an orbit counts as found [1]: 1e-13 m, 1e-10 m/s."""
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
    """What the state misses after the period, in multiples of `slipperjax.model.MOTION_SCALES` [1]."""
    iterations: Any
    """Newton iterations taken."""
    status: Any
    """0 where nothing is wrong, else see `slipperjax.flow.Status`."""
    period: int = eqx.field(static=True)
    """Forcing periods after which the motion recurs [1]: the least, unless the scene was traced."""
    steps_per_period: Any
    solver: diffrax.AbstractSolver = eqx.field(static=True)

    def __repr__(self) -> str:
        if is_traced(self.state) or np.ndim(self.residual):
            return f"PeriodicOrbit(period={self.period}, residual={shown_number(self.residual)})"
        status = Status(int(self.status))
        leading = ", ".join(f"{m:.5g}" for m in np.asarray(self.multipliers)[:3])
        return (
            f"PeriodicOrbit(period {self.period} at {shown_number(self.scene.speed)} m/s, "
            f"{'stable' if self.stable else 'unstable'},\n  multipliers {leading}, ..., residual "
            f"{shown_number(self.residual)}, {shown_number(self.iterations)} iterations,\n"
            f"  status {int(status)}: {status})"
        )

    @property
    def stable(self) -> Any:
        """Whether all multipliers lie inside the unit circle."""
        inside = abs(self.multipliers[..., 0]) < 1
        return inside if is_traced(inside) else bool(np.all(inside))

    @property
    def exponent(self) -> Any:
        """The largest Lyapunov exponent [1/period], ln |largest multiplier| per forcing period."""
        return jnp.log(jnp.abs(self.multipliers[..., 0])) / self.period

    def trajectory(self, periods: int | None = None, **options: Any) -> Trajectory:
        """The orbit in time, by default over its period; `options`: of `slipperjax.simulate`."""
        count = self.period if periods is None else periods
        given = dict(steps_per_period=int(self.steps_per_period), solver=self.solver) | options
        return simulate(self.scene, count, start=self.state, **given)

    def to_xarray(self) -> Any:
        """The dataset of `trajectory()`, with `multiplier_real` and `multiplier_imag` [1] along `multiplier`, and
        attributes orbit_period [forcing periods], stable, residual and signature."""
        found = np.asarray(self.multipliers)
        words = {"units": "1", "long_name": "Floquet multiplier"}
        ds = (
            self.trajectory()
            .to_xarray()
            .assign(
                multiplier_real=("multiplier", found.real, words), multiplier_imag=("multiplier", found.imag, words)
            )
        )
        return ds.assign_attrs(
            orbit_period=self.period,
            stable=int(self.stable),
            residual=float(self.residual),
            iterations=int(self.iterations),
            signature=" ".join(self.signature.points),
        )

    @property
    def signature(self) -> Signature:
        """Which points touch down, in which order and how fast; not for use under a transformation."""
        recorder = Gaps()
        map_ = PeriodMap(self.scene, ConstantSteps(int(self.steps_per_period)), self.solver)
        gap, rate = recorder.collect(run_compiled(map_, self.state, self.period, recorder).record)
        return signature(self.scene, gap, rate)


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
    """A periodic motion of one scene, stable or not, by Newton's method with derivatives through every touchdown.

    Which points touch, and when, is found and not given: the set of closed contacts may change between iterations.
    The state has the exact motion's derivatives with respect to all numbers of the scene, in both modes.

    **Arguments:**

    - `period`: forcing periods after which the motion recurs. Where it recurs after a divisor of it, the orbit's
        `period` is that.
    - `start`: near the orbit, as for `simulate`; default Table 2's. `transient`: forcing periods simulated from there
        before Newton's method, by default 60 after a start that is a motion, and none after a state, so that unstable
        orbits are found from their neighbours.
    - `steps_per_period`, `solver`: as for `simulate`, steps being constant.
    - `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of Newton's method.

    **Returns:** a `PeriodicOrbit`. Its `status` is `Status.NO_ORBIT` where the iterations ended elsewhere, and that
    of the motion where it left the finite numbers or the rail.

    **Raises:** `ValueError` that names the argument which is wrong, also for a track of several wavelengths that does
    not recur with the first.
    """
    check_scene(scene)
    period, limit = whole("period", period, 1), whole("max_iterations", max_iterations, 1)
    tolerance = number(positive, "tolerance", tolerance)
    _check_forcing(scene)
    steps, solver = default_steps(scene, steps_per_period), resolve_solver(scene, solver)
    begin = first_of(start)
    passed = (0 if isinstance(begin, State) else 60) if transient is None else whole("transient", transient, 0)
    traced = is_traced((scene, begin))
    stepping = steps_of_program(steps) if traced else ConstantSteps(int(steps))
    state = initial_state(scene, begin)
    if passed:
        still = jax.tree.map(jax.lax.stop_gradient, (scene, state))
        state = (
            PeriodMap(still[0], stepping, solver, passed)(still[1])
            if traced
            else _passed(still[0], stepping, solver, passed, still[1])
        )
    if not traced and int(status_of(state)) == Status.NOT_FINITE:
        size = sum(np.size(leaf) for leaf in jax.tree.leaves(state))
        lost = jnp.full(size, complex(np.nan))
        none = jnp.asarray(np.nan)
        return PeriodicOrbit(
            scene, state, lost, none, jnp.asarray(0), jnp.asarray(int(Status.NOT_FINITE)), period, steps, solver
        )
    step = PeriodMap(scene, stepping, solver)
    options = dict(scale=tangent_weights(scene), settle=_Settled(scene))
    shot = shoot(step, state, intervals=period, tolerance=tolerance, max_iterations=limit, **options)
    if not traced and period > 1:
        missed = minimal_period(step, shot.state, period, scale=tangent_weights(scene))
        period = min((n for n, residual in missed.items() if float(residual) < DIVISOR), default=period)
    matrices = shot.matrices[:period]
    found = multipliers(matrices if traced else np.asarray(matrices))
    code = status_of(shot.state)
    code = jnp.where((code == int(Status.FINITE)) & ~(shot.residual <= tolerance), int(Status.NO_ORBIT), code)
    return PeriodicOrbit(
        scene, shot.state, jnp.asarray(found), shot.residual, shot.iterations, code, period, steps, solver
    )


def _passed(scene: Scene, stepping: Any, solver: Any, periods: int, state: State) -> State:
    """The state some forcing periods on, by a program that serves other numbers of them, too."""
    found = run_compiled(
        PeriodMap(scene, stepping, solver), state, room_for(periods), Strobe(), 0.0, jnp.asarray(float(periods))
    )
    return found.state


def _check_forcing(scene: Scene) -> None:
    waves = getattr(scene.track, "wavelengths", None)
    if waves is None or is_traced(waves) or np.size(waves) < 2:
        return
    ratios = np.asarray(waves)[0] / np.asarray(waves)
    if np.any(np.abs(ratios - np.round(ratios)) > 1e-9):
        raise ValueError(
            f"Argument `scene` must have a track that recurs with its first wavelength, but its wavelengths are "
            f"{shown_number(np.asarray(waves))} m."
        )


class _Settled(eqx.Module):
    """Makes the memory of a proposed state agree with its gaps: zero where open, latched where newly closed."""

    scene: Scene

    def __call__(self, proposed: State, mapped: State) -> State:
        if proposed.memory is None or not isinstance(self.scene.memory, EventLatch):
            return proposed
        assert mapped.memory is not None  # that of the same scene
        now = contacts(rail_frame(self.scene, 0.0), proposed.motion)
        fresh = self.scene.memory.initial(now.gap, now.rate)
        kept = jnp.where(proposed.memory < 0, proposed.memory, jnp.where(mapped.memory < 0, mapped.memory, fresh))
        return State(proposed.motion, jnp.where(now.gap < 0, kept, 0.0))
