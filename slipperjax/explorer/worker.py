"""Work beside a page: the latest job runs on a thread of its own, piece by piece, and gives way to a newer one."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

Job = Callable[[], Iterator[Any]]
"""Makes the pieces of a result; it is left between two of them when it is no longer wanted."""


class Worker:
    """A thread that runs one job at a time: one that is given later takes the place of the one before."""

    def __init__(
        self, deliver: Callable[[Any], None], failed: Callable[[Exception], None], ended: Callable[[], None]
    ):
        """**Arguments:** functions that the thread calls: with each piece of the latest job; with its error; and when
        it has ended, unless it was stopped or another one follows."""
        self._deliver, self._failed, self._ended = deliver, failed, ended
        self._waiting, self._wanted, self._closed = threading.Condition(), 0, False
        self._job: Job | None = None
        threading.Thread(target=self._run, daemon=True).start()

    def submit(self, job: Job) -> None:
        """Runs a job in place of the one that runs, or waits."""
        with self._waiting:
            self._job, self._wanted = job, self._wanted + 1
            self._waiting.notify()

    def stop(self) -> None:
        """Leaves the job at its next piece, and keeps what it has delivered."""
        with self._waiting:
            self._job, self._wanted = None, self._wanted + 1

    def close(self) -> None:
        """Stops for good, after which the thread ends."""
        self.stop()
        with self._waiting:
            self._closed = True
            self._waiting.notify()

    def _run(self) -> None:
        while True:
            with self._waiting:
                self._waiting.wait_for(lambda: self._job is not None or self._closed)
                if self._closed:
                    return
                job, number, self._job = self._job, self._wanted, None
            assert job is not None
            try:
                for piece in job():
                    if number != self._wanted:
                        break
                    self._deliver(piece)
            except Exception as error:  # whatever it is, the page says it and lives on
                if number == self._wanted:
                    self._failed(error)
            if number == self._wanted:
                self._ended()
