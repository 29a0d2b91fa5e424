"""Notices on the progress bar of a run, while programs compile."""

import threading
from collections.abc import Callable
from contextvars import ContextVar

from .tracing import is_transformed


class CompileNotices:
    """Notices, for the progress bar of a run, that programs which step through time are being compiled."""

    def __init__(self, expected: int, show: Callable[[str], None], first: Callable[[], object] = lambda: None):
        """**Arguments:** `expected`: number of programs; `show`: called with each text, and at the end with "";
        `first`: called when the first program begins."""
        self.expected = expected
        self.show = show
        self.first = first
        self.begun = 0
        self.ended = 0
        self.threads: set[int] = set()
        self.lock = threading.Lock()

    def begin(self) -> None:
        """Show that this thread compiles a program; further calls before `end` change nothing."""
        thread = threading.get_ident()
        # several threads may compile at the same time
        with self.lock:
            if thread not in self.threads:
                self.threads.add(thread)
                self.begun += 1
                self._tell()
                if self.begun == 1:
                    self.first()

    def end(self) -> None:
        """Note that this thread runs a program, or has failed to compile it."""
        thread = threading.get_ident()
        with self.lock:
            if thread in self.threads:
                self.threads.remove(thread)
                self.ended += 1
                self._tell()

    def _tell(self) -> None:
        """Show which program the run waits for: of several that compile, the next one to be ready."""
        of = f"{self.ended + 1} of {max(self.begun, self.expected)}"
        self.show(f"compiling program {of}" if self.threads else "")


NOTICES: ContextVar[CompileNotices | None] = ContextVar("NOTICES", default=None)
"""Notices of the run in progress; None where no bar is shown."""


def note_compiling() -> None:
    """Show on the run's progress bar that JAX traces a program which steps through time."""
    notices = NOTICES.get()
    if notices is not None and is_transformed():
        notices.begin()
