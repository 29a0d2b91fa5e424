"""Lists the tolerances that tests use up by more than a third, which may fail on another processor:
`python -B -X pycache_prefix=$(mktemp -d) -m pytest -n 2 --tolerances -o enable_assertion_pass_hook=true`

The prefix is needed, because the tests that pytest keeps compiled lack the hook of assertions.
"""

import re

import numpy as np
import pytest

from .workers import Gathered

USED = 1 / 3
"""Share of a tolerance above which a comparison is listed."""
LARGEST = 0.01
"""Right-hand side of `assert x < y` above which y is no tolerance."""


class Tolerances(Gathered):
    """A plugin that keeps the shares of tolerances that comparisons use."""

    def __init__(self):
        super().__init__()
        self.now = ""
        scalar = type(pytest.approx(1.0))
        assert_allclose, equal = np.testing.assert_allclose, scalar.__eq__

        def allclose(actual, desired, rtol=1e-7, atol=0.0, *args, **options):
            assert_allclose(actual, desired, rtol, atol, *args, **options)
            actual, desired = np.asarray(actual), np.asarray(desired)
            apart = np.abs(actual - desired)
            allowed = atol + rtol * np.abs(desired)
            used = np.divide(apart, allowed, out=np.zeros(np.shape(apart)), where=np.isfinite(apart) & (allowed > 0))
            self.keep(np.max(used, initial=0.0), f"assert_allclose rtol {rtol:.0e} atol {atol:.0e}")

        def approx_equal(approx, actual):
            same = equal(approx, actual)
            if same and isinstance(actual, (int, float)) and approx.tolerance:
                self.keep(abs(actual - approx.expected) / approx.tolerance, f"approx {approx.expected:.6g}")
            return same

        np.testing.assert_allclose = allclose
        scalar.__eq__ = approx_equal

    def keep(self, share: float, what: str):
        if USED < share <= 1:
            line = f"{self.now} {what}"
            self.book[line] = max(float(share), self.book.get(line, 0.0))

    def pytest_runtest_call(self, item):
        self.now = item.nodeid

    def pytest_assertion_pass(self, item, lineno, orig, expl):
        first = expl.splitlines()[0]
        for error, tolerance in re.findall(r"([\d.]+(?:e[+-]?\d+)?)\)* <=? ([\d.]+(?:e[+-]?\d+)?)", first):
            if 0 < float(tolerance) <= LARGEST:
                self.keep(float(error) / float(tolerance), f"line {lineno}: {orig}")

    def pytest_terminal_summary(self, terminalreporter):
        for line, share in sorted(self.book.items(), key=lambda pair: -pair[1]):
            terminalreporter.write_line(f"{share:.2f} of the tolerance: {line}")
