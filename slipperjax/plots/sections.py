"""The cross section: where the contact points are, and outlines of rail head and slipper."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..model.quantities import quantity
from ..model.scene import Scene, check_scene
from ..model.section import Section
from ..tools.checks import require
from .style import COLORS, POINT_COLORS, drawing

RAIL_STYLE = {"facecolor": "#d9d9d9", "edgecolor": "#8a8a8a", "lw": 0.8}
SLIPPER_STYLE = {"facecolor": "#12355b66", "edgecolor": "#12355b", "lw": 0.9}
THICKNESS = 0.2
"""Wall of the drawn slipper, in heights of the section."""


def section(scene: Scene, ax: Any = None, *, magnify: float | None = None) -> Any:
    """Draws the cross section, with slipper and rail centred: contact points, and the normals of their faces.

    Rail head and web are grey, the slipper blue. Its wall and the web are no part of the model. y points to the
    right, as seen against the direction of travel.

    **Arguments:**

    - `scene`: its section is drawn to scale, in mm, but for the play.
    - `ax`: the Axes to draw into; default those of a new figure.
    - `magnify`: the play is drawn this many times as wide; default 8 % of the section's height.

    **Returns:** the Axes.

    **Raises:** `ValueError` for a `magnify` that is not positive.
    """
    shape = check_scene(scene).section
    magnify = default_magnification(shape) if magnify is None else positive_number("magnify", magnify)
    still = drawn_points(shape, np.asarray(shape.play)[shape.face_of_point], np.zeros(len(shape.names)), magnify)
    reach = 1e3 * THICKNESS * height(shape)
    own = ax is None
    with drawing(ax, None, 3.5, 2.35) as ax:
        if own:
            clearance = quantity("clearance").shown(float(scene.value("clearance")))
            ax.figure.suptitle(f"total play $C$ = {clearance:.3g} mm, drawn {magnify:g} times as wide", fontsize=7)
        draw_rail(shape, ax, shape.names)
        draw_slipper(shape, still, ax)
        ax.quiver(*(1e3 * still.T), *(reach * np.asarray(shape.normals).T), color=colors_of(shape), **ARROWS)
        ax.scatter(*(1e3 * still.T), s=12, color=colors_of(shape), zorder=4)
        frame(ax, still[None], 1.3 * reach)
    return ax


ARROWS: dict[str, Any] = dict(
    angles="xy", scale_units="xy", scale=1.0, width=0.006, minlength=0.0, headwidth=4.0, headlength=4.5, zorder=5
)
"""Arrows whose length is in units of the axes; none where it is zero."""


def positive_number(name: str, value: Any) -> float:
    """Returns `value`; raises `ValueError` where it is no positive number."""
    valid = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < np.inf
    require(valid, name, "be a positive number", value)
    return float(value)


def default_magnification(shape: Section, gaps: Any = 0.0) -> float:
    """Gives the magnification for a mean play of 8 % of the section's height, and no gap above a quarter of it.

    **Arguments:** `gaps`: those to be drawn [m]. **Returns:** two digits, 1 or more.
    """
    play, most = float(np.mean(shape.play)), float(np.max(np.abs(gaps)))
    wanted = [share * height(shape) / size for share, size in ((0.08, play), (0.25, most)) if size > 0]
    return float(f"{max(1.0, min(wanted, default=1.0)):.2g}")


def height(shape: Section) -> float:
    """Gives the height of the section [m], or 0.3 of its width where that is more, as for a single face."""
    width, tall = np.ptp(np.asarray(shape.points), axis=0)
    return float(max(tall, 0.3 * width))


def drawn_points(
    shape: Section, gap: Float[np.ndarray, "*n points"], offset: Float[np.ndarray, "*n points"], magnify: float
) -> Float[np.ndarray, "*n points 2"]:
    """Gives the slipper's points as drawn [m]: the rail's points, moved by the magnified displacement from them.

    Across its face a point moves by `magnify` times its gap, exactly: it is drawn on its face where it touches, and
    inside the rail head where it penetrates. The rail head stays where it is.

    **Arguments:** `gap`: [m]; `offset`: along the faces, see `slipperjax.model.kinematics.face_offsets` [m].
    """
    across = np.asarray(shape.normals)
    along = np.stack([across[:, 1], -across[:, 0]], axis=1)
    moved = gap[..., None] * across + offset[..., None] * along
    return np.asarray(shape.track_points) + magnify * moved


def contour(shape: Section) -> Int[np.ndarray, " points"]:
    """Gives the points' indices clockwise around the rail head, from one side of the slipper's opening to the other.

    The opening is the widest space between two faces.
    """
    points, names = np.asarray(shape.points), shape.names
    faces = np.array([[names.index(corner) for corner in face] for face in shape.faces])
    middle = points[faces].mean(axis=1) - points.mean(axis=0)
    faces = faces[np.argsort(-np.arctan2(middle[:, 1], middle[:, 0]), kind="stable")]
    spaces = np.linalg.norm(points[np.roll(faces[:, 0], -1)] - points[faces[:, 1]], axis=1)
    return np.roll(faces, -1 - int(np.argmax(spaces)), axis=0).ravel()


def colors_of(shape: Section) -> list[str]:
    """Gives the colour of each point."""
    return [POINT_COLORS[k % len(POINT_COLORS)] for k in range(len(shape.names))]


def draw_rail(shape: Section, ax: Any, labels: Any) -> None:
    """Draws the rail head with a web through the slipper's opening, and a label inside it at each point."""
    order, rail, tall = contour(shape), 1e3 * np.asarray(shape.track_points), 1e3 * height(shape)
    head = rail[order]
    across = head[0] - head[-1]  # of the opening
    down = np.array([-across[1], across[0]]) / np.linalg.norm(across)  # out of the rail head, as it goes clockwise
    foot = np.stack([head[-1] + 0.3 * across, head[-1] + 0.7 * across])
    web = np.stack([foot[0], foot[0] + 0.6 * tall * down, foot[1] + 0.6 * tall * down, foot[1]])
    ax.fill(*np.concatenate([head, web]).T, **RAIL_STYLE, zorder=1)
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.6, "lw": 0}
    inside = rail - 0.13 * tall * np.asarray(shape.normals)
    for label, (y, z) in zip(labels, inside, strict=True):
        ax.text(y, z, label, fontsize=6.5, ha="center", va="center", zorder=6, bbox=box)


def draw_slipper(shape: Section, points: Float[np.ndarray, "points 2"], ax: Any) -> Any:
    """Draws the slipper's outline with its points at `points` [m]; gives the patch."""
    (patch,) = ax.fill(*outline(shape, points).T, **SLIPPER_STYLE, zorder=2)
    return patch


def outline(shape: Section, points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "corners 2"]:
    """Gives the corners [mm] of the slipper with its points at `points` [m]: inside, and back along the outside."""
    order = contour(shape)
    inner = 1e3 * points[order]
    outer = inner + 1e3 * THICKNESS * height(shape) * np.asarray(shape.normals)[order]
    return np.concatenate([inner, outer[::-1]])


def frame(ax: Any, points: Float[np.ndarray, "n points 2"], margin: float) -> None:
    """Sets axes in mm with equal scales, that hold all points [m] and a margin [mm] around."""
    low, high = 1e3 * points.min(axis=(0, 1)) - margin, 1e3 * points.max(axis=(0, 1)) + margin
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="$y$ [mm]", ylabel="$z$ [mm]", aspect="equal")
    ax.grid(False)
    ax.tick_params(color=COLORS["grey"])
