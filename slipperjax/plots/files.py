"""Pictures as the content of files."""

import io
from typing import Any

import matplotlib.pyplot as plt


def png(figure: Any, dpi: int) -> bytes:
    """A figure as the content of a PNG file, of `dpi` pixels per inch; the figure is closed."""
    found = io.BytesIO()
    figure.savefig(found, dpi=dpi, format="png")
    plt.close(figure)
    return found.getvalue()
