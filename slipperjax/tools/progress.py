"""Progress bars."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from .checks import yes_or_no
from .notices import NOTICES, CompileNotices

if TYPE_CHECKING:
    from tqdm import tqdm


DELAY = 1.0
"""Time [s] after which a bar appears that nobody asked for, or that may be unnecessary; at once if it compiles."""
LONGEST_SILENCE = 60.0
"""Time [s] after which a bar in a file or pipe is written again without progress."""


def is_live() -> bool:
    """Return whether standard error shows a bar that changes: on a terminal, or in a notebook."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def bar(
    wanted: bool | None, *, programs: int = 1, meanwhile: Callable[[], object] | None = None, **options: Any
) -> "Iterator[tqdm]":
    """Show tqdm's bar, with its `options`; in files and pipes a line every 10 s at most, every minute at least.

    The bar shows when a program that steps through time is being compiled.

    **Arguments:** `wanted`: whether the bar is shown; None shows it on terminals and in notebooks until it has ended;
    `programs`: number of programs that the run is expected to compile; `meanwhile`: called when the first program
    begins, also where no bar is shown.

    **Raises:** `ValueError` for another `wanted`.
    """
    from tqdm import tqdm  # here, because importing it takes time

    live = is_live()
    lines = _Lines()
    shown: dict[str, Any] = dict(mininterval=0.25, dynamic_ncols=True) if live else dict(mininterval=10.0, file=lines)
    if wanted is None and live:
        shown |= dict(leave=False, delay=DELAY)
    elif wanted is None or not yes_or_no("progress", wanted):
        shown |= dict(disable=True)
    name = options.pop("desc", "")
    colon = ": " if "bar_format" in options else ""  # tqdm's own format adds the colon

    def described(*parts: str) -> str:
        text = ", ".join(part for part in parts if part)
        return text and text + colon

    def show(notice: str) -> None:
        if progress.disable:
            return
        progress.delay = 0  # tqdm removes a bar at the end only after its delay
        progress.set_description_str(described(name, notice))

    with tqdm(desc=described(name), **(shown | options)) as progress:
        if progress.disable and meanwhile is None:  # an enclosing bar shows the notices
            yield progress
            return
        token = NOTICES.set(CompileNotices(programs, show, meanwhile or (lambda: None)))
        try:
            with nullcontext() if live or progress.disable else lines.kept_up(progress):
                yield progress
        finally:
            NOTICES.reset(token)


class _Lines:
    """Standard error for a bar in files and pipes, where each state of the bar gets its own line."""

    def __init__(self):
        self.written = time.monotonic()

    def write(self, text: str) -> None:
        self.written = time.monotonic()
        sys.stderr.write(text.replace("\r", "\n"))

    @contextmanager
    def kept_up(self, progress: "tqdm") -> Iterator[None]:
        """Write a bar's state after each `LONGEST_SILENCE` by another thread, as this one may compile for minutes."""
        ended = threading.Event()
        left = lambda: self.written + LONGEST_SILENCE - time.monotonic()

        def watch() -> None:
            while not ended.wait(max(left(), 0.0)):
                if left() <= 0:
                    progress.refresh()

        thread = threading.Thread(target=watch, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def flush(self) -> None:
        sys.stderr.flush()
