"""The folder of compiled programs, in the user's cache folder: a machine compiles a program once."""

import contextlib
import hashlib
import os
import platform
import shutil
import stat
import threading
import warnings
from pathlib import Path
from typing import NamedTuple

import jax
import platformdirs

from .files import user_path

WHOLE, OF_JAX = "-whole", "-cache"
"""Endings of the files of programs: those that are kept whole, and those of JAX's cache."""


class CacheWarning(UserWarning):
    """The cache of compiled programs cannot be used; each process compiles its programs."""


class Chosen:
    """The folder in which this process keeps whole programs; the user's cache folder until another one is chosen."""

    path: Path | None = None
    is_known = False
    lock = threading.Lock()


def compile_cache(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Keep all compiled programs on disk from this call on, also programs of your own `jax.jit`. Call it once, first.

    Without this call the package keeps only the programs of its own functions, in the same folder, and finds them
    before JAX traces them. This call also switches on JAX's cache, which saves XLA's work for all other programs. The
    command line makes this call. Several processes may share a folder. Programs in the folder are executed, so that
    the folder must belong to the user, and nobody else may write there.

    **Arguments:** `folder`: by default the environment variable `SLIPPERJAX_CACHE`, which may also be "off", or else
    the user's cache folder (on Linux ~/.cache/slipperjax).

    **Returns:** the folder of programs for this kind of processor. None where the cache is off, or where the folder
    cannot be used; the latter gives one `CacheWarning`. A cache folder that JAX already has
    (`jax_compilation_cache_dir`) stays in use.
    """
    root = _root(folder)
    if root is None:
        return None
    if jax.config.jax_compilation_cache_dir:
        return Path(jax.config.jax_compilation_cache_dir)
    try:
        place = _opened(root)
    except OSError as error:
        warnings.warn(f"compiled programs are not kept: {error}", CacheWarning, stacklevel=2)
        keep_in(None)
        return None
    keep_in(place)
    keep_programs(place)
    return place


def kept_folder() -> Path | None:
    """Return the folder in which this process keeps whole programs; None where it keeps none."""
    with Chosen.lock:
        if not Chosen.is_known:
            root = _root(None)
            # a folder that cannot be used: all programs are compiled
            with contextlib.suppress(OSError):
                Chosen.path = None if root is None else _opened(root)
            Chosen.is_known = True
        return Chosen.path


def keep_in(path: Path | None) -> None:
    """Keep whole programs in a folder of `compile_cache` from this call on; None: nowhere."""
    with Chosen.lock:
        Chosen.path = path
        Chosen.is_known = True


def _root(folder: str | os.PathLike[str] | None) -> Path | None:
    """Return the given folder, by default the environment's or the user's; None where the cache is off."""
    chosen = os.environ.get("SLIPPERJAX_CACHE", "") if folder is None else str(user_path(folder, "folder"))
    if chosen.lower() == "off":
        return None
    return Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("slipperjax"))


def _opened(root: Path) -> Path:
    """Return the folder below `root` for this kind of processor, made and pruned.

    Programs use all instructions of the processor that compiled them.

    **Raises:** `OSError` where it cannot be used.
    """
    place = root / _processor()
    for path in (root, place):
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        _refuse_others(path)
    _prune(place)
    # JAX never replaces an entry that a full disk has cut short
    if shutil.disk_usage(place).free < 64e6:
        raise OSError(f"the disk of {place} is full")
    return place


def keep_programs(place: Path) -> None:
    """Switch on JAX's cache in a folder of `compile_cache`, from this call on."""
    silence_loader()
    # a program whose entry cannot be read or written is compiled; without this line JAX would warn each time
    warnings.filterwarnings(
        "ignore",
        message="Error (reading|writing) persistent compilation cache entry",
    )
    # all programs, also small ones
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_compilation_cache_dir", str(place))


def silence_loader() -> None:
    """Silence XLA's log: the part of XLA that loads programs logs false errors."""
    # On processors with AVX-512, XLA logs an error for each program that it takes from the cache, but uses the
    # program (jax #38445). The first line silences XLA's log. The second line restores Python's loggers. XLA's log
    # gets a level back only where the user has chosen one.
    level = jax.config.jax_logging_level
    jax.config.update("jax_logging_level", "CRITICAL")
    jax.config.update("jax_logging_level", level)


def _processor() -> str:
    """Return a folder's name for this kind of processor; JAX names entries without its features."""
    features = platform.processor()
    with contextlib.suppress(OSError), open("/proc/cpuinfo") as lines:  # Linux
        of_kind = {line for line in lines if line.startswith(("flags", "Features", "model name"))}
        features += "".join(sorted(of_kind))
    digest = hashlib.sha256(features.encode()).hexdigest()
    return f"{platform.machine()}-{digest[:8]}"


def _refuse_others(path: Path) -> None:
    """Raise `PermissionError` where a folder belongs to somebody else, or others can write there."""
    status = path.stat()
    others_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or others_write):
        raise PermissionError(f"{path} must belong to you, and nobody else may write there")


class Entry(NamedTuple):
    """A file of the cache."""

    used: float
    """Time of the last use [s since 1970]."""
    size: int
    """Bytes."""
    path: Path


def entries(place: Path) -> list[Entry]:
    """Return the files of a folder of programs, the last used file first."""
    found = []
    for path in place.iterdir():
        # another process may delete a file
        with contextlib.suppress(FileNotFoundError):
            status = path.stat()
            # many disks do not record the time of reading; then the time of writing counts
            found.append(Entry(max(status.st_mtime, status.st_atime), status.st_size, path))
    return sorted(found, reverse=True)


def _prune(place: Path, most: float = 1e9) -> None:
    """Delete the empty entries that crashes leave, and, above `most` bytes in all, the entries unused for longest.

    JAX's own limit, `jax_compilation_cache_max_size`, stops all writing where the time of one entry is missing (jax
    #39880), and makes threads wait for each other.
    """
    found = entries(place)
    is_full = sum(entry.size for entry in found) > most
    kept = 0
    # a full cache is emptied to three quarters
    for _, size, path in found:
        kept += size
        if size == 0 or (is_full and kept >= 0.75 * most):
            path.unlink(missing_ok=True)
