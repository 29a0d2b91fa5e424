"""Grids of parameters as one batch, in chunks over the cores, to xarray."""

import functools
import math
import os
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from tqdm.auto import tqdm

from .analysis.poincare import SECTIONS, section_crossings
from .checks import fraction, one_of, whole
from .compilation import jit
from .dynamics import Args, initial_state, reactions
from .kinematics import Motion, euler_angles, table_2_start
from .labels import OUTPUTS, attributes, scene_attributes
from .scene import PARAMETERS, Scene, contact_duration, default_steps_per_period
from .simulate import STATUS, Record, check_solver, check_start, integrate, status, step_plan

LARGEST_CHUNK = 1024
"""Cases in one call: enough to hide the cost of starting a kernel, few enough to stay in the cache."""


def sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
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
    - `record`: what to keep of the last `periods` periods. "sections": velocities at the upward zero crossings of
        each coordinate, as in the paper's bifurcation diagrams; "strobe": the state once per forcing period;
        "history": states and contact forces `saves_per_period` times per period.
    - `transient`: forcing periods to pass before; rounded up to whole blocks, see the attribute `transient`.
    - `steps_per_period`: default the most that `default_steps_per_period` wants for any case of the grid.
    - `solver`, `start`, `saves_per_period`: as for `simulate`.
    - `chunk`: cases per call; `workers`: threads, default one per core. Neither changes any result.
    - `progress`: show a progress bar.

    **Returns:** an `xarray.Dataset` with the grid's names as first dimensions, then `crossing`, `period` or
    `time`. The variable `status` is 0 where a case went well and names what happened otherwise; a case that left
    the finite numbers leaves the others untouched.

    **Raises:** `ValueError` that names the argument which is wrong, before anything is compiled.
    """
    axes = check_grid(scene, grid)
    record = one_of("record", record, tuple(_RECORDS))
    transient, periods = whole("transient", transient, 0), whole("periods", periods, 1)
    lanes = math.prod(len(v) for v in axes.values())
    mesh = np.meshgrid(*axes.values(), indexing="ij")
    values = {name: m.ravel() for name, m in zip(axes, mesh, strict=True)}
    if steps_per_period is None:
        steps_per_period = _most_steps(scene, values)
        saves = 50 if saves_per_period is None else whole("saves_per_period", saves_per_period, 1)
        steps_per_period = -(-steps_per_period // saves) * saves
    steps, saves = step_plan(scene, steps_per_period, saves_per_period)
    start = table_2_start() if start is None else check_start(start)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    workers = cores if workers is None else whole("workers", workers, 1)
    if chunk is None:
        chunk = min(-(-lanes // workers), LARGEST_CHUNK)
    chunk = min(whole("chunk", chunk, 1), lanes)
    plan = Plan(check_solver(scene, solver), steps, saves, block_length(periods), record)
    pieces = _run(scene, values, start, plan, transient, periods, chunk, workers, progress)
    kept = [np.concatenate([p[k] for p in pieces])[:lanes] for k in range(len(pieces[0]))]
    codes, *kept = kept
    shape = tuple(len(v) for v in axes.values())
    dims = tuple(axes)
    data, coords = _RECORDS[record].label(scene, dims, [k.reshape(*shape, *k.shape[1:]) for k in kept], transient)
    meanings = "; ".join(f"{code}: {meaning}" for code, meaning in STATUS.items())
    data["status"] = (dims, codes.reshape(shape), {"long_name": "status", "meaning": meanings})
    for name, v in axes.items():
        coords[name] = (name, v, attributes(*PARAMETERS[name][:2]))
    attrs = {k: v for k, v in scene_attributes(scene).items() if k.split(" [")[0] not in axes}
    attrs |= {
        "steps_per_period": steps,
        "transient": -(-transient // plan.block) * plan.block,
        "periods": periods,
        "solver": type(plan.solver).__name__,
        "record": record,
    }
    return xr.Dataset(data, coords, attrs)


def check_grid(scene: Scene, grid: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The grid's axes as arrays of floats; raises `ValueError` for a wrong name, an empty axis or a bad value."""
    if not isinstance(grid, Mapping) or not grid:
        raise ValueError(f"Argument `grid` must name one or more parameters with their values, but is {grid!r}.")
    axes = {}
    for name, raw in grid.items():
        scene.value(name)
        check = fraction("restitution") if name == "restitution" else PARAMETERS[name][2]
        values = np.atleast_1d(np.asarray(check(raw)))
        if values.ndim != 1 or values.size == 0:
            raise ValueError(f"Argument `{name}` must be a list of one or more values, but has shape {values.shape}.")
        axes[name] = values
    return axes


def block_length(periods: int) -> int:
    """Periods in one call: progress is shown, and an interrupt heard, between calls."""
    if periods <= 50:
        return periods
    return next((k for k in range(50, 9, -1) if periods % k == 0), periods)


def _most_steps(scene: Scene, values: Mapping[str, np.ndarray]) -> int:
    # The clearance has no part in it, and its play per face would not broadcast.
    batched = scene.replace(**{k: v for k, v in values.items() if k != "clearance"})
    ratio = np.asarray(batched.period / contact_duration(batched))
    worst = int(np.argmax(ratio)) if ratio.ndim else 0
    return default_steps_per_period(scene.replace(**{k: v[worst] for k, v in values.items()}))


class Plan(NamedTuple):
    """What one compiled call depends on beside numbers."""

    solver: diffrax.AbstractSolver
    steps: int
    saves: int
    block: int
    record: str


def _starts(scene, values, start):
    return jax.vmap(lambda v: initial_state(scene.replace(**v), start))(values)


def _block(scene, values, states, epoch, plan):
    """One block of periods of one chunk: the states after it, and what was recorded."""

    def one(values, state):
        return integrate(
            scene.replace(**values),
            state,
            solver=plan.solver,
            steps=plan.steps,
            periods=plan.block,
            record=_RECORDS[plan.record].make(plan),
            adjoint=diffrax.ForwardMode(),
            epoch=epoch,
        )

    return jax.vmap(one)(values, states)


_starts_jit = jit(_starts)
_block_jit = jit(_block, static_argnums=4)


def _run(scene, values, start, plan, transient, periods, chunk, workers, progress):
    """Runs all chunks on a pool of threads; each piece is (status, kept arrays...), cases along the first axis."""
    lanes = len(next(iter(values.values())))
    blocks = -(-transient // plan.block) + periods // plan.block
    first = blocks - periods // plan.block
    stop = threading.Event()
    bar = tqdm(total=lanes * blocks * plan.block, unit="period", unit_scale=True, disable=not progress)
    lock = threading.Lock()

    def piece(at):
        # The last chunk is filled up with copies of its last case, so that every chunk runs the same program.
        index = np.minimum(np.arange(at, at + chunk), lanes - 1)
        mine = {name: jnp.asarray(v[index]) for name, v in values.items()}
        states = _starts_jit(scene, mine, start)
        code = np.zeros(chunk, int)
        records = []
        for k in range(blocks):
            if stop.is_set():
                return None
            now = plan if k >= first else plan._replace(record="strobe")  # a transient stores nothing
            states, kept = _block_jit(scene, mine, states, float(k * plan.block), now)
            code = np.where(code == 0, np.asarray(jax.vmap(status)(states)), code)
            if k >= first:
                records.append([np.asarray(a) for a in _RECORDS[plan.record].collect(kept)])
            with lock:
                bar.update(min(chunk, lanes - at) * plan.block)
        joined = [np.concatenate([r[i] for r in records], axis=1) for i in range(len(records[0]))]
        return [code, *joined]

    starts = range(0, lanes, chunk)
    with bar, ThreadPoolExecutor(min(workers, len(starts))) as pool:
        try:
            return list(pool.map(piece, starts))
        except BaseException:
            stop.set()  # a chunk stops at its next block, not in the middle of one
            raise


class _Sections:
    """Velocities at upward zero crossings."""

    @staticmethod
    def make(plan: Plan) -> Record:
        return section_crossings

    @staticmethod
    def collect(kept):
        # (lanes, periods, sections, steps) -> (lanes, hits, sections) with hits packed to the front
        order = (0, 1, 3, 2)
        return [np.transpose(np.asarray(a), order).reshape(a.shape[0], -1, a.shape[2]) for a in kept]

    @staticmethod
    def label(scene, dims, kept, transient):
        time, velocity = kept
        absent = np.isnan(velocity)
        order = np.argsort(absent, axis=-2, kind="stable")
        most = max(int(np.max(np.sum(~absent, axis=-2))), 1)
        order = order[..., :most, :]
        time, velocity = (np.take_along_axis(a, order, axis=-2) for a in (time, velocity))
        data = {}
        for k, (name, coordinate) in enumerate(SECTIONS.items()):
            unit, text = OUTPUTS[name]
            across = f"at upward zero crossings of {OUTPUTS[coordinate][1]}"
            data[name] = ((*dims, "crossing"), velocity[..., k], attributes(unit, f"{text} {across}"))
            data[f"{name}_period"] = (
                (*dims, "crossing"),
                time[..., k],
                attributes("1", f"forcing periods passed {across}"),
            )
        return data, {}


def _outputs(state) -> list:
    m = state.motion
    return [m.y, m.z, *euler_angles(m), m.v_y, m.v_z, m.w_x, m.w_y, m.w_z]


class _Strobe:
    """The state once per forcing period."""

    @staticmethod
    def make(plan: Plan) -> None:
        return None

    @staticmethod
    def collect(kept):
        return _outputs_jit(kept)

    @staticmethod
    def label(scene, dims, kept, transient):
        data = {
            name: ((*dims, "period"), values, attributes(*OUTPUTS[name]))
            for name, values in zip(OUTPUTS, kept, strict=True)
        }
        count = kept[0].shape[-1]
        coords: dict = {"period": ("period", np.arange(1, count + 1), attributes("1", "forcing periods recorded"))}
        return data, coords


class _History:
    """States and contact forces at constant intervals."""

    @staticmethod
    def make(plan: Plan) -> Record:
        return _history(plan.steps // plan.saves)

    @staticmethod
    def collect(kept):
        return [np.asarray(a).reshape(a.shape[0], -1, *a.shape[3:]) for a in kept]

    @staticmethod
    def label(scene, dims, kept, transient):
        *outputs, period, force = kept
        data = {
            name: ((*dims, "time"), values, attributes(*OUTPUTS[name]))
            for name, values in zip(OUTPUTS, outputs, strict=True)
        }
        unit = attributes("N", "normal contact force on the slipper")
        data["contact_force"] = ((*dims, "time", "end", "point"), force, unit)
        period = period.reshape(-1, period.shape[-1])[0]
        coords: dict = {
            "period": ("time", period, attributes("1", "time in forcing periods")),
            "end": ["front", "rear"],
            "point": list(scene.section.names),
        }
        return data, coords


@functools.cache
def _history(stride: int) -> Record:
    def record(states, args: Args, steps: int):
        saved = jax.tree.map(lambda a: a[stride::stride], states)
        period = jnp.arange(stride, steps + 1, stride) / steps
        outputs = jax.vmap(_outputs)(saved)
        force = jax.vmap(lambda t, s: reactions(t, s, args).contact_force)(period, saved)
        return [*outputs, period + args.epoch, force]

    return record


_outputs_jit = jax.jit(_outputs)
_RECORDS = {"sections": _Sections, "strobe": _Strobe, "history": _History}
