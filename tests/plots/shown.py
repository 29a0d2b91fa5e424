"""Numbers and words that a picture shows."""

import numpy as np


def drawn(line):
    """Gives the points of a line, (points, 2)."""
    return np.array(line.get_xydata())


def marked(ax, marker):
    """Gives the lines with a marker that have points."""
    return [line for line in ax.lines if line.get_marker() in marker and len(line.get_xdata())]


def legend(ax):
    return [] if ax.get_legend() is None else [text.get_text() for text in ax.get_legend().get_texts()]


def labels(ax):
    return ax.get_xlabel(), ax.get_ylabel()


def bar_of(ax):
    """Gives the axes of the colour bar."""
    return next(other for other in ax.figure.axes if other is not ax)


def check_legend_fits(ax):
    """Checks that a legend is no wider than its axes."""
    ax.figure.draw_without_rendering()
    assert ax.get_legend().get_window_extent().width <= 1.001 * ax.get_window_extent().width
