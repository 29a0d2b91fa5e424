"""Calls that wait for the first dataset, because they import xarray, which takes long."""

from collections.abc import Callable

WAITING: list[Callable[[], object]] = []
"""What the first dataset calls, such as the registration of `ds.slipper`."""


def on_dataset() -> None:
    """Make the waiting calls, once; whatever makes a dataset calls this."""
    while WAITING:
        WAITING.pop()()
