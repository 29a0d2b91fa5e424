"""Figures are closed after each test, as those of tests/plots."""

from ..plots.conftest import _closed as _closed
