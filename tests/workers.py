"""What plugins of pytest find in the processes of a run, brought together in the first one."""

from typing import Any

import pytest


class Gathered:
    """A plugin whose `book` gets the entries of all workers, by the name of the test first."""

    def __init__(self):
        self.book: dict[str, Any] = {}

    @property
    def _name(self) -> str:
        return type(self).__name__

    def pytest_sessionfinish(self, session):
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput[self._name] = self.book

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node):
        self.book.update(getattr(node, "workeroutput", {}).get(self._name, {}))
