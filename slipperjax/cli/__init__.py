"""The command line: parse, call, write."""

import sys
import warnings

from .commands import app as app


def _one_line(message, category, filename, lineno, file=None, line=None) -> None:
    """Shows a warning as the command line shows errors."""
    print("warning: " + " ".join(str(message).split()), file=sys.stderr)


INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit code 0, 1 where nothing finite came out, 2 with one line that says what is wrong, or 130
    after an interrupt.

    **Arguments:** `arguments`: of the command line; default those of the process.
    """
    warnings.showwarning = _one_line
    try:
        code = app(args=arguments, standalone_mode=False)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Exception as error:
        usage = hasattr(error, "format_message")
        if not usage and not isinstance(error, ValueError | OSError):
            raise
        text = error.format_message() if usage else str(error)  # type: ignore[union-attr]
        print("error: " + " ".join(text.split()), file=sys.stderr)
        sys.exit(2)
    if code == INTERRUPTED:  # typer returns this for an interrupt during a command
        print("interrupted", file=sys.stderr)
    sys.exit(code if isinstance(code, int) else 0)
