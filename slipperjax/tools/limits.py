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
            found = next(line for line in lines if line.startswith("MemAvailable"))
        return int(found.split()[1]) * 1024
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
    room = available_memory()
    costs = f"{what} need about {shown_bytes(needed)} of memory and {shown_time(seconds)}"
    if room is not None and needed > room:
        raise ValueError(f"{costs}, but {shown_bytes(float(room))} of memory are available.")
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
    whole = round(seconds)
    units = (("days", 86400), ("h", 3600), ("min", 60), ("s", 1))
    for k, (name, size) in enumerate(units):
        if whole >= size * (2 if name == "days" else 1):
            parts = [(whole // size, name)]
            if k + 1 < len(units):
                below, its = units[k + 1]
                parts.append((whole % size // its, below))
            return " ".join(f"{n} {unit}" for n, unit in parts if n)
    return "0 s"
