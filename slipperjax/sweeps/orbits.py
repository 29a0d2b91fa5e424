"""Periodic orbits of many cases at once, by Newton's method with Broyden's updates.

Each iteration integrates one proposal of every case that goes on, whatever it needs: a full step, a halved one, or
one after a new Jacobian. So no case waits for another one's line search, and cases that are done cost nothing.
"""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
import xarray as xr
from jaxtyping import Complex, Float, Int

from ..analysis.floquet import multipliers
from ..flow.period_map import initial_states
from ..flow.simulate import Trajectory, first_of
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import coordinates
from ..model.quantities import COORDINATES
from ..model.scene import Scene
from ..orbits.motions import check_forcing
from ..orbits.periodic import TOLERANCE
from ..tools.batching import Batched
from ..tools.checks import number, positive, whole
from .executors import records_in_order, run_chunk, run_chunks
from .grid import Cases
from .maps import Maps, rows_of
from .plan import PAUSE, OnProgress, make_plan, strobe_plan
from .records import JACOBIAN
from .stores.stored import storable
from .stores.target import Store
from .sweep import case_attributes, case_variables

HALVINGS = 5
"""How often a step is halved before it is taken whatever it gives."""
FALL = 0.1
"""Share of a step by which the residual must fall for the step to be taken."""
SLOW = 0.3
"""Share of the residual that may be left after a step; where more is left, the Jacobian is computed anew."""
MOST_JACOBIANS = 6
"""Jacobians of a case after which it counts as without an orbit."""


class Orbits(NamedTuple):
    """Periodic orbits of many cases, as far as they were found."""

    state: State
    """At the start of a forcing period."""
    residual: Float[np.ndarray, " cases"]
    """Greatest scaled component of what a state misses after the period [1]."""
    iterations: Int[np.ndarray, " cases"]
    jacobians: Int[np.ndarray, " cases"]
    """How many were computed, that of the orbit included."""
    multipliers: Complex[np.ndarray, "cases size"]
    """Over the orbit's period, the largest modulus first [1]; NaN where there is no orbit."""
    growth: Float[np.ndarray, " cases"]
    """Logarithm of the greatest growth of a scaled tangent in one forcing period [1]; NaN without an orbit."""
    inverse: Float[np.ndarray, "cases size size"]
    """Of I - P_x, P_x being the Jacobian over the orbit's period, for its derivatives; NaN without an orbit."""
    status: Int[np.ndarray, " cases"]
    """`Status` codes."""

    @property
    def stable(self) -> np.ndarray:
        """Whether all multipliers lie inside the unit circle."""
        return np.abs(self.multipliers[:, 0]) < 1


def find_orbits(
    scenes: Batched[Scene],
    states: State,
    steps: int,
    *,
    solver: diffrax.AbstractSolver,
    period: int | Int[np.ndarray, " cases"],
    tolerance: float,
    max_iterations: int,
    on_progress: OnProgress,
    inverse: Float[np.ndarray, "cases size size"] | None = None,
) -> Orbits:
    """The orbits near some states of a batch, each by Newton's method; see `Orbits.status` for what became of them.

    **Arguments:** `states`: with a leading axis of cases; `period`: forcing periods after which the orbits recur, of
    all or of each case, 0 for those without a search; `steps`: per forcing period; `inverse`: guesses of
    `Orbits.inverse`, such as neighbours', NaN where there is none.
    """
    x = rows_of(states)
    everyone = np.arange(len(x))
    maps = Maps(scenes, states, steps, solver, np.broadcast_to(period, len(x)), on_progress)
    asked = maps.periods > 0
    miss, size = np.zeros_like(x), np.full(len(x), np.inf)
    first = everyone[asked]
    miss[first] = maps.mapped(first, x[first]) - x[first]
    size[first] = _sizes(miss[first], maps.weights(first, x[first]))
    share, count, jacobians = np.ones(len(x)), np.zeros(len(x), int), np.zeros(len(x), int)
    inverse = np.full((len(x), x.shape[1], x.shape[1]), np.nan) if inverse is None else inverse.copy()
    stale = ~np.all(np.isfinite(inverse), axis=(1, 2))
    while True:
        going = np.isfinite(size) & (size > tolerance) & (count < max_iterations)
        going &= ~(stale & (jacobians >= MOST_JACOBIANS))
        if not going.any():
            break
        fresh = np.flatnonzero(going & stale)
        if len(fresh):
            inverse[fresh] = _inverses(maps.jacobians(fresh, x[fresh]))
            jacobians[fresh] += 1
            stale[fresh], share[fresh] = False, 1.0
        now = np.flatnonzero(going)
        direction = np.einsum("kij,kj->ki", inverse[now], miss[now])
        proposed = maps.settled(now, x[now] + share[now, None] * direction, x[now] + miss[now])
        weights = maps.weights(now, proposed)
        new_miss = maps.mapped(now, proposed) - proposed
        new_size = _sizes(new_miss, weights)
        count[now] += 1
        last = share[now] <= 0.5**HALVINGS
        good = (new_size <= (1 - FALL * share[now]) * size[now]) | (last & np.isfinite(new_size))
        some = now[good]
        moved, fell = proposed[good] - x[some], miss[some] - new_miss[good]
        inverse[some] = _broyden(inverse[some], moved, fell, weights[good])
        stale[some] = new_size[good] > SLOW * size[some]
        x[some], miss[some], size[some], share[some] = proposed[good], new_miss[good], new_size[good], 1.0
        share[now[~good]] /= 2
        count[now[~good & last]] = max_iterations  # every step leaves the finite numbers
    status = maps.statuses(everyone, x)
    status = np.where((status == Status.FINITE) & ~(size <= tolerance), int(Status.NO_ORBIT), status)
    mu, growth = np.full(x.shape, np.nan + 0j), np.full(len(x), np.nan)
    found = np.flatnonzero(status == Status.FINITE)
    if len(found):
        matrices = maps.jacobians(found, x[found])
        jacobians[found] += 1
        mu[found] = [multipliers(of_periods) for of_periods in matrices]
        growth[found] = [_growth(*both) for both in zip(matrices, maps.weights(found, x[found]), strict=True)]
        # one more step by the Jacobian at hand
        inverse[found] = _inverses(matrices)
        x[found] += np.einsum("kij,kj->ki", inverse[found], miss[found])
    inverse[~np.isin(everyone, found)] = np.nan
    return Orbits(maps.states(x), size, count, jacobians, mu, growth, inverse, status)


def _growth(matrices: np.ndarray, weights: np.ndarray) -> float:
    seen = weights > 0
    scaled = (matrices * weights[:, None])[:, seen][:, :, seen] / weights[seen]
    return float(np.log(np.max(np.linalg.norm(scaled, 2, axis=(1, 2)), initial=1e-300)))


def _sizes(miss: np.ndarray, weights: np.ndarray) -> np.ndarray:
    seen = np.max(np.abs(np.where(weights > 0, weights * miss, 0.0)), axis=1)
    return np.where(np.all(np.isfinite(miss), axis=1), seen, np.inf)


def _inverses(matrices: Sequence[np.ndarray]) -> np.ndarray:
    """Inverses of I - P_x, from the Jacobians of each case's successive periods; NaN where they are not finite."""
    whole = np.stack([functools.reduce(lambda total, later: later @ total, of_periods) for of_periods in matrices])
    system = np.eye(whole.shape[-1]) - whole
    finite = np.all(np.isfinite(system), axis=(1, 2))
    found = np.full_like(system, np.nan)
    # the pseudo-inverse is defined at folds, too
    found[finite] = np.linalg.pinv(system[finite], rcond=1e-14)
    return found


def _broyden(inverse: np.ndarray, moved: np.ndarray, fell: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Inverses that map what the residuals fell by to the steps, otherwise as before."""
    row = np.einsum("ki,kij->kj", weights**2 * moved, inverse)
    share = np.einsum("ki,ki->k", row, fell)
    left = moved - np.einsum("kij,kj->ki", inverse, fell)
    return inverse + left[:, :, None] * row[:, None, :] / np.where(share == 0, np.inf, share)[:, None, None]


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
    plan = make_plan(scene, cases, transient=0, periods=1, **options)
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
