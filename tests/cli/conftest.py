"""Functions of the rooms below replaced, and signals as a terminal sends them."""

import contextlib
import signal
from unittest import mock

import pytest


@pytest.fixture
def replaced():
    """Replaces a function or method by a mock that takes the same arguments: `replaced("room.module.name", ...)`."""
    with contextlib.ExitStack() as stack:
        yield lambda place, *new, **how: stack.enter_context(
            mock.patch(f"slipperjax.{place}", *new, **({} if new else dict(autospec=True, **how)))
        )


@pytest.fixture
def python_s_own_interrupts():
    """Interrupts that reach this process as those of a terminal do, whatever started it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
