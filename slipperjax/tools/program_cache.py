"""JAX's cache of compiled programs on disk, in the user's cache folder, so that a machine compiles a program once."""

import hashlib
import importlib
import os
import platform
import time
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import jax
import jaxlib
import platformdirs

from .programs import ENDING, PART, keep_in, whole_program

VARIABLE = "SLIPPERJAX_CACHE"
"""Environment variable: a folder for the cache, or "off"."""
OFF = ("off", "0", "no", "false")
MOST = 1 << 30
"""Bytes above which the entries that are longest unused are deleted, down to three quarters."""
SETTLED = 60.0
"""Age of an entry that no process is still writing [s]."""
CHECKED = "checked"
"""A file whose time says up to when entries are known to be whole."""
OF_JAX = "-cache"
"""Ending of JAX's own entries."""
ZSTANDARD = b"\x28\xb5\x2f\xfd"
"""First bytes of what zstandard compressed."""


class CacheWarning(UserWarning):
    """The cache of compiled programs cannot be used; programs are compiled in each process."""


def compile_cache(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Keeps compiled programs on disk from here on, and takes those that are there: call it once, at the start.

    The command line calls it; a notebook or a script may. Programs depend on the version of JAX and on the processor,
    so that each pair of them has a folder of its own. Several processes may share it.

    **Arguments:** `folder`: default that of the environment variable `SLIPPERJAX_CACHE`, which may also be "off", or
    the user's cache folder (on Linux ~/.cache/slipperjax).

    **Returns:** the folder of this version and processor, or None where the cache is off or cannot be used: that is
    one `CacheWarning` and no error. Where JAX has a cache folder already (`jax_compilation_cache_dir`), it stays.
    """
    asked = os.environ.get(VARIABLE, "") if folder is None else os.fspath(folder)
    if asked.lower() in OFF:
        return None
    if jax.config.jax_compilation_cache_dir:  # type: ignore[attr-defined]
        return Path(jax.config.jax_compilation_cache_dir)  # type: ignore[attr-defined]
    root = Path(asked).expanduser() if asked else Path(platformdirs.user_cache_dir("slipperjax"))
    place = root / f"jax-{jax.__version__}-{jaxlib.__version__}-{processor()}"
    try:
        place.mkdir(parents=True, exist_ok=True)
        _tidy(place)
    except OSError as error:
        text = f"compiled programs are not kept: {place} cannot be used as their cache ({error})"
        warnings.warn(text, CacheWarning, stacklevel=2)
        return None
    keep_programs(place)
    return place


def keep_programs(place: Path) -> None:
    """Keeps compiled programs in a folder of `compile_cache`, from here on."""
    # On processors with AVX-512 XLA logs an error for each program that it takes from the cache, and takes it all the
    # same (jax #38445). A level that was asked for stays; the second line gives Python's loggers back.
    level = jax.config.jax_logging_level  # type: ignore[attr-defined]
    jax.config.update("jax_logging_level", "CRITICAL")
    jax.config.update("jax_logging_level", level)
    # what cannot be read or written later is compiled; JAX would warn of each program
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache entry")
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_compilation_cache_dir", str(place))
    keep_in(place)


def processor() -> str:
    """The kind of processor: its architecture and a digest of what it can do."""
    features = platform.processor()
    try:
        with open("/proc/cpuinfo") as lines:
            named = [line for line in lines if line.startswith(("flags", "Features", "model name"))]
            features = "".join(dict.fromkeys(named)) or features
    except OSError:
        pass  # not Linux
    return f"{platform.machine()}-{hashlib.sha256(features.encode()).hexdigest()[:8]}"


def _tidy(place: Path) -> None:
    """Deletes entries that a killed process left incomplete, and the oldest where there are too many.

    Raises `OSError` where the folder cannot be written.
    """
    marker, now = place / CHECKED, time.time()
    begin = marker.stat().st_mtime if marker.exists() else 0.0
    kept = []
    for path in [path for path in place.iterdir() if path.name.endswith((OF_JAX, ENDING, PART))]:
        whole = whole_program if path.name.endswith(ENDING) else _whole  # nothing of a part is whole
        try:
            found = path.stat()
            if begin < found.st_mtime < now - SETTLED and not whole(path.read_bytes()):
                path.unlink(missing_ok=True)
            else:  # the time of access, where the file system has it
                kept.append((max(found.st_mtime, found.st_atime), found.st_size, path))
        except FileNotFoundError:
            pass  # another process deleted it
    total = sum(size for _, size, _ in kept)
    if total > MOST:
        for _, size, path in sorted(kept):
            path.unlink(missing_ok=True)
            total -= size
            if total < 0.75 * MOST:
                break
    marker.touch()
    os.utime(marker, (now - SETTLED, now - SETTLED))


def _whole(entry: bytes) -> bool:
    """Whether an entry decompresses: JAX writes zstandard where a module for it is installed, and zlib otherwise."""
    try:
        if entry[:4] == ZSTANDARD:
            return _zstandard()(entry) is not None
        unpacked = zlib.decompressobj()
        unpacked.decompress(entry)
        return unpacked.eof
    except Exception:  # each module has errors of its own
        return False


def _zstandard() -> Callable[[bytes], bytes]:
    """Python's own module, or the package; without both nobody can read the entry."""
    try:
        return importlib.import_module("compression.zstd").decompress
    except ImportError:
        return importlib.import_module("zstandard").decompress
