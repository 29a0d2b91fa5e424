"""Counts what tests trace, lower and compile, and their processor time: `pytest --programs [FILE]`.

Nothing is kept from runs before: `--programs` gives the run an empty cache. A run of all default tests fails where
they lower more programs than `BUDGET`: then let a new test use a program of another, or mark it `full`.
"""

import csv
import os
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from .workers import Gathered

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "traces",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowerings",
    "/jax/core/compile/backend_compile_duration": "compilings",
}
COLUMNS = (*EVENTS.values(), "seconds")
DEAREST = 20
"""Tests and programs that are printed."""
BUDGET = 2_500
"""Programs that the default tests may lower, in two workers, with those of single operations.

Two workers lower a program twice where its tests fall to both: 2,083 and 2,299 were counted for the same tests."""


def processor_time() -> float:
    """Seconds of this process and of those that it waited for."""
    return sum(os.times()[:4])


class Programs(Gathered):
    """A plugin that adds up what each test costs, with what was set up for it."""

    def __init__(self, file: str, budget: float):
        super().__init__()
        self.file = Path(file) if file else None
        self.budget = budget
        self.row: dict[str, Any] = self._empty()

    def _empty(self):
        return dict.fromkeys(COLUMNS, 0) | {"programs": {}}

    def listen(self, event, duration, fun_name="", **_):
        if event not in EVENTS:
            return
        self.row[EVENTS[event]] += 1
        seconds = self.row["programs"]
        name = fun_name.removeprefix("jit(").removesuffix(")")
        seconds[name] = seconds.get(name, 0.0) + duration

    def pytest_sessionstart(self):
        import jax  # not before the cache is chosen

        jax.monitoring.register_event_duration_secs_listener(self.listen)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        row = self.row = self.book[item.nodeid] = self._empty()
        begun = processor_time()
        result = yield
        row["seconds"] = round(processor_time() - begun, 3)
        return result

    def total(self, column: str) -> float:
        return sum(row[column] for row in self.book.values())

    def pytest_sessionfinish(self, session):
        super().pytest_sessionfinish(session)
        if self.total("lowerings") > self.budget:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        ordered = sorted(self.book.items(), key=lambda pair: -pair[1]["seconds"])
        for test, row in ordered[:DEAREST]:
            counted = ", ".join(f"{row[column]} {column}" for column in EVENTS.values())
            terminalreporter.write_line(f"{row['seconds']:7.1f} s, {counted}: {test}")
        programs: Counter[str] = Counter()
        for row in self.book.values():
            programs.update(row["programs"])
        for name, seconds in programs.most_common(DEAREST):
            tests = sum(name in row["programs"] for row in self.book.values())
            terminalreporter.write_line(f"{seconds:7.1f} s until it runs, in {tests} tests: {name}")
        terminalreporter.write_line("all: " + ", ".join(f"{self.total(column):.0f} {column}" for column in COLUMNS))
        if self.total("lowerings") > self.budget:
            terminalreporter.write_line(f"more than the budget of {self.budget} lowerings, see tests/programs.py")
        if self.file is not None:
            with self.file.open("w", newline="") as file:
                table = csv.writer(file)
                table.writerow(["test", *COLUMNS])
                table.writerows([test, *(row[column] for column in COLUMNS)] for test, row in ordered)
