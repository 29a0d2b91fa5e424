"""Running chunks of cases: one chunk through its calls, and all chunks on threads with progress."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ..flow import (
    ConstantSteps,
    HistoryRecord,
    Passage,
    SectionRecord,
    Sections,
    advance,
    coordinates,
    first_problem,
    joined_in_time,
    judged_by_loads,
    most_stretch,
)
from ..model import Scene, State
from ..tools import Batched
from .plan import Calls, Chunk, OnProgress, Plan

Result = TypeVar("Result")


class ChunkRun(NamedTuple):
    """A chunk of cases after its run."""

    state: State
    """The states at the end, with a leading axis of lanes."""
    status: Int[np.ndarray, " lanes"]
    """`slipperjax.flow.Status` codes."""
    record: Any
    """What the plan's recorder collected, arrays (lanes, samples, ...)."""


def run_chunk(
    plan: Plan, scenes: Batched[Scene], states: State, steps: int, on_progress: OnProgress, epoch: int = 0
) -> ChunkRun:
    """Runs a chunk of cases through its plan, from the forcing period `epoch` on, with `steps` per period.

    Times in the record count from there.
    """
    recorder, at, status = plan.recorder, float(epoch), np.zeros(len(states.motion.y), int)
    strobes, records = [], []
    options: dict[str, Any] = dict(solver=plan.solver)
    number = jnp.asarray(float(steps))  # an array, so that one compiled program serves every number of steps
    stepping = ConstantSteps(steps=number)
    for _ in range(plan.transient.count):
        on_progress(0)
        states, ends, codes, _ = _advance(plan.transient, scenes, states, at, stepping, **options)
        status = first_problem(status, codes)
        if isinstance(recorder, Sections):
            strobes.append(coordinates(ends))
        on_progress(plan.transient.length)
        at += plan.transient.length
    if recorder.inside:
        alike = bool(np.all(plan.steps == steps))
        stepping = ConstantSteps(steps) if alike else ConstantSteps(plan.room(steps), number)
    for _ in range(plan.recorded.count):
        on_progress(0)
        options |= dict(recorder=recorder)
        states, kept, codes, _ = _advance(plan.recorded, scenes, states, at, stepping, **options)
        status = first_problem(status, codes)
        records.append(recorder.collect(kept))
        on_progress(plan.recorded.length)
        at += plan.recorded.length
    record = joined_in_time(records)
    if isinstance(record, SectionRecord):
        record = record._replace(strobe=np.concatenate([*strobes, record.strobe], axis=1), time=record.time - epoch)
    elif isinstance(record, HistoryRecord):
        record = record._replace(period=record.period - epoch)
    if isinstance(record, SectionRecord | HistoryRecord) and record.loads is not None:
        of_loads = judged_by_loads(scenes, jnp.asarray(status), record.loads, most_stretch(plan.solver))
        status = np.asarray(of_loads)
    return ChunkRun(states, status, record)


def _advance(calls: Calls, *arguments: Any, **options: Any) -> Passage:
    """`advance` over the periods of one of the calls, by a program that serves other numbers of them, too."""
    used = jnp.asarray(float(calls.length))
    end, record, status, taken = advance(*arguments, periods=calls.room, used=used, **options)
    cut = lambda tree: jax.tree.map(lambda a: np.asarray(a)[:, : calls.length], tree)
    return Passage(end, cut(record), status, cut(taken))


def progress_bar(periods: int, progress: bool) -> Any:
    """A bar over so many forcing periods, or where `progress` is False one that shows nothing."""
    if progress:
        from tqdm.auto import tqdm  # only here, because its import warns in notebooks without widgets
    else:
        from tqdm import tqdm
    return tqdm(total=periods, unit="period", unit_scale=True, disable=not progress)


def run_chunks(
    chunks: Sequence[Chunk],
    workers: int,
    work: Callable[[Chunk, OnProgress], Result],
    *,
    periods: int,
    progress: bool,
) -> list[Result]:
    """Calls `work(chunk, on_progress)` for each chunk on `workers` threads, and gives the results in order.

    `on_progress(n)` shows n forcing periods as done; it raises where another chunk failed or the user interrupted, so
    that a chunk stops at its next call. `periods`: how many one case takes in all.
    """
    stop, lock = threading.Event(), threading.Lock()
    total = sum(chunk.cases for chunk in chunks) * periods
    bar = progress_bar(total, progress)

    def one(chunk: Chunk) -> Result:
        def on_progress(periods: int) -> None:
            if stop.is_set():
                raise _Stopped
            with lock:
                bar.update(chunk.cases * periods)

        try:
            return work(chunk, on_progress)
        except BaseException:
            stop.set()
            raise

    with bar, ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, chunk) for chunk in chunks]
        try:
            wait(futures)
        except BaseException:  # Ctrl-C
            stop.set()
            raise
    failures = [error for future in futures if (error := future.exception()) is not None]
    for error in failures:
        if not isinstance(error, _Stopped):
            raise error
    return [future.result() for future in futures]


class _Stopped(Exception):
    """Ends a chunk's thread after another one failed or the user interrupted."""


def in_order(chunks: Sequence[Chunk], parts: Sequence[np.ndarray]) -> np.ndarray:
    """The chunks' arrays (lanes, ...) as one in the order of the cases, without the lanes that fill up chunks.

    Where the chunks differ in their number of samples, the second axis, fewer are filled up with NaN.
    """
    cases = sum(chunk.cases for chunk in chunks)
    samples = {part.shape[1:2] for part in parts}
    shape = (cases, *max(samples), *parts[0].shape[2:])
    found = np.empty(shape, parts[0].dtype) if len(samples) == 1 else np.full(shape, np.nan)
    for chunk, part in zip(chunks, parts, strict=True):
        within = tuple(slice(n) for n in part.shape[1:2])
        found[chunk.index[: chunk.cases], *within] = part[: chunk.cases]
    return found


def records_in_order(chunks: Sequence[Chunk], records: Sequence[Any]) -> Any:
    """The chunks' records as one, each of its arrays by `in_order`."""
    return jax.tree.map(lambda *parts: in_order(chunks, parts), *records)
