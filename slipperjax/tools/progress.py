"""Progress bars."""

import sys
from typing import Any

LIVE, IN_LINES = 0.25, 10.0
"""Least time between two states of a bar [s], on terminals and in notebooks, and where each is a line."""


def is_live() -> bool:
    """Tells whether standard error shows a bar that changes: on a terminal, or in a notebook."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


def bar(**options: Any) -> Any:
    """Returns tqdm's bar, with its `options`; in files and pipes it is now and then a line."""
    from tqdm import tqdm  # here, because importing it takes time

    live = is_live()
    shown: Any = dict(mininterval=LIVE, dynamic_ncols=True) if live else dict(mininterval=IN_LINES, file=_Lines())
    return tqdm(**shown, **options)


class _Lines:
    """Standard error for a bar in files and pipes, where each of its states gets a line of its own."""

    def write(self, text: str) -> None:
        sys.stderr.write(text.replace("\r", "\n"))

    def flush(self) -> None:
        sys.stderr.flush()
