"""Files: paths, reading, and writing of whole files only."""

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
"""Path under which a command reads its standard input, and which errors name."""
NAMED = 5
"""Greatest number of items that a message lists by name."""
GIVEN: ContextVar[bytes | None] = ContextVar("GIVEN", default=None)
"""Content of standard input; None where nothing was read from it, as outside of commands."""


def user_path(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return a path; one that begins with ~ is in the user's home.

    **Arguments:** `name`: the argument's name, for the error.

    **Raises:** `ValueError` for values that are no path.
    """
    text = os.fspath(path) if isinstance(path, os.PathLike) else path
    # 4096 is Linux's PATH_MAX; a longer path would fail later with an error that names no argument
    good = isinstance(text, str) and len(text) <= 4096 and "\0" not in text
    require(good, name, "be a path", path)
    return Path(os.path.expanduser(text))


def check_file(path: Path) -> None:
    """Raise `OSError` where there is no file, and `ValueError` for other things, such as a device or a pipe."""
    if not path.exists():
        raise FileNotFoundError(f"No such file: {path}")
    if not path.is_file():
        raise ValueError(f"{path} must be a file, but is a folder, a device or a pipe.")


def content_of(path: Path) -> bytes:
    """Return the content of a file, or of standard input if it was read; raises as `check_file`."""
    given = GIVEN.get()
    if given is not None and path == STANDARD_INPUT:
        return given
    check_file(path)
    return path.read_bytes()


def read_standard_input() -> Path:
    """Read standard input, and return the path at which `content_of` finds it in this context.

    **Raises:** `ValueError` where standard input was read before.
    """
    if GIVEN.get() is not None:
        raise ValueError("Standard input, -, must stand for one file only.")
    GIVEN.set(sys.stdin.buffer.read())
    return STANDARD_INPUT


@contextmanager
def readable(path: object, kind: str) -> Iterator[None]:
    """Turn all errors of a `with` block, in which another package reads a file, into one `ValueError`.

    Other packages raise errors of many classes for damaged files.

    **Arguments:** `kind`: what the file should be, as in "netCDF file".

    **Raises:** `ValueError` that names the file.
    """
    try:
        yield
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"{path} is no {kind} that can be read: {text}") from None


def write_whole(path: Path, content: Content) -> None:
    """Write a file under a temporary name in its folder, and rename it when all content is on the disk.

    After a full disk, an interrupt or a lost process an earlier file is unchanged, and programs that have the earlier
    file open continue to read it. A killed process may leave a file `.NAME.RANDOM.part`.

    **Raises:** `OSError` where the file cannot be written; then no new file is left.
    """
    path = Path(os.path.realpath(user_path(path)))  # the target of a link, not the link
    exists = path.exists()
    if exists and not os.access(path, os.W_OK):
        raise PermissionError(f"{path} is protected against writing")
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        # mode "x" refuses an existing name, and so also a link that another user has made there
        with open(part, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        # the permissions of the replaced file
        if exists:
            os.chmod(part, path.stat().st_mode & 0o7777)
        os.replace(part, path)
    # Ctrl-C is no `Exception`, and must also leave no part of a file
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_each(contents: Mapping[Path, Callable[[], Content]]) -> str:
    """Write several whole files, each also where others cannot be written.

    **Arguments:** `contents`: functions that make the content, by path.

    **Returns:** a text that names the written files: "wrote a.nc and b.png".

    **Raises:** `OSError` that names the files which could not be written, after all other files were written.
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
    """Return the first names joined, with the number of further names: "a, b and 7 more"."""
    more = len(names) - NAMED
    return listed(names[:NAMED] + [f"{more} more"] * (more > 0))


def table_lines(table: Sequence[Mapping[str, object]]) -> list[str]:
    """Return the lines of a Markdown table of rows with the same keys; none without rows."""
    if not table:
        return []
    heading = list(table[0])
    rows = [heading, ["---"] * len(heading), *(row.values() for row in table)]
    return ["| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in rows]
