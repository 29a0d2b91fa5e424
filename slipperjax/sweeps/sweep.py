"""Grids of parameters as one batch to xarray: each case from the same start, or each from its neighbour's end."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from tqdm.auto import tqdm

from .batch import Grid, Workers, case_scene, filled, join, start_states
from .checks import one_of, whole
from .compilation import jit
from .kinematics import Motion, table_2_start
from .labels import scene_attributes
from .records import KEEPS, Strobe, outputs
from .scene import Scene
from .simulate import STATUS, check_solver, check_start, integrate, judged, status, step_plan
from .solvers import calls_lapack, solver_name

DIRECTIONS = {"up": 1, "down": -1}
"""Ways through a parameter's values for `follow`."""


def sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    product: bool = True,
    record: str = "sections",
    transient: int = 200,
    periods: int = 10,
    steps_per_period: int | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | None = None,
    start: Motion | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Simulates a scene for every combination of parameter values, as one batch.

    **Arguments:**

    - `scene`: the case whose parameters are varied.
    - `grid`: values by parameter name (see `PARAMETERS` for names and units); several names make a product.
        Coordinates of the start (y, z, v_y, v_z, w_x, w_y, w_z) are allowed too, which gives pictures of basins.
    - `product`: False reads the lists of values side by side, one case each, along the dimension `case`.
    - `record`: what to keep of the last `periods` periods. "sections": velocities at the upward zero crossings of
        each coordinate, as in the paper's bifurcation diagrams, and `strobe`, the state once per period from the
        start on; "strobe": the state once per forcing period;
        "history": states and contact forces `saves_per_period` times per period.
    - `transient`: forcing periods to pass before; above ten rounded up to tens, see the attribute `transient`.
    - `steps_per_period`: default the most that `default_steps_per_period` wants for any case of the grid.
    - `solver`, `start`, `saves_per_period`: as for `simulate`.
    - `chunk`: cases per call; `workers`: threads, default one per core, and never more than one
        where `solver` is one of diffrax's implicit ones, see `solvers.calls_lapack`. Neither changes any result.
    - `progress`: show a progress bar.

    **Returns:** an `xarray.Dataset` with the grid's names as first dimensions, then `crossing`, `period` or
    `time`. The variable `status` is 0 where a case went well and names what happened otherwise; a case that left
    the finite numbers leaves the others untouched. A start coordinate x that is varied makes the dimension `start_x`.

    **Raises:** `ValueError` that names the argument which is wrong, before anything is compiled.
    """
    cases = Grid(scene, grid, product=product)
    plan = make_plan(scene, cases, record, transient, periods, steps_per_period, saves_per_period, solver)
    start = table_2_start() if start is None else check_start(start)
    team = Workers(cases.lanes, chunk, workers, alone=calls_lapack(plan.solver))

    def work(values, tick):
        _, code, kept = run_blocks(scene, plan, values, start_states(scene, values, start), tick)
        return [code, *kept]

    found = team.run(work, cases.values, periods=plan.total, progress=progress)
    return _dataset(scene, plan, cases, found, {}, cases.shape)


def follow(
    scene: Scene,
    path: Mapping[str, Any],
    *,
    directions: tuple[str, ...] = ("up", "down"),
    record: str = "sections",
    transient: int = 30,
    periods: int = 10,
    steps_per_period: int | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | None = None,
    start: Motion | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Sweeps a parameter with memory: each case starts from the state in which its neighbour ended.

    So a motion is followed along its branch until that ends, which from a fixed start it need not be. Where "up"
    and "down" disagree, attractors coexist.

    **Arguments:**

    - `path`: one parameter's name and values, in increasing order.
    - `directions`: "up" begins at the first value, "down" at the last; both run as one batch.
    - `transient`, `periods`: forcing periods at each value, before recording and recorded. The transient is
        rounded up to tens if above ten.
    - others: as for `sweep`; `start` is that of the first value met.

    **Returns:** as `sweep`, with `direction` as first dimension.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    cases, name, values = path_cases(scene, path)
    if not directions or len(set(directions)) < len(directions):
        raise ValueError(f"Argument `directions` must name one or more ways, each once, but is {directions!r}.")
    ways = [DIRECTIONS[one_of("directions", d, tuple(DIRECTIONS))] for d in directions]
    plan = make_plan(scene, cases, record, transient, periods, steps_per_period, saves_per_period, solver)
    start = table_2_start() if start is None else check_start(start)
    columns = np.stack([values[::way] for way in ways], axis=1)  # (values, directions)
    index = filled(len(ways))
    states = start_states(scene, {name: jnp.asarray(columns[0][index])}, start)
    pieces = []
    with tqdm(total=plan.total * columns.size, unit="period", unit_scale=True, disable=not progress) as bar:
        for k, column in enumerate(columns):
            here = {name: jnp.asarray(column[index])}
            tick = lambda periods: bar.update(periods * len(ways))
            states, code, kept = run_blocks(scene, plan, here, states, tick, epoch=k * plan.total)
            pieces.append([a[: len(ways)] for a in (code, *kept)])
    # (values x directions, ...) in the order of the run -> (directions, values, ...) in the order of the values
    found = [a.reshape(columns.shape + a.shape[1:]) for a in join(pieces)]
    found = [np.stack([a[::way, d] for d, way in enumerate(ways)]) for a in found]
    found = [a.reshape(-1, *a.shape[2:]) for a in found]
    return _dataset(scene, plan, cases, found, {"direction": list(directions)}, (len(ways), len(values)))


def path_cases(scene: Scene, path: Mapping[str, Any]) -> tuple[Grid, str, np.ndarray]:
    """The cases along one parameter, its name and its values, which must increase."""
    cases = Grid(scene, path)
    name, values = next(iter(cases.axes.items()))
    if len(cases.axes) > 1 or np.any(np.diff(values) <= 0):
        raise ValueError(f"Argument `path` must name one parameter with increasing values, but is {path!r}.")
    return cases, name, values


class Plan(NamedTuple):
    """How a batch is run: what one compiled call depends on beside numbers, and how many calls there are."""

    solver: diffrax.AbstractSolver
    steps: int
    saves: int
    pause: int
    """Periods in a call that records nothing: progress is shown, and an interrupt heard, between calls."""
    block: int
    """Periods in a call that records."""
    silent: int
    """Calls that record nothing."""
    recorded: int
    """Calls that record."""
    record: str

    @property
    def total(self) -> int:
        """Periods of one case."""
        return self.pause * self.silent + self.block * self.recorded


def make_plan(scene, cases, record, transient, periods, steps_per_period, saves_per_period, solver) -> Plan:
    """The plan of a sweep from its arguments, which are checked here."""
    record = one_of("record", record, tuple(KEEPS))
    transient, periods = whole("transient", transient, 0), whole("periods", periods, 1)
    if steps_per_period is None:
        saves = 50 if saves_per_period is None else whole("saves_per_period", saves_per_period, 1)
        steps_per_period = -(-cases.most_steps(scene) // saves) * saves
    steps, saves = step_plan(scene, steps_per_period, saves_per_period)
    block, pause = block_length(periods), max(1, min(transient, PAUSE))
    silent = -(-transient // pause)
    return Plan(check_solver(scene, solver), steps, saves, pause, block, silent, periods // block, record)


PAUSE = 10
"""Periods in one call of a transient: one length, so that one program serves them all."""


def block_length(periods: int) -> int:
    """Periods in one call."""
    if periods <= 50:
        return periods
    return next((k for k in range(50, 9, -1) if periods % k == 0), periods)


def run_blocks(scene, plan, values, states, tick, epoch=0):
    """Runs a chunk of cases through its plan.

    **Returns:** the states at the end, a status code per case, and the recorded arrays (cases, samples, ...).
    """
    keep = KEEPS[plan.record]
    code = np.zeros(len(next(iter(values.values()))), int)
    records, strobes = [], []
    at = float(epoch)
    for k in range(plan.silent + plan.recorded):
        tick(0)
        block = plan.pause if k < plan.silent else plan.block
        if k < plan.silent or isinstance(keep, Strobe):
            # nothing is stored between the ends of periods, and one compiled program serves any number of steps
            states, codes, ends = _pass(scene, values, states, at, float(plan.steps), plan.solver, block)
            if k >= plan.silent:
                records.append(keep.collect(ends))
            elif keep.strobes:
                strobes.append(outputs(ends))
        else:
            # how often it is called does not make it another program
            program = plan._replace(pause=0, silent=0, recorded=0)
            states, codes, kept = _keep(scene, values, states, at, program)
            records.append(keep.collect(kept))
        code = np.where(code == 0, np.asarray(codes), code)
        tick(block)
        at += block
    kept = [np.concatenate(parts, axis=1) for parts in zip(*records, strict=True)]
    if strobes:
        kept[-1] = np.concatenate([*strobes, kept[-1]], axis=1)
    return states, code, kept


def _integrated(scene, values, states, **options):
    def one(values, state):
        case = case_scene(scene, values)
        end, kept = integrate(case, state, adjoint=diffrax.ForwardMode(), **options)
        # the ends of all periods where they are at hand: a slipper may derail and turn on until it looks upright
        code = status(kept if options["record"] is None else end)
        return end, judged(code, case, options["steps"]), kept

    return jax.vmap(one)(values, states)


@functools.partial(jit, static_argnums=(5, 6))
def _pass(scene, values, states, epoch, steps, solver, block):
    options = dict(epoch=epoch, steps=steps, solver=solver, periods=block, record=None)
    return _integrated(scene, values, states, **options)


@functools.partial(jit, static_argnums=4)
def _keep(scene, values, states, epoch, plan):
    record = KEEPS[plan.record].make(plan.steps // plan.saves)
    options = dict(epoch=epoch, steps=plan.steps, solver=plan.solver, periods=plan.block, record=record)
    return _integrated(scene, values, states, **options)


def _dataset(scene, plan, cases, found, first, shape) -> xr.Dataset:
    """The labelled result; `first`: dimensions before those of the grid, with their coordinates."""
    codes, *kept = found
    dims = (*first, *cases.dims)
    data, coords = KEEPS[plan.record].label(scene, dims, [a.reshape(*shape, *a.shape[1:]) for a in kept])
    meanings = "; ".join(f"{code}: {meaning}" for code, meaning in STATUS.items())
    data["status"] = (dims, codes.reshape(shape), {"long_name": "status", "meaning": meanings})
    coords |= first | cases.coordinates()
    attrs = {k: v for k, v in scene_attributes(scene).items() if k.split(" [")[0] not in cases.axes}
    attrs |= {
        "steps_per_period": plan.steps,
        "transient": plan.silent * plan.pause,
        "periods": plan.recorded * plan.block,
        "solver": solver_name(plan.solver),
        "record": plan.record,
    }
    return xr.Dataset(data, coords, attrs)
