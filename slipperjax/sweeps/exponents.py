"""Lyapunov spectra of slippers: of one scene, or of a whole grid as one batch with a certificate for each case.

The tangent carries how the place and the instant of each touchdown depend on the state, because the latch is
interpolated and differentiable; so the contact's memory has its saltation, and periodic motions get the exponents
of their Floquet multipliers.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .analysis.attractor import classify
from .analysis.lyapunov import LyapunovSpectrum, first_tangents, map_spectrum, push_tangents
from .analysis.statistics import kaplan_yorke, standard_error, weighted_mean
from .batch import Grid, Workers, case_scene, start_states
from .branches import SCALES
from .checks import whole
from .compilation import jit
from .dynamics import SmoothField, State, initial_state, vector_field
from .kinematics import Motion, table_2_start
from .labels import scene_attributes
from .scene import Scene, default_steps_per_period
from .simulate import check_solver, check_start, integrate
from .solvers import calls_lapack
from .sweep import PAUSE, Plan, run_blocks

MOTION_WEIGHTS = Motion(*(1 / SCALES))
"""Weights of the motion in a tangent's norm: 1 mm, 10 mrad (of the quaternion), 1 m/s and 10 rad/s count as one."""


def _latched_weights(state: State) -> State:
    if state.memory is None:
        return State(MOTION_WEIGHTS, None)
    closed = state.memory < -1e-9
    return State(MOTION_WEIGHTS, jnp.where(closed, -1 / jnp.where(closed, state.memory, -1.0), 0.0))


def _smooth_weights(state: State) -> State:
    return State(MOTION_WEIGHTS, jnp.ones(()))


def tangent_weights(scene: Scene) -> Callable[[State], State]:
    """Gives the weights of a tangent's components at a state: the motion in `MOTION_WEIGHTS`; of `EventLatch`, closed
    contacts' memory in shares of itself and open ones' not at all; of `SmoothSwitch`, 1 m/s of memory as one.
    """
    return _smooth_weights if isinstance(vector_field(scene), SmoothField) else _latched_weights


class Periods(eqx.Module):
    """The map over some whole forcing periods, as `slipperjax.analysis.lyapunov` wants it."""

    scene: Scene
    steps: Any
    """Integration steps per period; an array, so that one compiled program serves all."""
    solver: diffrax.AbstractSolver = eqx.field(static=True)
    count: int = eqx.field(static=True, default=1)
    """Periods in one application."""

    def __call__(self, state: State, k: Any) -> State:
        return integrate(
            self.scene,
            state,
            solver=self.solver,
            steps=self.steps,
            periods=self.count,
            record=None,
            adjoint=diffrax.ForwardMode(),
            epoch=k * self.count,
        )[0]


def lyapunov_spectrum(
    scene: Scene,
    count: int = 1,
    *,
    transient: int = 200,
    periods: int = 500,
    align: int = 20,
    orthonormalise_every: int = 1,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | None = None,
    start: Motion | None = None,
    until_stderr: float | None = None,
    max_periods: int | None = None,
) -> LyapunovSpectrum:
    """Lyapunov exponents of one scene by Benettin's method (doi:10.1007/BF02128236), with exact tangents.

    **Arguments:**

    - `count`: number of exponents, the largest first; one costs one tangent.
    - `transient`: forcing periods before anything is counted; `align`: those after it in which the tangents turn
        into their directions; `periods`: those that count, or with `until_stderr` the number in a block.
    - `orthonormalise_every`: forcing periods between orthonormalisations.
    - `steps_per_period`, `solver`, `start`: as for `simulate`.
    - `until_stderr`: goes on until the largest exponent's standard error [1/period] is no more than this, or until
        `max_periods` were counted.

    **Returns:** a `LyapunovSpectrum`: `.per_period`, `.per_second`, `.stderr`, `.history`, `.kaplan_yorke`. To go on
    from it, `slipperjax.analysis.lyapunov.extend_spectrum` with the step `Periods(scene, ...)`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    every = whole("orthonormalise_every", orthonormalise_every, 1)
    steps = default_steps_per_period(scene) if steps_per_period is None else steps_per_period
    steps = whole("steps_per_period", steps, 1)
    start = table_2_start() if start is None else check_start(start)
    blocks = lambda name, value, least: -(-whole(name, value, least) // every)
    return map_spectrum(
        Periods(scene, jnp.asarray(float(steps)), check_solver(scene, solver), every),
        initial_state(scene, start),
        blocks("periods", periods, 1),
        count=count,
        transient=blocks("transient", transient, 0),
        align=blocks("align", align, 0),
        scale=tangent_weights(scene),
        periods=float(every),
        period=scene.period,
        until_stderr=until_stderr,
        max_intervals=None if max_periods is None else blocks("max_periods", max_periods, 1),
    )


def lyapunov_sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    count: int = 1,
    product: bool = True,
    transient: int = 300,
    periods: int = 500,
    certify: bool = True,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | None = None,
    start: Motion | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Lyapunov exponents for every case of a grid, as one batch, each with its certificate.

    **Arguments:** `count`, `periods`: as for `lyapunov_spectrum`; `certify`: whether each case is checked, which
    costs about twice as much again; others as for `sweep`. Periods are rounded up to whole blocks of `BLOCK`.

    **Returns:** an `xarray.Dataset` over the grid with

    - `exponent` and `stderr` [1/period], with dimension `count`; `weighted`: the same by a smoothly weighted mean,
      sharper for regular motions (see `statistics.weighted_mean`); `kaplan_yorke` where count > 1; `kind` and
      `period`: what the motion settled to by recurrence, see `attractor.classify`;
    - with `certify`: `half_step`, the largest exponent with steps half as long, and its standard error
      `half_step_stderr`; `two_trajectories`, an estimate without tangents, and `two_trajectories_stderr`;
      `floquet`, ln |largest multiplier| per period, of periodic motions; `resolved`: whether all that applies agrees.

    A case is `resolved` where the two other estimates lie within three standard errors of their difference or 1e-3,
    and where the weighted exponent of a periodic motion is that of its multiplier within 1e-3.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    cases = Grid(scene, grid, product=product)
    steps = cases.most_steps(scene) if steps_per_period is None else whole("steps_per_period", steps_per_period, 1)
    solver = check_solver(scene, solver)
    start = table_2_start() if start is None else check_start(start)
    count = whole("count", count, 1)
    settling = -(-whole("transient", transient, BLOCK) // PAUSE)
    counted = -(-whole("periods", periods, 1) // BLOCK)
    team = Workers(cases.lanes, chunk, workers, alone=calls_lapack(solver))
    plan = Plan(solver, steps, 1, PAUSE, PAUSE, 0, settling, "strobe")

    def work(values, tick):
        states, codes, (strobe,) = run_blocks(scene, plan, values, start_states(scene, values, start), tick)
        measure = functools.partial(_measure, scene, values, states, plan.total, solver, counted, tick)
        found = [codes, strobe, measure(steps, count, None)]
        if certify:
            found += [measure(2 * steps, 1, None), measure(steps, 1, jnp.asarray(1e-7))]
            jacobians = _jacobians(scene, values, states, float(plan.total), float(steps), solver)
            found.append(np.asarray(jacobians))
        return found

    measured = BLOCK * (counted + 1) * (3 if certify else 1)
    found = team.run(work, cases.values, periods=plan.total + measured, progress=progress)
    attrs = scene_attributes(scene) | {"steps_per_period": steps, "transient": plan.total, "periods": counted * BLOCK}
    return _dataset(cases, found, attrs)


BLOCK = 20
"""Forcing periods in one call; the first such block turns the tangents into their directions and is not counted."""
LONGEST = 16
"""Longest period of a motion whose Floquet multipliers are computed."""
AGREE = 1e-3
"""Differences between exponents [1/period] that are put up with whatever the standard errors."""


def _measure(scene, values, states, epoch, solver, blocks, tick, steps, count, distance):
    """Local exponents (cases, periods, count) of a chunk from `states` on."""
    tangents = _first(scene, states, count)
    rows = []
    for k in range(blocks + 1):
        at = float(epoch + k * BLOCK)
        states, tangents, history = _push(scene, values, states, tangents, at, float(steps), distance, solver)
        rows.append(np.asarray(history))
        tick(BLOCK)
    return np.concatenate(rows[1:], axis=1)


@functools.partial(jit, static_argnums=2)
def _first(scene, states, count):
    return jax.vmap(lambda s: first_tangents(s, count, tangent_weights(scene)))(states)


@functools.partial(jit, static_argnums=7)
def _push(scene, values, states, tangents, epoch, steps, distance, solver):
    def one(v, state, tangents):
        step = Periods(case_scene(scene, v), steps, solver)
        options = dict(index=epoch, scale=tangent_weights(scene), distance=distance)
        return push_tangents(step, state, tangents, BLOCK, **options)

    return jax.vmap(one)(values, states, tangents)


@functools.partial(jit, static_argnums=5)
def _jacobians(scene, values, states, epoch, steps, solver) -> Float[Array, "cases periods size size"]:
    """Jacobians of `LONGEST` successive period maps."""

    def one(v, state):
        step = Periods(case_scene(scene, v), steps, solver)
        unravel = ravel_pytree(state)[1]

        def period(x, k):
            flow = lambda x: ravel_pytree(step(unravel(x), k))[0]
            x, columns = jax.vmap(lambda t: jax.jvp(flow, (x,), (t,)), out_axes=(None, 1))(jnp.eye(x.size))
            return x, columns

        return jax.lax.scan(period, ravel_pytree(state)[0], epoch + jnp.arange(float(LONGEST)))[1]

    return jax.vmap(one)(values, states)


def largest_multiplier(jacobians: Any, period: int) -> float:
    """ln |largest Floquet multiplier| per forcing period of a motion of `period` periods, from its Jacobians."""
    product = functools.reduce(lambda total, j: j @ total, np.asarray(jacobians)[:period])
    return float(np.log(np.max(np.abs(np.linalg.eigvals(product)))) / period)


def _dataset(cases, found, attrs) -> xr.Dataset:
    codes, strobe, history, *checks = found
    settled = classify(strobe[:, -200:], scales=SCALES)
    exponent, error, weighted = history.mean(axis=1), standard_error(history), weighted_mean(history)
    flat: dict[str, Any] = {
        "exponent": (exponent, "1/period", "Lyapunov exponents"),
        "stderr": (error, "1/period", "standard error of the exponents"),
        "weighted": (weighted, "1/period", "Lyapunov exponents by a smoothly weighted mean"),
        "kind": (settled.kind, "", "what the motion settled to, by recurrence"),
        "period": (settled.period, "1", "forcing periods of a periodic motion, 0 for others"),
        "status": (codes, "", "0 where all is well"),
    }
    if exponent.shape[1] > 1:
        flat["kaplan_yorke"] = (kaplan_yorke(exponent), "1", "Kaplan-Yorke dimension")
    if checks:
        half, pair, jacobians = checks
        periodic = (settled.period > 0) & (codes == 0)
        floquet = np.array(
            [
                largest_multiplier(j, n) if p else np.nan
                for j, n, p in zip(jacobians, settled.period, periodic, strict=True)
            ]
        )
        others = {"half_step": ("with half the step", half), "two_trajectories": ("from two trajectories", pair)}
        agree = codes == 0
        for name, (text, rows) in others.items():
            value, its_error = rows.mean(axis=1)[:, 0], standard_error(rows)[:, 0]
            flat[name] = (value, "1/period", f"largest exponent {text}")
            flat[f"{name}_stderr"] = (its_error, "1/period", f"standard error of the largest exponent {text}")
            bound = np.maximum(3 * np.hypot(error[:, 0], its_error), AGREE)
            agree &= np.abs(value - exponent[:, 0]) <= bound
        agree &= ~periodic | (np.abs(floquet - weighted[:, 0]) <= AGREE)
        flat["floquet"] = (floquet, "1/period", "ln of the largest Floquet multiplier's modulus")
        flat["resolved"] = (agree, "", "whether the other estimates agree")
    ds = xr.Dataset(coords=cases.coordinates())
    for name, (values, unit, text) in flat.items():
        dims = (*cases.dims, "count") if values.ndim > 1 else cases.dims
        shape = cases.shape + values.shape[1:]
        ds[name] = (dims, values.reshape(shape), {"units": unit, "long_name": text} if unit else {"long_name": text})
    return ds.assign_attrs({k: v for k, v in attrs.items() if k.split(" [")[0] not in cases.axes})
