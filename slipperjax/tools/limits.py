"""Limits of memory and time: impossible runs are refused before they begin, very long ones warned of."""

import os

from .checks import warn

LONGEST = 365.25 * 86400
"""Estimated time [s] beyond which a run is refused: a year."""


def available_memory() -> int | None:
    """Return the bytes of memory that can be had without swapping; None where the system does not tell."""
    try:
        with open("/proc/meminfo") as lines:
            return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError):
        pass
    # not on Linux: all of the memory
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def cores() -> int:
    """Return the number of cores that this process may use."""
    # a scheduler may give a process fewer cores than there are; not all systems tell
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def refuse_impossible(what: str, needed: float, seconds: float) -> None:
    """Refuse a run that needs more memory than there is or more than a year; warn of one of more than a day.

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
    # a unit serves up to two of the next one
    size = 1.0
    for unit, next_size in (("s", 60.0), ("min", 3600.0), ("h", 86400.0), ("days", LONGEST)):
        if seconds < 2 * next_size:
            return f"{seconds / size:.3g} {unit}"
        size = next_size
    return f"{seconds / size:.3g} years"
