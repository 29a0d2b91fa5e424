"""What a command waits for, where it has no progress of its own."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax

from ..tools.compile import TRACING
from ..tools.programs import LOADING

_WAITING: list[str] = []
"""What is to be said when a program is made, once."""


def _hear(event: str, **_: Any) -> None:
    if event == TRACING and _WAITING:
        print(_WAITING.pop(), file=sys.stderr, flush=True)
    if event == LOADING:
        _call_beside()


jax.monitoring.register_event_listener(_hear)


_LARGE = 0.1
"""Seconds that it takes to lower a program which then takes seconds to compile."""
_BESIDE: list[Callable[[], None]] = []
"""What is to be called beside compiling or loading, once."""


def _call_beside() -> None:
    if _BESIDE:
        threading.Thread(target=_BESIDE.pop()).start()


def _hear_duration(event: str, seconds: float, **_: Any) -> None:
    if event == "/jax/core/compile/jaxpr_to_mlir_module_duration" and seconds > _LARGE:
        _call_beside()


jax.monitoring.register_event_duration_secs_listener(_hear_duration)


def while_compiling(call: Callable[[], None]) -> None:
    """Calls something on a thread of its own while the next large program is compiled, or one is loaded."""
    _BESIDE[:] = [call]


@contextmanager
def saying_compiling() -> Iterator[None]:
    """Says on standard error when a program is compiled, or taken from the cache, for the first time inside."""
    _WAITING[:] = ["compiling ..."]
    try:
        yield
    finally:
        _WAITING.clear()
