"""The command `slipperjax`, which answers signals while the package is imported.

That takes seconds, and this module is not a part of the package because its parts import the whole.
"""

import os
import signal
from types import FrameType


def main() -> None:
    """Entry point; see `slipperjax.cli.main`."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # what the caller ignores, as for a job in the background, stays ignored
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _leave)
    from slipperjax.cli import main as command

    command()


def _leave(number: int, frame: FrameType | None) -> None:
    """Ends the process at once: nothing is begun yet, and an exception may be lost in a half imported module."""
    os.write(2, b"interrupted\n")
    os._exit(128 + number)
