"""Work and words beside the compiling of large programs."""

import threading
from collections.abc import Callable
from typing import Any

import jax

_LARGE = 0.1
"""Seconds that it takes to lower a program which then takes seconds to compile."""
_PATIENCE = 1.0
"""Seconds after which compiling is said; a program of the cache is loaded sooner."""
_BESIDE: list[Callable[[], None]] = []
"""What is to be called beside compiling or loading, once."""


def _hear(event: str, seconds: float, **_: Any) -> None:
    if event == "/jax/core/compile/jaxpr_to_mlir_module_duration" and seconds > _LARGE:
        while _BESIDE:
            threading.Thread(target=_BESIDE.pop()).start()


jax.monitoring.register_event_duration_secs_listener(_hear)


def while_compiling(call: Callable[[], None]) -> None:
    """Calls something on a thread of its own while the next large program is compiled or loaded."""
    _BESIDE.append(call)
