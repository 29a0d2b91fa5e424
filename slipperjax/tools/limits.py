"""Limits of memory and time: impossible runs are refused before they begin, and very long runs give a warning."""

import os
from collections.abc import Iterator
from pathlib import Path

from .checks import warn

LONGEST = 365.25 * 86400
"""Estimated time [s] beyond which a run is refused: a year."""


def available_memory(root: Path = Path("/")) -> int | None:
    """Return the bytes of memory that are available without swapping, within the limit of a container; None where the
    system does not report them.

    **Arguments:** `root`: where the files of Linux are.
    """
    try:
        with open(root / "proc/meminfo") as lines:
            free = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))
            return min(free, *_free_in_groups(root), free)
    except (OSError, StopIteration, ValueError):
        pass
    # not on Linux: the whole memory
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _free_in_groups(root: Path) -> Iterator[int]:
    """Yield the memory [bytes] that each limit of the process's control groups leaves, for both their versions."""
    try:
        groups = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    for group in groups:
        _, controllers, path = group.split(":", 2)
        if not controllers:
            base, limits, usage, cache = "", ("memory.max", "memory.high"), "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            base, limits, usage = "memory", ("memory.limit_in_bytes",), "memory.usage_in_bytes"
            cache = "total_inactive_file"
        else:
            continue
        base = root / "sys/fs/cgroup" / base
        own = base / path.lstrip("/")
        # limits of the groups above also hold; a container sees its own group as the base
        for folder in (one for one in (own, *own.parents) if one.is_relative_to(base)):
            for limit in limits:
                try:
                    # the system frees the memory of cached files
                    stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
                    used = int((folder / usage).read_text()) - int(stat[cache])
                    yield max(int((folder / limit).read_text()) - used, 0)
                except (OSError, ValueError, KeyError):
                    continue  # "max" is no limit


def cores() -> int:
    """Return the number of cores that this process may use."""
    # a scheduler may give a process fewer cores than the machine has; not all systems report this
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def refuse_impossible(what: str, needed: float, seconds: float) -> None:
    """Refuse a run that needs more memory than there is, or more than a year; warn of a run of more than a day.

    **Arguments:** `what`: the run in words, a plural; `needed`: memory of its result [bytes]; `seconds`: an estimate
    of its time.

    **Raises:** `ValueError` that names both.
    """
    available = available_memory()
    costs = f"{what} need about {shown_bytes(needed)} of memory and {shown_time(seconds)}"
    if available is not None and needed > available:
        raise ValueError(f"{costs}, but {shown_bytes(float(available))} of memory are available.")
    if seconds > LONGEST:
        raise ValueError(f"{costs}, which is more than a year.")
    if seconds > 86400:
        warn(f"{costs}.")


def shown_bytes(count: float) -> str:
    """Return a size in bytes as text, with three digits at most."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} PB"


def shown_time(seconds: float) -> str:
    """Return a duration as text, with three digits at most: "40 s", "2.08 min", "3.33 h", "5.2 days", "17 years"."""
    # a unit is used up to two of the next unit
    size = 1.0
    for unit, next_size in (("s", 60.0), ("min", 3600.0), ("h", 86400.0), ("days", LONGEST)):
        if seconds < 2 * next_size:
            return f"{seconds / size:.3g} {unit}"
        size = next_size
    return f"{seconds / size:.3g} years"
