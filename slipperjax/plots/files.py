"""Pictures as the content of files."""

import io
from typing import Any

import matplotlib.pyplot as plt


def png(figure: Any, dpi: int) -> bytes:
    """A figure as the content of a PNG file, of `dpi` pixels per inch; the figure is closed."""
    found = io.BytesIO()
    # level 3 takes a quarter less time than 6, matplotlib's, for files that are a fifth larger
    figure.savefig(found, dpi=dpi, format="png", pil_kwargs={"compress_level": 3})
    plt.close(figure)
    return found.getvalue()
