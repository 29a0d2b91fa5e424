"""Work beside a page: one thread, which runs jobs piece by piece, the urgent ones first."""

import threading
from collections.abc import Callable, Iterator, Sequence


class Worker:
    """A thread that runs jobs; a new job replaces the one of the same name before it."""

    def __init__(
        self,
        names: Sequence[str],
        deliver: Callable[[object, Callable[[], bool]], None],
        ended: Callable[[Exception | None], None],
    ):
        """**Arguments:**

        - `names`: of the kinds of jobs, the most urgent first.
        - `deliver`: called by the thread with each piece of a job, and a function that tells if it is still wanted.
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
        """Run a job, an iterator that computes its pieces, in place of the one of that name before."""
        with self._changed:
            self._jobs[name] = job
            self._changed.notify()

    def stop(self) -> None:
        """Drop all jobs; a piece that is being computed is no longer wanted."""
        with self._changed:
            self._jobs.clear()

    def close(self) -> None:
        """Drop all jobs, and end the thread."""
        with self._changed:
            self._jobs.clear()
            self._closed = True
            self._changed.notify()

    def _run(self) -> None:
        # one piece at a time, so that a more urgent job waits for a piece at most
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                # the most urgent one; jobs wait between their pieces
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
        except Exception as problem:  # whatever it is, the page says it and lives on
            error = problem
        with self._changed:
            # a job that was replaced says nothing
            told = wanted()
            if told:
                del self._jobs[name]
        if told:
            self._ended(error)
