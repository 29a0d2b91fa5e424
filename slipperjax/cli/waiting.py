"""What a command waits for, where it has no progress of its own."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

from ..tools import TRACING

_WAITING: list[str] = []
"""What is to be said when a program is made, once."""


def _hear(event: str, **_: Any) -> None:
    if event == TRACING and _WAITING:
        print(_WAITING.pop(), file=sys.stderr, flush=True)


jax.monitoring.register_event_listener(_hear)


@contextmanager
def saying_compiling() -> Iterator[None]:
    """Says on standard error when a program is compiled, or taken from the cache, for the first time inside."""
    _WAITING[:] = ["compiling ..."]
    try:
        yield
    finally:
        _WAITING.clear()
