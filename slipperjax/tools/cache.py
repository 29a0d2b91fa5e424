"""JAX's cache of compiled programs on disk, in the user's cache folder: a machine compiles a program once."""

import contextlib
import hashlib
import os
import platform
import shutil
import stat
import warnings
from pathlib import Path

import jax
import platformdirs

from .files import user_path


class CacheWarning(UserWarning):
    """The cache of compiled programs cannot be used; programs are compiled in each process."""


def compile_cache(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Keep compiled programs on disk from here on, and takes those that are there: call it once, at the start.

    The command line calls it; a notebook or a script may. Several processes may share a folder. What is in it is
    executed, so that it must belong to the user, and nobody else may write there.

    **Arguments:** `folder`: default that of the environment variable `SLIPPERJAX_CACHE`, which may also be "off", or
    the user's cache folder (on Linux ~/.cache/slipperjax).

    **Returns:** the folder of programs for this kind of processor, or None where the cache is off or cannot be used:
    that is one `CacheWarning` and no error. Where JAX has a cache folder already (`jax_compilation_cache_dir`), it
    stays.
    """
    chosen = os.environ.get("SLIPPERJAX_CACHE", "") if folder is None else str(user_path(folder, "folder"))
    if chosen.lower() == "off":
        return None
    if jax.config.jax_compilation_cache_dir:  # type: ignore[attr-defined]
        return Path(jax.config.jax_compilation_cache_dir)  # type: ignore[attr-defined]
    root = Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("slipperjax"))
    place = root / _processor()
    try:
        for path in (root, place):
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
            _refuse_others(path)
        _prune(place)
        # JAX never replaces an entry that a full disk has cut short
        if shutil.disk_usage(place).free < 64e6:
            raise OSError(f"the disk of {place} is full")
    except OSError as error:
        warnings.warn(f"compiled programs are not kept: {error}", CacheWarning, stacklevel=2)
        return None
    keep_programs(place)
    return place


def keep_programs(place: Path) -> None:
    """Keep compiled programs in a folder of `compile_cache`, from here on."""
    # On processors with AVX-512 XLA logs an error for each program that it takes from the cache, and takes it all the
    # same (jax #38445). A level that was asked for stays; the second line gives Python's loggers back.
    level = jax.config.jax_logging_level  # type: ignore[attr-defined]
    jax.config.update("jax_logging_level", "CRITICAL")
    jax.config.update("jax_logging_level", level)
    # what cannot be read or written later is compiled; JAX would warn of each program
    warnings.filterwarnings(
        "ignore",
        message="Error (reading|writing) persistent compilation cache entry",
    )
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_compilation_cache_dir", str(place))


def _processor() -> str:
    """Return the architecture and a digest of the processor's features, which JAX's names of entries lack."""
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


def _prune(place: Path, most: float = 1e9) -> None:
    """Delete the entries that are longest unused where there are more bytes than `most`, and empty ones, as crashes
    leave them.

    JAX's own limit, `jax_compilation_cache_max_size`, ends all writing after one entry whose time is missing (jax
    #39880), and lets threads wait for one another.
    """
    entries = []
    for path in place.iterdir():
        status = path.stat()
        entries.append((max(status.st_mtime, status.st_atime), status.st_size, path))
    is_full = sum(size for _, size, _ in entries) > most
    kept = 0
    # from the entry used last; a full cache is emptied to three quarters
    for _, size, path in sorted(entries, reverse=True):
        kept += size
        if size == 0 or (is_full and kept >= 0.75 * most):
            path.unlink(missing_ok=True)
