"""Limits of memory and time: impossible runs are refused before they begin, very long ones warned of."""

import os

from .checks import warn

LONGEST = 365.25 * 86400
"""Estimated time [s] beyond which a run is refused: a year."""
LONG = 86400.0
"""Estimated time [s] beyond which a run gives a warning: a day."""


def available_memory() -> int | None:
    """Bytes of memory that can be had without swapping; None where the system does not tell."""
    try:
        with open("/proc/meminfo") as lines:
            return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def refuse_impossible(what: str, needed: float, seconds: float) -> None:
    """Refuses a run that needs more memory than there is or more than a year, and warns of one of more than a day.

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
    if seconds > LONG:
        warn(f"{costs}.")


def shown_bytes(count: float) -> str:
    """A size in bytes as text, with three digits at most."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} PB"


def shown_time(seconds: float) -> str:
    """A duration in words: "40 s", "2 min 5 s", "3 h 20 min", "5 days 3 h", "17 years"."""
    if seconds >= 2 * LONGEST:
        return f"{seconds / LONGEST:.3g} years"
    left, parts = round(seconds), []
    for unit, size in (("days", 86400), ("h", 3600), ("min", 60), ("s", 1)):
        count, below = divmod(left, size)
        if parts or count >= (2 if unit == "days" else 1):
            parts.append((count, unit))
            left = below
    return " ".join(f"{count} {unit}" for count, unit in parts[:2] if count) or "0 s"
