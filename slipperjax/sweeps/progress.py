"""How far a run is, and how long it will take: counted by its threads, shown as a bar or as lines."""

import abc
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple, TextIO

import jax

from ..tools.compile import TRACING
from ..tools.limits import shown_time

LATEST = 30.0
"""Seconds after which a line is printed in any case where there is no bar."""
SOONEST = 5.0
"""Seconds before which no line follows another."""


class _Call:
    """A call of a compiled program that is under way on a thread."""

    def __init__(self, tally: "Tally", begin: float, disturbed: bool):
        self.tally, self.begin = tally, begin
        self.compiling = False
        """Whether it is the first of its program, which is made before, and lasts longer than the call itself."""
        self.disturbed = disturbed
        """Whether anything was made in it or beside it. Other threads wait for a program that they need, too."""


_CALLS: dict[int, _Call] = {}
"""The calls that are under way, by thread."""


def _hear_begin(event: str, **_: Any) -> None:
    """Told, on the thread that compiles, that the making of a program begins."""
    call = _CALLS.get(threading.get_ident())
    if call is not None and event == TRACING:
        call.compiling = True
        call.tally.disturb()


def _hear_stage(event: str, seconds: float, **_: Any) -> None:
    """Told by JAX, on the thread that compiles, that a stage of making some program, large or small, is over."""
    call = _CALLS.get(threading.get_ident())
    if call is not None and event.startswith("/jax/core/compile/"):
        call.disturbed = True


jax.monitoring.register_event_listener(_hear_begin)
jax.monitoring.register_event_duration_secs_listener(_hear_stage)


class Later(NamedTuple):
    """What may follow a run."""

    work: float
    """At most so much, in the units of `Tally`."""
    why: str
    """In words: "for chaotic cases"."""


class Tally:
    """Work that is done and left, in any unit to which the time of a call is proportional.

    The threads of a run call `begin`, `add` and `end`. The estimate is made from calls in which nothing was compiled,
    so that it does not change when a program is done.
    """

    def __init__(
        self,
        total: float,
        cases: int,
        workers: int,
        *,
        name: str = "",
        later: Later | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ):
        """**Arguments:** `total`: all work; `cases`, `workers`: how many; `name`: of the run, shown before all else;
        `later`: what may follow it; `clock`: gives seconds."""
        self.total, self.cases, self.name, self.later = total, cases, name, later
        self.done, self.finished = 0.0, 0
        self._workers, self._clock, self._begin = workers, clock, clock()
        self._busy, self._rated = 0.0, 0.0
        self._lock, self._calls = threading.Lock(), {}

    def begin(self) -> None:
        """A call begins on this thread."""
        me = threading.get_ident()
        with self._lock:
            self._calls.pop(me, None)
            self._calls[me] = _CALLS[me] = _Call(self, self._clock(), self._compiling())

    def _compiling(self) -> bool:
        return any(call.compiling for call in self._calls.values())

    def disturb(self) -> None:
        """A program is being made: the calls that are under way tell nothing about the time that is left."""
        with self._lock:
            for call in self._calls.values():
                call.disturbed = True

    def add(self, work: float) -> None:
        """A call that did this much ended on this thread; 0: one begins."""
        now = self._clock()
        with self._lock:
            call = self._calls[threading.get_ident()]
            if work and not call.disturbed:
                self._busy += now - call.begin
                self._rated += work
            self.done += work
        self.begin()

    def end(self, cases: int = 0) -> None:
        """A chunk ended on this thread, with so many finished cases."""
        me = threading.get_ident()
        with self._lock:
            self.finished += cases
            self._calls.pop(me, None)
        _CALLS.pop(me, None)

    @property
    def spent(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._begin

    def duration(self, work: float) -> float | None:
        """Seconds that so much work takes on all threads; None where nothing was measured."""
        return work * self._busy / self._rated / self._workers if self._rated else None

    @property
    def state(self) -> str:
        """What the threads do: "starting", "compiling" or "computing"."""
        with self._lock:
            if self._compiling():
                return "compiling"
        return "computing" if self.done else "starting"

    def text(self) -> str:
        """Finished cases, and the time that was spent and is left."""
        parts = [f"{self.finished} of {self.cases} cases", f"{shown_time(self.spent)} spent"]
        left = self.duration(self.total - self.done)
        if left is not None and self.finished < self.cases:
            after = " after compiling" if self.state == "compiling" else ""
            parts.append(f"about {shown_time(left)} left{after}")
        if self.later is not None and (more := self.duration(self.later.work)) is not None:
            parts.append(f"then up to {shown_time(more)} {self.later.why}")
        return ", ".join(parts)

    @property
    def label(self) -> str:
        """The name and the state."""
        return f"{self.name}, {self.state}" if self.name else self.state


class AbstractDisplay(abc.ABC):
    """A way to show a `Tally`; a context that is left when the run is over."""

    def __init__(self, tally: Tally):
        self.tally = tally

    def __enter__(self) -> "AbstractDisplay":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    @abc.abstractmethod
    def show(self) -> None:
        """Shows it as it is now; called a few times in a second."""

    def close(self) -> None:
        """Shows it for the last time."""
        self.show()


class Silent(AbstractDisplay):
    """Shows nothing."""

    def show(self) -> None:
        pass


class Bar(AbstractDisplay):
    """A bar that is drawn over itself, for terminals and notebooks."""

    def __init__(self, tally: Tally, stream: TextIO):
        super().__init__(tally)
        from tqdm.auto import tqdm  # only here, because its import warns in notebooks without widgets

        layout = "{desc}: {percentage:3.0f}%|{bar}{postfix}"
        self._bar = tqdm(total=tally.total, file=stream, bar_format=layout, dynamic_ncols=True)

    def show(self) -> None:
        # rounding may bring the sum above the total, which tqdm warns of
        self._bar.n = min(self.tally.done, self.tally.total)
        self._bar.set_description_str(self.tally.label, refresh=False)
        self._bar.set_postfix_str(self.tally.text(), refresh=False)
        self._bar.refresh()

    def close(self) -> None:
        super().close()
        self._bar.close()


class Lines(AbstractDisplay):
    """A line now and then, for files and pipes: at each tenth, when the state changes, and after `LATEST` seconds."""

    def __init__(self, tally: Tally, stream: TextIO):
        super().__init__(tally)
        self._stream, self._last, self._tenths, self._label = stream, 0.0, 0, ""

    def show(self) -> None:
        spent, share = self.tally.spent, min(self.tally.done / self.tally.total, 1.0)
        waited, label, tenths = spent - self._last, self.tally.label, int(10 * share)
        new = tenths > self._tenths or label != self._label
        if waited >= LATEST or (waited >= SOONEST and new):
            self._last, self._tenths, self._label = spent, tenths, label
            print(f"{label}: {share:.0%}, {self.tally.text()}", file=self._stream, flush=True)


def display(tally: Tally, progress: bool, stream: TextIO | None = None) -> AbstractDisplay:
    """The way to show a tally that suits a stream, by default standard error; `progress`: whether it is wanted."""
    shown = sys.stderr if stream is None else stream
    if not progress:
        return Silent(tally)
    # the kernel of a notebook shows bars, though its stream is no terminal
    return Bar(tally, shown) if shown.isatty() or "ipykernel" in sys.modules else Lines(tally, shown)
