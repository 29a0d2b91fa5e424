"""What a sweep will need, from its numbers of cases and periods."""

from ..tools import cores, refuse_impossible

SECONDS_PER_STEP = 4e-7
"""Time of a step of one case in a batch, on one core: measured 0.38 us, see the page on speed."""
LEAST_BYTES = 1000.0
"""Memory that a case takes at least: its scene, start, status and labels."""


def refuse_cases(count: int) -> None:
    """Refuses more cases than fit into memory, whatever is kept of them.

    **Raises:** `ValueError` that names memory and time.
    """
    # a forcing period of 50 steps is the least
    refuse_impossible(f"{count} cases", LEAST_BYTES * count, 50 * SECONDS_PER_STEP * count / cores())


def refuse_run(cases: int, periods: float, values: int, steps: float) -> None:
    """Refuses a run whose result does not fit into memory or that takes more than a year; see `refuse_impossible`.

    **Arguments:** `periods`: of one case, also for what takes as long; `values`: numbers that are kept of one case;
    `steps`: over all cases, the sum of their steps in one period.

    **Raises:** `ValueError` that names memory and time.
    """
    needed = 2 * 8.0 * values * cases + LEAST_BYTES * cases  # twice while it is put together and written
    seconds = SECONDS_PER_STEP * steps * periods / cores()
    refuse_impossible(f"{cases} cases of {periods:.3g} forcing periods", needed, seconds)
