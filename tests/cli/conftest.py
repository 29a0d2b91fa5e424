"""Functions of the rooms below, replaced."""

import contextlib
from unittest import mock

import pytest


@pytest.fixture
def replaced():
    """Replaces a function or method by a mock that takes the same arguments: `replaced("room.module.name", ...)`."""
    with contextlib.ExitStack() as stack:
        yield lambda place, *new, **how: stack.enter_context(
            mock.patch(f"slipperjax.{place}", *new, **({} if new else dict(autospec=True, **how)))
        )
