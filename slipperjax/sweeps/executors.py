"""Running chunks of cases: one chunk through its calls, and all chunks on threads with progress."""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ..flow.period_map import Passage, advance
from ..flow.record import RecordedSpan, RecordSet, Samples
from ..flow.status import ASKED, Interrupted, blank, first_problem
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State
from ..model.scene import Scene
from ..tools.batching import Batched
from .plan import Calls, Chunk, OnProgress, Plan
from .progress import Later, Tally, display
from .records import RecordedChunk

TICK = 0.25
"""Seconds between two looks at how far a run is."""

STOPPING = 5.0
"""Seconds that are waited for what runs beside an interrupted run; programs that are being compiled take longer."""


class ChunkRun(NamedTuple):
    """A chunk of cases after its run."""

    state: State
    """The states at the end, with a leading axis of lanes."""
    status: Int[np.ndarray, " lanes"]
    """`slipperjax.Status` codes."""
    record: tuple[Any, ...]
    """Arrays of the plan's records, with a leading axis of lanes."""


def run_chunk(
    plan: Plan, scenes: Batched[Scene], states: State, steps: int, on_progress: OnProgress, epoch: int = 0
) -> ChunkRun:
    """Runs a chunk of cases through its plan, from the forcing period `epoch` on, with `steps` per period.

    Times in records count from there.
    """
    records, at, status = plan.records, float(epoch), np.zeros(len(states.motion.y), int)
    samples = Samples(records, plan.recorded.periods)
    number = jnp.asarray(float(steps))  # an array, so that one compiled program serves every number of steps
    stepping = recording = ConstantSteps(steps=number)
    if records.inside:
        alike = bool(np.all(plan.steps == steps))
        recording = ConstantSteps(steps) if alike else ConstantSteps(plan.room(steps), number)
    for calls, kept, how in (
        (plan.transient, records.from_start, stepping),
        (plan.recorded, records, recording),
    ):
        carried = _initial_carry(kept, scenes, states)
        for _ in range(calls.count):
            on_progress(0)
            passed = _advance(calls, scenes, states, at, how, solver=plan.solver, records=kept, earlier=carried)
            states, carried = passed.state, passed.carried
            status = first_problem(status, passed.status)
            samples.add(kept, passed.samples)
            on_progress(kept.cost * calls.length)
            at += calls.length
    chunk = RecordedChunk(plan, scenes, states, at, steps, on_progress)
    carried, status = records.after(carried, status, chunk)
    span = RecordedSpan(plan.recorded.periods, steps, float(epoch), status)
    return ChunkRun(states, status, records.finish(carried, samples.joined(), span))


def _initial_carry(records: RecordSet, scenes: Batched[Scene], states: State) -> Any:
    """Carries of no period, with a leading axis of lanes."""
    lanes, first = len(states.motion.y), lambda tree: jax.tree.map(lambda a: a[0], tree)
    one = records.begin(eqx.combine(first(scenes.varied), scenes.shared), first(states))
    return jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), one)


def _advance(calls: Calls, *arguments: Any, **options: Any) -> Passage:
    """`advance` over the periods of one of the calls, by a program that serves other numbers of them, too."""
    found = advance(*arguments, **options, **_room(calls))
    cut = lambda tree: jax.tree.map(lambda a: np.asarray(a)[:, : calls.length], tree)
    return found._replace(samples=cut(found.samples), steps_taken=cut(found.steps_taken))


def _room(calls: Calls) -> dict[str, Any]:
    """Arguments of `advance` for one of the calls."""
    return dict(periods=calls.room, used=jnp.asarray(float(calls.length)))


class Runs(NamedTuple):
    """The chunks of a run after it, or after an interrupt."""

    results: list[Any]
    """One for each chunk, of those that were not finished by `blank`."""
    finished: int
    """Number of finished cases."""
    cases: int
    """Number of all."""
    interrupted: bool

    def checked(self, made: Any) -> Any:
        """What was made of the results; raises `Interrupted` with it where the run was interrupted."""
        if self.interrupted:
            raise Interrupted(made, self.finished, self.cases)
        return made


def run_chunks(
    chunks: Sequence[Chunk],
    workers: int,
    work: Callable[[Chunk, OnProgress], Any],
    *,
    periods: float,
    progress: bool,
    name: str = "",
    later: Later | None = None,
) -> Runs:
    """Calls `work(chunk, on_progress)` for each chunk on `workers` threads, the first chunks first.

    After Ctrl-C what is finished is returned at once; a thread that is inside a call ends after it.

    **Arguments:** `work`: gives a named tuple of arrays with a leading axis of lanes and a field `status`; it calls
    `on_progress(n)` when work is done that takes as long as n forcing periods of the chunk without a record. That
    raises where another chunk failed or the user interrupted, so that a chunk stops at its next call. `periods`: how
    many such one case takes in all. `progress`, `name`, `later`: whether progress is shown, and see `Tally`.

    **Raises:** `Interrupted` where no chunk was finished before an interrupt.
    """
    stop, interrupted = threading.Event(), False
    cases = sum(chunk.cases for chunk in chunks)
    total = sum(chunk.cost for chunk in chunks) * periods
    tally = Tally(total, cases, workers, name=name, later=later)

    def one(chunk: Chunk) -> Any:
        def on_progress(periods: float) -> None:
            if stop.is_set():
                raise _Stopped
            tally.add(chunk.cost * periods)

        tally.begin()
        try:
            found = work(chunk, on_progress)
            tally.end(chunk.cases)
            return found
        except BaseException:
            stop.set()
            tally.end()
            raise

    pool, futures = ThreadPoolExecutor(workers), []
    try:
        futures += [pool.submit(one, chunk) for chunk in chunks]
        with display(tally, progress) as shown:
            while wait(futures, TICK).not_done:
                if ASKED.is_set():
                    raise KeyboardInterrupt
                shown.show()
    except KeyboardInterrupt:
        interrupted = True
    finally:
        stop.set()
        # not joined: after Ctrl-C their calls may last for a long time
        pool.shutdown(wait=False, cancel_futures=True)
    ended = [future for future in futures if future.done() and not future.cancelled()]
    if not interrupted:
        _raise_first(ended)
    return _gathered(chunks, [f.result() if f in ended and not f.exception() else None for f in futures], interrupted)


def _raise_first(futures: Sequence[Future]) -> None:
    """Raises what made the run stop, if anything did."""
    for future in futures:
        error = future.exception()
        if error is not None and not isinstance(error, _Stopped):
            raise error


def _gathered(chunks: Sequence[Chunk], found: list[Any], interrupted: bool) -> Runs:
    """The results of a run, in which those that are None are blank."""
    cases = sum(chunk.cases for chunk in chunks)
    like = next((result for result in found if result is not None), None)
    if like is None:
        raise Interrupted(None, 0, cases)
    parts = zip(chunks, found, strict=False)
    finished = sum(chunk.cases for chunk, result in parts if result is not None)
    found += [None] * (len(chunks) - len(found))
    results = [blank(like, len(c.index)) if r is None else r for c, r in zip(chunks, found, strict=True)]
    return Runs(results, finished, cases, interrupted)


def on_threads(calls: Sequence[Callable[[OnProgress], Any]]) -> list[Any]:
    """Calls each function on a thread of its own, and gives the results in order.

    **Arguments:** `calls`: called with an `on_progress`, which they call now and then and which raises after Ctrl-C.
    """
    stop = threading.Event()

    def on_progress(periods: float) -> None:
        if ASKED.is_set():
            raise KeyboardInterrupt
        if stop.is_set():
            raise _Stopped

    pool = ThreadPoolExecutor(len(calls))
    try:
        return [future.result() for future in [pool.submit(call, on_progress) for call in calls]]
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def beside(call: Callable[[], Any]) -> Iterator[Callable[[], Any]]:
    """Calls a function on a thread of its own while the body of the context runs; gives what waits for its result.

    Where the body ends by an exception, what runs on the thread ends as by Ctrl-C, and is waited for (`STOPPING`).
    """
    pool = ThreadPoolExecutor(1)
    found = pool.submit(call)
    try:
        yield found.result
    except BaseException:
        with all_stopped():
            wait([found], STOPPING)
        raise
    finally:
        pool.shutdown(wait=False)


@contextmanager
def all_stopped() -> Iterator[None]:
    """Within this context all runs end as by Ctrl-C."""
    before = ASKED.is_set()
    ASKED.set()
    try:
        yield
    finally:
        if not before:
            ASKED.clear()


class _Stopped(Exception):
    """Ends a chunk's thread after another one failed or the user interrupted."""


def in_order(chunks: Sequence[Chunk], parts: Sequence[np.ndarray]) -> np.ndarray:
    """The chunks' arrays (lanes, ...) as one in the order of the cases, without the lanes that fill up chunks."""
    found = np.empty((sum(chunk.cases for chunk in chunks), *parts[0].shape[1:]), parts[0].dtype)
    for chunk, part in zip(chunks, parts, strict=True):
        found[chunk.index[: chunk.cases]] = part[: chunk.cases]
    return found


def records_in_order(chunks: Sequence[Chunk], records: Sequence[Any]) -> Any:
    """The chunks' records as one, each of its arrays by `in_order`."""
    return jax.tree.map(lambda *parts: in_order(chunks, parts), *records)
