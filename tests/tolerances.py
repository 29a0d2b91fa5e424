"""Lists the tolerances that tests use up by more than a third, which may fail on another processor:
`python -B -X pycache_prefix=$(mktemp -d) -m pytest -n 2 -p tests.tolerances -o enable_assertion_pass_hook=true`

The prefix is needed, because the tests that pytest keeps compiled lack the hook of assertions.
"""

import re

import numpy as np
import pytest

USED = 1 / 3
"""Share of a tolerance above which a comparison is listed."""
LARGEST = 0.01
"""Right-hand side of `assert x < y` above which y is no tolerance."""

_shares: dict[str, float] = {}
_now = ""


def _keep(share: float, what: str):
    if USED < share <= 1:
        line = f"{_now} {what}"
        _shares[line] = max(share, _shares.get(line, 0.0))


def pytest_configure():
    scalar = type(pytest.approx(1.0))
    assert_allclose, equal = np.testing.assert_allclose, scalar.__eq__

    def allclose(actual, desired, rtol=1e-7, atol=0.0, *args, **options):
        assert_allclose(actual, desired, rtol, atol, *args, **options)
        apart = np.abs(np.asarray(actual) - np.asarray(desired))
        allowed = atol + rtol * np.abs(desired)
        used = np.divide(apart, allowed, out=np.zeros(np.shape(apart)), where=np.isfinite(apart) & (allowed > 0))
        _keep(np.max(used, initial=0.0), f"assert_allclose rtol {rtol:.0e} atol {atol:.0e}")

    def approx_equal(self, actual):
        same = equal(self, actual)
        if same and isinstance(actual, (int, float)) and self.tolerance:
            _keep(abs(actual - self.expected) / self.tolerance, f"approx {self.expected:.6g}")
        return same

    np.testing.assert_allclose = allclose
    scalar.__eq__ = approx_equal


def pytest_runtest_call(item):
    global _now
    _now = item.nodeid


def pytest_assertion_pass(item, lineno, orig, expl):
    for error, tolerance in re.findall(r"([\d.]+(?:e[+-]?\d+)?)\)* <=? ([\d.]+(?:e[+-]?\d+)?)", expl.splitlines()[0]):
        if 0 < float(tolerance) <= LARGEST:
            _keep(float(error) / float(tolerance), f"line {lineno}: {orig}")


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    _shares.update(getattr(node, "workeroutput", {}).get("shares", {}))


def pytest_sessionfinish(session):
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["shares"] = {line: float(share) for line, share in _shares.items()}


def pytest_terminal_summary(terminalreporter):
    for line, share in sorted(_shares.items(), key=lambda pair: -pair[1]):
        terminalreporter.write_line(f"{share:.2f} of the tolerance: {line}")
