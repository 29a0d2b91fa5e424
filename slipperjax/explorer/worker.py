"""Work beside a page: the latest job runs on a thread of its own, piece by piece, and gives way to a newer one."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

Job = Callable[[], Iterator[Any]]
"""Makes the pieces of a result; it is left between two of them when it is no longer wanted."""


class Worker:
    """A thread that runs one job at a time: one that is given later takes the place of the one before."""

    def __init__(self, deliver: Callable[[Any, Callable[[], bool]], None], ended: Callable[[Exception | None], None]):
        """**Arguments:** functions that the thread calls with each piece of the latest job, and whether that is still
        wanted; and when it has ended, with its error, unless it was stopped or another one follows."""
        self._deliver, self._ended = deliver, ended
        self._waiting, self._latest, self._closed = threading.Condition(), 0, False
        self._job: Job | None = None
        self.busy = False
        """Whether a job is wanted and not at its end."""
        threading.Thread(target=self._run, daemon=True).start()

    def submit(self, job: Job | None) -> None:
        """Runs a job in place of the one that runs, or waits; None leaves that one at its next piece."""
        with self._waiting:
            self._job, self._latest, self.busy = job, self._latest + 1, job is not None
            self._waiting.notify()

    def close(self) -> None:
        """Leaves the job, and ends the thread."""
        self._closed = True
        self.submit(None)

    def _run(self) -> None:
        while True:
            with self._waiting:
                self._waiting.wait_for(lambda: self._job is not None or self._closed)
                job, number, self._job = self._job, self._latest, None
            if job is None:
                return
            wanted, error = lambda number=number: number == self._latest, None
            try:
                for piece in job():
                    if not wanted():
                        break
                    self._deliver(piece, wanted)
            except Exception as problem:  # whatever it is, the page says it and lives on
                error = problem
            with self._waiting:
                told = wanted()
                self.busy = self.busy and not told
            if told:
                self._ended(error)
