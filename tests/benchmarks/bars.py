"""Times split into parts as horizontal bars."""

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np

PARTS = {
    "import": ("#bdbdbd", "black"),
    "trace": ("#56b4e9", "black"),
    "compile": ("#d55e00", "white"),
    "run and write": ("#00664a", "white"),
}
"""Colours of the parts and of the numbers in them; others are left out."""


def bars(groups: Mapping[str, Mapping[str, Mapping[str, float]]]):
    """Draws the seconds of each part of each row of each group, and its total behind the bar; gives the figure."""
    rows = sum(map(len, groups.values()))
    figure, ax = plt.subplots(figsize=(7.2, 0.24 * (rows + 1.6 * len(groups)) + 0.8), layout="constrained")
    longest = max(sum(of.get(part, 0.0) for part in PARTS) for group in groups.values() for of in group.values())
    at, places, labels = 0.0, [], []
    for title, group in groups.items():
        ax.text(0, at + 0.1, title, fontsize=9, fontweight="bold", va="center")
        rows_at = at + 1 + np.arange(len(group))
        left = np.zeros(len(group))
        for part, (color, ink) in PARTS.items():
            widths = np.array([of.get(part, 0.0) for of in group.values()])
            drawn = ax.barh(rows_at, widths, left=left, color=color, height=0.8, label="_" if labels else part)
            texts = [f"{width:.1f}" if width > 0.03 * longest else "" for width in widths]
            ax.bar_label(drawn, texts, label_type="center", color=ink, fontsize=7)
            left += widths
        ax.bar_label(drawn, [f"{total:.1f} s" for total in left], padding=3, fontsize=8, fontweight="bold")
        places += [*rows_at]
        labels += group
        at = rows_at[-1] + 1.3
    ax.set_yticks(places, labels, fontsize=8)
    ax.tick_params("y", length=0)
    ax.set(xlim=(0, 1.08 * longest), ylim=(at - 0.5, -0.6), xlabel="seconds until the first result is there")
    ax.xaxis.label.set_fontsize(9)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=len(PARTS), frameon=False, fontsize=8.5)
    return figure
