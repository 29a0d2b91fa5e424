"""Periodic orbits of every case of a grid."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
import xarray as xr

from ..flow import Trajectory, coordinates, first_of, initial_states
from ..model import COORDINATES, Motion, Scene, State
from ..orbits import TOLERANCE, check_forcing
from ..tools import number, positive, whole
from .cases import Cases
from .executors import records_in_order, run_chunk, run_chunks
from .maps import rows_of
from .measure import JACOBIAN
from .plan import PAUSE, make_plan, strobe_plan
from .search import find_orbits
from .stores import Store, storable
from .sweep import case_attributes, case_variables

TYPICAL = 8
"""Iterations of Newton's method that a case takes, about."""


class _Found(NamedTuple):
    """Orbits of a chunk."""

    status: np.ndarray
    strobe: np.ndarray
    """States at the start of a period, in the order of `COORDINATES`."""
    state: np.ndarray
    multiplier_real: np.ndarray
    multiplier_imag: np.ndarray
    residual: np.ndarray
    iterations: np.ndarray


@storable
def orbit_sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    period: int = 1,
    product: bool = True,
    transient: int = 60,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
    store: Store | str | Path | None = None,
    executor: Any = None,
) -> xr.Dataset:
    """A periodic orbit for every case of a grid, with its Floquet multipliers, by Newton's method after a transient.

    **Arguments:** `period`: forcing periods after which the orbits recur; `transient`: forcing periods simulated
    before, `PAUSE` at least; `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of each case;
    others as for `sweep`.

    **Returns:** an `xarray.Dataset` over the grid with `strobe`, the state at the start of a forcing period in the
    order of `slipperjax.model.COORDINATES`, and `state`, all its numbers; `multiplier_real` and `multiplier_imag`
    [1] over `period` forcing periods; `exponent` [1/period], ln |largest multiplier| per forcing period; `stable`;
    `residual` [1], `iterations`; `status`, which is `Status.NO_ORBIT` where the iterations ended elsewhere.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C.
    """
    check_forcing(scene)
    start = first_of(start)
    cases = Cases(scene, grid, start, product=product)
    period, limit = whole("period", period, 1), whole("max_iterations", max_iterations, 1)
    tolerance = number(positive, "tolerance", tolerance)
    options: dict[str, Any] = dict(steps_per_period=steps_per_period, solver=solver)
    plan = make_plan(scene, cases, record="strobe", transient=0, periods=1, **options)
    plan = strobe_plan(plan, whole("transient", transient, PAUSE))
    chunks, workers = plan.chunks(chunk, workers, tangents=True)

    def work(chunk, on_progress):
        scenes, starts = cases.take(chunk.index)
        passed = run_chunk(plan, scenes, initial_states(scenes, starts), chunk.steps, on_progress)
        some = np.arange(chunk.cases)
        of_cases = scenes.take(some), jax.tree.map(lambda a: np.asarray(a)[some], passed.state)
        how: dict[str, Any] = dict(solver=plan.solver, period=period, tolerance=tolerance, max_iterations=limit)
        found = find_orbits(*of_cases, chunk.steps, on_progress=on_progress, **how)
        mu = found.multipliers
        states = coordinates(found.state), rows_of(found.state)
        return _Found(found.status, *states, mu.real, mu.imag, found.residual, found.iterations)

    work_of_case = plan.work + period * (2 * JACOBIAN + TYPICAL)
    runs = run_chunks(chunks, workers, work, periods=work_of_case, progress=progress, name="orbits")
    found = records_in_order(chunks, runs.results)
    call = dict(function="orbit_sweep", product=product, period=period, transient=transient)
    call |= dict(tolerance=tolerance, max_iterations=limit)
    attrs = case_attributes(plan, cases, call) | {"transient": plan.periods, "orbit_period": period}
    return runs.checked(_dataset(cases, found, plan.steps, attrs))


def _dataset(cases: Cases, found: _Found, steps: np.ndarray, attrs: Mapping[str, Any]) -> xr.Dataset:
    largest = np.hypot(found.multiplier_real, found.multiplier_imag)[:, 0]
    with np.errstate(divide="ignore"):
        exponent = np.log(largest) / attrs["orbit_period"]
    text = "; ".join(f"{name} [{q.unit}]" for name, q in COORDINATES.items())
    # values, dimensions besides the grid's, unit, description
    flat: dict[str, tuple[np.ndarray, tuple[str, ...], str, str]] = {
        "strobe": (found.strobe, ("coordinate",), "", f"state at the start of a forcing period: {text}"),
        "state": (found.state, ("number",), "", "all numbers of the state, as in slipperjax.State"),
        "multiplier_real": (found.multiplier_real, ("multiplier",), "1", "Floquet multipliers, real parts"),
        "multiplier_imag": (found.multiplier_imag, ("multiplier",), "1", "Floquet multipliers, imaginary parts"),
        "exponent": (exponent, (), "1/period", "ln of the largest multiplier's modulus, per forcing period"),
        "stable": (largest < 1, (), "", "whether all multipliers lie inside the unit circle"),
        "residual": (found.residual, (), "1", "scaled residual"),
        "iterations": (found.iterations, (), "1", "iterations of Newton's method"),
    }
    ds = xr.Dataset(coords={**cases.coordinates(), "coordinate": list(COORDINATES)}, attrs=attrs)
    for name, (values, more, unit, words) in flat.items():
        label = {"units": unit, "long_name": words} if unit else {"long_name": words}
        ds[name] = ((*cases.dims, *more), values.reshape(cases.shape + values.shape[1:]), label)
    return ds.assign(case_variables(cases.dims, found.status.reshape(cases.shape), steps.reshape(cases.shape)))
