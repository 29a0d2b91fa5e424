"""Entry point of the command line, outside the package, whose import takes a second: Ctrl-C works then, too."""

import os
import signal
from typing import Any


def main() -> None:
    """Runs `slipperjax.cli.main`. Before and after it, signals end the process at once, without a word, and with the
    same exit codes."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # what the caller ignores, as nohup does, stays ignored
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _leave)
    from slipperjax.cli import main as command

    command()


def _leave(number: int, frame: Any) -> None:
    os._exit(128 + number)


if __name__ == "__main__":
    main()
