"""Work in the background of a page: one thread, which runs jobs piece by piece, the urgent jobs first."""

import threading
from collections.abc import Callable, Iterator, Sequence


class Worker:
    """A thread that runs jobs; a new job replaces an earlier job of the same name."""

    def __init__(
        self,
        names: Sequence[str],
        deliver: Callable[[object, Callable[[], bool]], None],
        ended: Callable[[Exception | None], None],
    ):
        """**Arguments:**

        - `names`: of the kinds of jobs, the most urgent first.
        - `deliver`: called by the thread with each piece of a job, and a function that returns whether it is still
            wanted.
        - `ended`: called by the thread when a job has ended, with its error, unless it was stopped or replaced.
        """
        self._names = names
        self._deliver = deliver
        self._ended = ended
        self._jobs: dict[str, Iterator[object]] = {}
        self._changed = threading.Condition()
        self._closed = False
        threading.Thread(target=self._run, daemon=True).start()

    def is_busy(self) -> bool:
        """Return whether a job runs or waits."""
        return bool(self._jobs)

    def submit(self, name: str, job: Iterator[object]) -> None:
        """Run a job, an iterator that computes its pieces, in place of an earlier job of the same name."""
        with self._changed:
            self._jobs[name] = job
            self._changed.notify()

    def stop(self) -> None:
        """Drop all jobs; the piece in computation is no longer wanted."""
        with self._changed:
            self._jobs.clear()

    def close(self) -> None:
        """Drop all jobs, and end the thread."""
        with self._changed:
            self._jobs.clear()
            self._closed = True
            self._changed.notify()

    def _run(self) -> None:
        # one piece at a time, so that a more urgent job waits for one piece at most
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                # the most urgent job; other jobs wait between their pieces
                name = next(name for name in self._names if name in self._jobs)
                job = self._jobs[name]
            self._advance(name, job)

    def _advance(self, name: str, job: Iterator[object]) -> None:
        """Compute and deliver the next piece of a job, or end it."""
        error = None
        wanted = lambda: self._jobs.get(name) is job
        try:
            self._deliver(next(job), wanted)
            return
        except StopIteration:
            pass
        except Exception as problem:  # for any error, the page shows it and continues
            error = problem
        with self._changed:
            # a replaced job reports nothing
            told = wanted()
            if told:
                del self._jobs[name]
        if told:
            self._ended(error)
