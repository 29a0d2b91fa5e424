"""Progress bars."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from .checks import yes_or_no
from .notices import NOTICES, CompileNotices

if TYPE_CHECKING:
    from tqdm import tqdm


def is_live() -> bool:
    """Tell whether standard error shows a bar that changes: on a terminal, or in a notebook."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def bar(wanted: bool | None, *, programs: int = 1, **options: Any) -> "Iterator[tqdm]":
    """Show tqdm's bar, with its `options`; in files and pipes, a line every ten seconds at most.

    It tells when a program that steps through time is being compiled.

    **Arguments:** `wanted`: whether it is shown; None shows it on terminals and in notebooks until it has ended;
    `programs`: how many programs the run is expected to compile.

    **Raises:** `ValueError` for another `wanted`.
    """
    from tqdm import tqdm  # here, because importing it takes time

    live = is_live()
    shown = dict(mininterval=0.25, dynamic_ncols=True) if live else dict(mininterval=10.0, file=_Lines())
    if wanted is None and live:
        # a bar that nobody asked for appears after a second, or while a program is compiled
        shown |= dict(leave=False, delay=1.0)
    elif wanted is None or not yes_or_no("progress", wanted):
        shown |= dict(disable=True)
    name = options.pop("desc", "")
    colon = ": " if "bar_format" in options else ""  # which tqdm's own format adds

    def described(*parts: str) -> str:
        text = ", ".join(part for part in parts if part)
        return text and text + colon

    def show(notice: str) -> None:
        progress.delay = 0  # tqdm wipes a bar out at the end only if its delay is over
        progress.set_description_str(described(name, notice))

    with tqdm(desc=described(name), **shown, **options) as progress:
        if progress.disable:  # a bar around it shows the notices
            yield progress
            return
        token = NOTICES.set(CompileNotices(programs, show))
        try:
            yield progress
        finally:
            NOTICES.reset(token)


class _Lines:
    """Standard error for a bar in files and pipes, where each of its states gets a line of its own."""

    def write(self, text: str) -> None:
        sys.stderr.write(text.replace("\r", "\n"))

    def flush(self) -> None:
        sys.stderr.flush()
