"""Files: paths, what is read, and what is written whole or not at all."""

import os
import secrets
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from .checks import require

Content = bytes | memoryview
"""Content of a file."""
STANDARD_INPUT = Path("standard input")
"""Path at which the readers of a command find its standard input, and by which their errors name it."""
NAMED = 5
"""Most of many things that a message names."""
GIVEN: ContextVar[bytes | None] = ContextVar("GIVEN", default=None)
"""What was read from standard input; None where nothing was, as outside of commands."""


def user_path(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return a path; one that begins with ~ is in the user's home.

    **Arguments:** `name`: the argument's, for the error.

    **Raises:** `ValueError` for what is no path.
    """
    text = os.fspath(path) if isinstance(path, os.PathLike) else path
    # 4096 is Linux's PATH_MAX; a longer one would fail later, in words that name no argument
    good = isinstance(text, str) and len(text) <= 4096 and "\0" not in text
    require(good, name, "be a path", path)
    return Path(os.path.expanduser(text))


def check_file(path: Path) -> None:
    """Raise `OSError` where there is no file, and `ValueError` for another thing, such as a device or a pipe."""
    if not path.exists():
        raise FileNotFoundError(f"No such file: {path}")
    if not path.is_file():
        raise ValueError(f"{path} must be a file, but is a folder, a device or a pipe.")


def content_of(path: Path) -> bytes:
    """Return the content of a file, or of standard input where that was read; raises as `check_file`."""
    given = GIVEN.get()
    if given is not None and path == STANDARD_INPUT:
        return given
    check_file(path)
    return path.read_bytes()


def read_standard_input() -> Path:
    """Read standard input, and return the path at which `content_of` finds it in this context.

    **Raises:** `ValueError` where it was read before.
    """
    if GIVEN.get() is not None:
        raise ValueError("Standard input, -, must stand for one file only.")
    GIVEN.set(sys.stdin.buffer.read())
    return STANDARD_INPUT


@contextmanager
def readable(path: object, kind: str) -> Iterator[None]:
    """Turn all errors of a `with` block that reads a file by another package into one `ValueError`.

    Damaged files raise errors of many classes there.

    **Arguments:** `kind`: what the file should be, as in "netCDF file".

    **Raises:** `ValueError` that names the file.
    """
    try:
        yield
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"{path} is no {kind} that can be read: {text}") from None


def write_whole(path: Path, content: Content) -> None:
    """Write a file under a temporary name in its folder, and move it into place when all of it is on the disk.

    So a full disk, an interrupt or a lost process leaves a file that was there before as it was, and programs that
    have it open keep reading what they opened. A killed process may leave a file `.NAME.RANDOM.part`.

    **Raises:** `OSError` where the file cannot be written; then nothing is left behind.
    """
    path = Path(os.path.realpath(user_path(path)))  # the file that a link leads to, not the link
    exists = path.exists()
    if exists and not os.access(path, os.W_OK):
        raise PermissionError(f"{path} is protected against writing")
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        # "x" refuses a name that exists, and so a link that somebody else has put there
        with open(part, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        # the permissions of the file that it replaces
        if exists:
            os.chmod(part, path.stat().st_mode & 0o7777)
        os.replace(part, path)
    # Ctrl-C is no `Exception`, and leaves no part either
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_each(contents: Mapping[Path, Callable[[], Content]]) -> str:
    """Write several files whole, each whether or not the others can be written.

    **Arguments:** `contents`: by path, functions that make the content.

    **Returns:** what was written, in words: "wrote a.nc and b.png".

    **Raises:** `OSError` that names the files which could not be written, after all others were written.
    """
    done = []
    failures = []
    for path, make in contents.items():
        content = make()
        try:
            write_whole(path, content)
            done.append(str(path))
        except OSError as error:
            failures.append(f"cannot write {path}: {error.strerror or error}")
    said = [f"wrote {listed(done)}"] if done else []
    if failures:
        raise OSError("; ".join(failures + said))
    return "".join(said)


def listed(names: list[str]) -> str:
    """Return names joined: "a, b and c"."""
    first = ", ".join(names[:-1])
    return " and ".join([first, *names[-1:]] if first else names)


def first_ones(names: list[str]) -> str:
    """Return the first names joined, and how many there are beside: "a, b and 7 more"."""
    more = len(names) - NAMED
    return listed(names[:NAMED] + [f"{more} more"] * (more > 0))


def table_lines(table: Sequence[Mapping[str, object]]) -> list[str]:
    """Return the lines of a Markdown table of rows with the same keys; none without rows."""
    if not table:
        return []
    heading = list(table[0])
    rows = [heading, ["---"] * len(heading), *(row.values() for row in table)]
    return ["| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in rows]
