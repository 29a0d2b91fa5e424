"""Counts what tests trace, lower and compile, and their processor time: `pytest --programs [FILE]`.

Counts are the same on every machine where nothing is kept; `--programs` therefore gives the run an empty cache.
"""

import csv
import os
from pathlib import Path

import pytest

from .workers import Gathered

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "traces",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowerings",
    "/jax/core/compile/backend_compile_duration": "compilings",
}
COLUMNS = (*EVENTS.values(), "seconds")
DEAREST = 20
"""Tests that are printed."""


def processor_time() -> float:
    """Seconds of this process and of those that it waited for."""
    return sum(os.times()[:4])


class Programs(Gathered):
    """A plugin that adds up what each test costs, with what was set up for it."""

    def __init__(self, file: str):
        super().__init__()
        self.file = Path(file) if file else None
        self.row: dict[str, float] = dict.fromkeys(COLUMNS, 0)

    def listen(self, event, duration, **_):
        if event in EVENTS:
            self.row[EVENTS[event]] += 1

    def pytest_sessionstart(self):
        import jax  # not before the cache is chosen

        jax.monitoring.register_event_duration_secs_listener(self.listen)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        row = self.row = self.book[item.nodeid] = dict.fromkeys(COLUMNS, 0)
        begun = processor_time()
        result = yield
        row["seconds"] = round(processor_time() - begun, 3)
        return result

    def pytest_terminal_summary(self, terminalreporter):
        ordered = sorted(self.book.items(), key=lambda pair: -pair[1]["seconds"])
        for test, row in ordered[:DEAREST]:
            counted = ", ".join(f"{row[column]} {column}" for column in EVENTS.values())
            terminalreporter.write_line(f"{row['seconds']:7.1f} s, {counted}: {test}")
        total = {column: sum(row[column] for row in self.book.values()) for column in COLUMNS}
        terminalreporter.write_line("all: " + ", ".join(f"{value:.0f} {column}" for column, value in total.items()))
        if self.file is not None:
            with self.file.open("w", newline="") as file:
                table = csv.writer(file)
                table.writerow(["test", *COLUMNS])
                table.writerows([test, *row.values()] for test, row in ordered)
