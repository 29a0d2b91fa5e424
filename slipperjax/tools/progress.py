"""Progress bars."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .checks import yes_or_no
from .compile import PROGRAMS, Programs

LIVE, IN_LINES = 0.25, 10.0
"""Least time between two states of a bar [s], on terminals and in notebooks, and where each is a line."""
PATIENCE = 1.0
"""Time after which a bar appears that nobody asked for [s]; while a program is compiled at once."""


def is_live() -> bool:
    """Tells whether standard error shows a bar that changes: on a terminal, or in a notebook."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def bar(wanted: bool | None, *, programs: int = 1, **options: Any) -> Iterator[Any]:
    """Shows tqdm's bar, with its `options`; in files and pipes it is now and then a line.

    While a program that steps through time is compiled, it says so.

    **Arguments:** `wanted`: whether it is shown; None shows it on terminals and in notebooks until it has ended;
    `programs`: how many programs the run is expected to compile.

    **Raises:** `ValueError` for another `wanted`.
    """
    from tqdm import tqdm  # here, because importing it takes time

    live = is_live()
    shown: Any = dict(mininterval=LIVE, dynamic_ncols=True) if live else dict(mininterval=IN_LINES, file=_Lines())
    if wanted is None and live:
        shown |= dict(leave=False, delay=PATIENCE)
    elif wanted is None or not yes_or_no("progress", wanted):
        shown |= dict(disable=True)
    name = options.pop("desc", "")
    colon = ": " if "bar_format" in options else ""  # which tqdm's own format adds

    def described(*parts: str) -> str:
        text = ", ".join(part for part in parts if part)
        return text + colon if text else text

    def tell(text: str) -> None:
        progress.delay = 0  # what has been seen is wiped out at the end
        progress.set_description_str(described(name, text))

    with tqdm(desc=described(name), **shown, **options) as progress:
        # a bar that is not shown leaves the word to one around it
        token = None if progress.disable else PROGRAMS.set(Programs(programs, tell))
        try:
            yield progress
        finally:
            if token is not None:
                PROGRAMS.reset(token)


class _Lines:
    """Standard error for a bar in files and pipes, where each of its states gets a line of its own."""

    def write(self, text: str) -> None:
        sys.stderr.write(text.replace("\r", "\n"))

    def flush(self) -> None:
        sys.stderr.flush()
