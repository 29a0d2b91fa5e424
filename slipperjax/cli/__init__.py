"""The command line: parse, call, write."""

import gc
import os
import sys
import warnings
from contextvars import copy_context

import click

from ..tools.checks import TOLD
from ..tools.tables import TableError
from . import cache, design, explore, fit, motions, new, runs, show, study, sweep  # noqa: F401  (each adds its commands)
from .interrupts import Signals, ignore_signals, leave
from .options import INTERRUPTED, WRONG, app as app


def _one_line(message, *_) -> None:
    """Print a warning in one line, as errors are printed."""
    print("warning: " + " ".join(str(message).split()), file=sys.stderr)


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit. The code is 0; 1 where no result means anything; 2, with a line on the problem, for an
    error; or after an interrupt 130 (Ctrl-C), 143 (`kill`) or 129 (a closed terminal).

    **Arguments:** `arguments`: of the command line; default the arguments of the process, which an interrupt then
    ends without waiting for its threads.
    """
    warnings.showwarning = _one_line
    if arguments is None:
        # keep modules from the garbage collector, and call it less often: a short run takes a fifth less time
        gc.freeze()
        gc.set_threshold(50_000)
        sweep.hide_dask()
        # pictures become files, for which matplotlib needs no screen
        os.environ["MPLBACKEND"] = "Agg"
    # an interrupt may raise here, or set its code while the command ends by itself
    with Signals() as signals:
        try:
            # in a context of its own, which keeps the warnings already given
            code = copy_context().run(_called, sys.argv[1:] if arguments is None else arguments, signals)
        except KeyboardInterrupt:
            code = INTERRUPTED
        if signals.code is not None or code == INTERRUPTED:
            if signals.code is not None:
                ignore_signals()
                code = signals.code
            print("interrupted", file=sys.stderr)
            # threads of XLA may still run, and cannot be stopped
            if arguments is None:
                leave(code)
    if arguments is None:
        gc.freeze()  # the process ends, so that nothing must be collected
    sys.exit(code)


def _called(arguments: list[str], signals: Signals) -> int:
    """Run a command and return its exit code; print its error in one line, or the faults of a table in a line each.

    Each kind of warning is printed once.
    """
    TOLD.set(set())
    try:
        # click returns the code, instead of ending the process
        code = app(args=arguments or ["--help"], prog_name="slipperjax", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.Abort:
        return INTERRUPTED
    except SystemExit:  # by click, where the reader of a pipe such as `head` has closed it
        return 0
    except Exception as error:
        usage = isinstance(error, click.ClickException)
        # errors that an interrupt causes are not reported
        if not usage and not isinstance(error, ValueError | OSError) and signals.code is None:
            raise
        text = error.format_message() if usage else str(error)
        print("error: " + (text if isinstance(error, TableError) else " ".join(text.split())), file=sys.stderr)
        return WRONG
