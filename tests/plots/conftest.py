"""Figures are closed after each test."""

import pytest


@pytest.fixture(autouse=True)
def _closed():
    import matplotlib

    matplotlib.use("Agg")
    yield
    matplotlib.pyplot.close("all")
