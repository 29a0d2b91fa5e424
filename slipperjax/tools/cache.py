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
    """The cache of compiled programs cannot be used; programs are compiled in each process."""


class Chosen:
    """The folder in which this process keeps its programs whole; until it is chosen, that of the user."""

    path: Path | None = None
    is_known = False
    lock = threading.Lock()


def compile_cache(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Keep all compiled programs on disk from here on, those of your own `jax.jit`, too: call it once, at the start.

    Without this call the package keeps the programs of its own functions, in the same folder, and finds them again
    before JAX traces them; JAX's cache, which this call switches on, keeps the work of XLA for all others. The
    command line calls it. Several processes may share a folder. Its programs are executed, so that it must belong to
    the user, and nobody else may write there.

    **Arguments:** `folder`: by default that of the environment variable `SLIPPERJAX_CACHE`, which may also be "off",
    or else the user's cache folder (on Linux ~/.cache/slipperjax).

    **Returns:** the folder of programs for this kind of processor. None where the cache is off, or where the folder
    cannot be used, which gives one `CacheWarning`. A cache folder that JAX has already (`jax_compilation_cache_dir`)
    stays.
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
    """Return the folder in which this process keeps its programs whole; None where it keeps none."""
    if not Chosen.is_known:
        with Chosen.lock:
            if not Chosen.is_known:
                root = _root(None)
                path = None
                # a folder that cannot be used: all programs are compiled
                with contextlib.suppress(OSError):
                    path = None if root is None else _opened(root)
                Chosen.path = path
                Chosen.is_known = True
    return Chosen.path


def keep_in(path: Path | None) -> None:
    """Keep programs whole in a folder of `compile_cache` from here on; None: nowhere."""
    with Chosen.lock:
        Chosen.path = path
        Chosen.is_known = True


def _root(folder: str | os.PathLike[str] | None) -> Path | None:
    """Return the folder that is asked for, by default that of the environment or the user's; None where it is off."""
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
    """Switch on JAX's cache in a folder of `compile_cache`, from here on."""
    silence_loader()
    # an entry that cannot be read or written is compiled, of which JAX would warn each time
    warnings.filterwarnings(
        "ignore",
        message="Error (reading|writing) persistent compilation cache entry",
    )
    # all programs, small ones, too
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_compilation_cache_dir", str(place))


def silence_loader() -> None:
    """Silence XLA's log, whose loader of programs logs errors that are none."""
    # On processors with AVX-512, XLA logs an error for each program that it takes from the cache, and takes it all
    # the same (jax #38445). The first line silences XLA's log. The second restores Python's loggers, but XLA's log
    # only to a level that the user has chosen: the default leaves it as it is.
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
    """When it was used last [s since 1970]."""
    size: int
    """Bytes."""
    path: Path


def entries(place: Path) -> list[Entry]:
    """Return the files of a folder of programs, the one used last first."""
    found = []
    for path in place.iterdir():
        # another process may delete one
        with contextlib.suppress(FileNotFoundError):
            status = path.stat()
            # many disks do not keep the time of the last reading: then that of writing counts
            found.append(Entry(max(status.st_mtime, status.st_atime), status.st_size, path))
    return sorted(found, reverse=True)


def _prune(place: Path, most: float = 1e9) -> None:
    """Delete empty entries, as crashes leave them, and the longest unused ones if all have more bytes than `most`.

    JAX's own limit, `jax_compilation_cache_max_size`, ends all writing after one entry whose time is missing (jax
    #39880), and lets threads wait for one another.
    """
    found = entries(place)
    is_full = sum(entry.size for entry in found) > most
    kept = 0
    # a full cache is emptied to three quarters
    for _, size, path in found:
        kept += size
        if size == 0 or (is_full and kept >= 0.75 * most):
            path.unlink(missing_ok=True)
