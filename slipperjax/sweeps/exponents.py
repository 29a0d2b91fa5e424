"""Lyapunov exponents of a whole grid as one batch, with a certificate for each case."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis import REGIMES, classify, kaplan_yorke, largest_exponent, regime, standard_error, weighted_mean
from ..flow import (
    ConstantSteps,
    Status,
    advance_tangents,
    batch_jacobians,
    check_start,
    first_problem,
    initial_states,
    initial_tangents,
    scene_attributes,
)
from ..model import COORDINATE_SCALES, Motion, Scene, State, table_2_start
from ..orbits import check_count
from ..solvers import solver_name
from ..tools import Batched, whole
from .attractors import FLOOR
from .cases import Cases
from .executors import in_order, run_chunk, run_chunks
from .plan import OnProgress, Plan, make_plan, strobe_plan
from .sweep import case_variables

BLOCK = 20
"""Forcing periods in one call; the first such block turns the tangents into their directions and is not counted."""
LONGEST = 16
"""Longest period of a motion whose Floquet multipliers are computed."""
AGREE = 1e-3
"""Differences between exponents [1/period] that are accepted whatever the standard errors."""


def lyapunov_sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    count: int = 1,
    product: bool = True,
    transient: int = 300,
    periods: int = 500,
    certify: bool = True,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    solver: diffrax.AbstractSolver | None = None,
    start: Motion | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Lyapunov exponents for every case of a grid, as one batch, each with its certificate.

    **Arguments:** `count`, `periods`: as for `lyapunov_spectrum`; `certify`: whether each case is checked, which
    costs about twice as much again; `transient`: `BLOCK` periods at least; others as for `sweep`. Periods are rounded
    up to whole blocks of `BLOCK`, after each of which the status is looked at.

    **Returns:** an `xarray.Dataset` over the grid with

    - `exponent` and `stderr` [1/period], with dimension `count`; `weighted`: the same by a smoothly weighted mean,
      sharper for regular motions (see `slipperjax.analysis.weighted_mean`); `kaplan_yorke` where count > 1; `kind`
      and `period`: what the motion settled to by recurrence, see `slipperjax.analysis.classify`; `regime`: see
      `slipperjax.analysis.regime`; `status` and `steps_per_period`: as `sweep` gives them;
    - with `certify`: `half_step`, the largest exponent with steps half as long, and its standard error
      `half_step_stderr`; `two_trajectories`, an estimate without tangents, and `two_trajectories_stderr`;
      `floquet`, ln |largest multiplier| per period, of periodic motions; `resolved`: whether all that applies agrees.

    A case is `resolved` where its status is 0, the two other estimates lie within three standard errors of their
    difference or 1e-3, and the weighted exponent of a periodic motion is that of its multiplier within 1e-3.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    start = table_2_start() if start is None else check_start(start)
    cases = Cases(scene, grid, start, product=product)
    options: dict[str, Any] = dict(steps_per_period=steps_per_period, solver=solver)
    plan = make_plan(scene, cases, record="strobe", transient=0, periods=1, **options)
    plan = strobe_plan(plan, whole("transient", transient, BLOCK))
    count, counted = check_count(scene, count), -(-whole("periods", periods, 1) // BLOCK)
    chunks, workers = plan.chunks(chunk, workers)

    def work(chunk, on_progress):
        scenes, starts = cases.take(chunk.index)
        settled = run_chunk(plan, scenes, initial_states(scenes, starts), chunk.steps, on_progress)
        measure = _Measure(plan, scenes, settled.state, counted, on_progress)
        plain = measure(chunk.steps, count)
        checks = None
        if certify:
            half, pair = measure(2 * chunk.steps, 1), measure(chunk.steps, 1, 1e-7)
            matrices = measure.jacobians(chunk.steps)
            checks = _Checks(half.history, half.status, pair.history, pair.status, matrices)
        status = first_problem(settled.status, plain.status)
        return _Exponents(status, settled.record.strobe, plain.history, checks)

    measured = BLOCK * (counted + 1) * (3 if certify else 1)
    runs = run_chunks(chunks, workers, work, periods=plan.periods + measured, progress=progress)
    joined = lambda *parts: in_order(chunks, parts)
    checks = [run.checks for run in runs]
    found = _Exponents(
        *(joined(*parts) for parts in zip(*(run[:3] for run in runs), strict=True)),
        checks=_Checks(*(joined(*parts) for parts in zip(*checks, strict=True))) if certify else None,
    )
    attrs = {"transient": plan.periods, "periods": counted * BLOCK, "solver": solver_name(plan.solver)}
    return _dataset(cases, plan, found, scene_attributes(scene, without=cases.axes) | attrs)


class _Checks(NamedTuple):
    """What certifies the cases of a chunk."""

    half_step: Float[np.ndarray, "cases periods 1"]
    half_step_status: Int[np.ndarray, " cases"]
    two_trajectories: Float[np.ndarray, "cases periods 1"]
    two_trajectories_status: Int[np.ndarray, " cases"]
    jacobians: Float[np.ndarray, "cases periods size size"]


class _Exponents(NamedTuple):
    """What was found of the cases of a chunk."""

    status: Int[np.ndarray, " cases"]
    strobe: Float[np.ndarray, "cases periods 10"]
    history: Float[np.ndarray, "cases periods count"]
    checks: _Checks | None


class _Local(NamedTuple):
    """Local exponents of a chunk."""

    history: Float[np.ndarray, "cases periods count"]
    status: Int[np.ndarray, " cases"]


class _Measure(NamedTuple):
    """Measures exponents of a chunk from the states to which it settled."""

    plan: Plan
    scenes: Batched[Scene]
    states: State
    blocks: int
    on_progress: OnProgress

    def __call__(self, steps: int, count: int, distance: float | None = None) -> _Local:
        """Local exponents with `steps` per period; by differences to neighbours at `distance` if that is given."""
        states, tangents = self.states, initial_tangents(self.scenes, self.states, count)
        away = None if distance is None else jnp.asarray(distance)
        rows, status = [], np.zeros(len(states.motion.y), int)
        for k in range(self.blocks + 1):
            at = float(self.plan.periods + k * BLOCK)
            states, tangents, history, codes = advance_tangents(
                self.scenes, states, tangents, at, _constant(steps), away, solver=self.plan.solver, periods=BLOCK
            )
            rows.append(np.asarray(history))
            status = first_problem(status, codes)
            self.on_progress(BLOCK)
        return _Local(np.concatenate(rows[1:], axis=1), status)

    def jacobians(self, steps: int) -> np.ndarray:
        """Jacobians of the first `LONGEST` periods."""
        options: dict[str, Any] = dict(solver=self.plan.solver, periods=LONGEST)
        return np.asarray(
            batch_jacobians(self.scenes, self.states, float(self.plan.periods), _constant(steps), **options)
        )


def _constant(steps: int) -> ConstantSteps:
    """So many steps as an array: one compiled program serves every number."""
    return ConstantSteps(steps=jnp.asarray(float(steps)))


def _dataset(cases: Cases, plan: Plan, found: _Exponents, attrs: dict[str, Any]) -> xr.Dataset:
    good = found.status == Status.FINITE
    strobe = np.where(good[:, None, None], found.strobe[:, -200:], np.nan)
    settled = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
    history = found.history
    exponent, error, weighted = history.mean(axis=1), standard_error(history), weighted_mean(history)
    flat: dict[str, Any] = {
        "exponent": (exponent, "1/period", "Lyapunov exponents"),
        "stderr": (error, "1/period", "standard error of the exponents"),
        "weighted": (weighted, "1/period", "Lyapunov exponents by a smoothly weighted mean"),
        "kind": (settled.kind, "", "what the motion settled to, by recurrence"),
        "period": (settled.period, "1", "forcing periods of a periodic motion, 0 for others"),
    }
    if exponent.shape[1] > 1:
        flat["kaplan_yorke"] = (kaplan_yorke(exponent), "1", "Kaplan-Yorke dimension")
    if found.checks is not None:
        checks = found.checks
        periodic = (settled.period > 0) & good
        floquet = np.full(len(good), np.nan)
        for k in np.flatnonzero(periodic):
            floquet[k] = largest_exponent(checks.jacobians[k], settled.period[k])
        agree = good & (checks.half_step_status == Status.FINITE) & (checks.two_trajectories_status == Status.FINITE)
        others = {
            "half_step": ("with half the step", checks.half_step),
            "two_trajectories": ("from two trajectories", checks.two_trajectories),
        }
        for name, (text, rows) in others.items():
            value, its_error = rows.mean(axis=1)[:, 0], standard_error(rows)[:, 0]
            flat[name] = (value, "1/period", f"largest exponent {text}")
            flat[f"{name}_stderr"] = (its_error, "1/period", f"standard error of the largest exponent {text}")
            bound = np.maximum(3 * np.hypot(error[:, 0], its_error), AGREE)
            agree &= np.abs(value - exponent[:, 0]) <= bound
        agree &= ~periodic | (np.abs(floquet - weighted[:, 0]) <= AGREE)
        flat["floquet"] = (floquet, "1/period", "ln of the largest Floquet multiplier's modulus")
        flat["resolved"] = (agree, "", "whether the other estimates agree")
    trusted = flat["resolved"][0] if "resolved" in flat else good
    names = np.array(REGIMES)[regime(exponent[:, 0], error[:, 0], settled.kind, trusted)]
    flat["regime"] = (names, "", "periodic, regular (neither periodic nor chaotic), chaotic or unresolved")
    ds = xr.Dataset(coords=cases.coordinates(), attrs=attrs)
    for name, (values, unit, text) in flat.items():
        dims = (*cases.dims, "count") if values.ndim > 1 else cases.dims
        label = {"units": unit, "long_name": text} if unit else {"long_name": text}
        ds[name] = (dims, values.reshape(cases.shape + values.shape[1:]), label)
    by_case = case_variables(cases.dims, found.status.reshape(cases.shape), plan.steps.reshape(cases.shape))
    return ds.assign(by_case)
