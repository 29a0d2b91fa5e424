"""The command line: parse, call, write."""

import gc
import sys
import warnings

import click

from . import design, explore, motions, runs, study, sweep  # noqa: F401  (each adds its commands)
from .interrupts import Signals, ignore_signals, leave
from .options import INTERRUPTED, WRONG, app as app


def _one_line(message, category, filename, lineno, file=None, line=None) -> None:
    """Show a warning as the command line shows errors."""
    print("warning: " + " ".join(str(message).split()), file=sys.stderr)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit code 0, 1 where nothing finite came out, 2 with one line that says what is wrong, or after an
    interrupt 130 (Ctrl-C), 143 (`kill`) or 129 (a terminal that was closed).

    **Arguments:** `arguments`: of the command line; default those of the process, which an interrupt then ends
    without waiting for its threads.
    """
    warnings.showwarning = _one_line
    if arguments is None:
        # modules are no garbage, and a command makes little: a short run takes a fifth less time
        gc.freeze()
        gc.set_threshold(50_000)
    with Signals() as signals:
        try:
            code = _called(sys.argv[1:] if arguments is None else arguments, signals)
        except KeyboardInterrupt:
            code = INTERRUPTED
        if signals.code is not None or code == INTERRUPTED:
            if signals.code is not None:
                ignore_signals()
                code = signals.code
            print("interrupted", file=sys.stderr)
            if arguments is None:
                leave(code)
    if arguments is None:
        gc.freeze()  # nor is what is left at the end
    sys.exit(code)


def _called(arguments: list[str], signals: Signals) -> int:
    """Return the exit code of a command; print what is wrong with it."""
    try:
        code = app(args=arguments or ["--help"], prog_name="slipperjax", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.Abort:
        return INTERRUPTED
    except SystemExit:  # by click, where the reader of a pipe such as `head` wants no more
        return 0
    except Exception as error:
        usage = isinstance(error, click.ClickException)
        # what an interrupt breaks on its way is no error of its own
        if not usage and not isinstance(error, ValueError | OSError) and signals.code is None:
            raise
        text = error.format_message() if usage else str(error)
        print("error: " + " ".join(text.split()), file=sys.stderr)
        return WRONG
