"""The cross section, and slippers around the rail head in motion, with forces as arrows and their history."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.quiver import Quiver

from ..flow.datasets import scene_of
from ..model.dynamics import State
from ..model.kinematics import Motion, contacts, face_offsets, quaternion_from_euler, rail_frame
from ..model.parameters import quantity
from ..model.quantities import POINT_DIMS, point_dims
from ..model.scene import Scene, check_scene
from ..model.section import Section
from ..tools.checks import finite, known, number, positive, require, whole
from .style import COLORS, case_title, check_dataset, drawing, entitle, lost, page_width, point_colors, styled
from .trajectories import TRAJECTORY_SOURCE, Along, Run, contact_forces

if TYPE_CHECKING:
    import matplotlib.animation

RAIL_STYLE = {"facecolor": "#d9d9d9", "edgecolor": "#8a8a8a", "lw": 0.8, "zorder": 1}
SLIPPER_STYLE = {"facecolor": "#12355b66", "edgecolor": "#12355b", "lw": 0.9, "zorder": 2}
ARROWS: dict[str, object] = dict(
    angles="xy", scale_units="xy", scale=1.0, width=0.006, minlength=0.0, headwidth=4.0, headlength=4.5, zorder=5
)
"""Arrows whose length is in units of the axes; no arrow where it is zero."""


def section(scene: Scene, ax: Axes | None = None) -> Axes:
    """Draw the cross section, with slipper and rail centred: contact points, and the normals of their faces.

    Rail head and web are grey, the slipper is blue. The slipper's wall and the web are no part of the model. y points
    to the right, as seen against the direction of travel.

    **Arguments:**

    - `scene`: its section is drawn to scale, in mm, except the play, which is 8 % of the section's height.
    - `ax`: the Axes to draw into; default the Axes of a new figure.

    **Returns:** the Axes.
    """
    shape = known("scene", check_scene(scene)).section
    magnify = default_magnification(shape)
    still = drawn_points(
        shape,
        np.asarray(shape.play)[shape.face_of_point],
        np.zeros(len(shape.names)),
        magnify,
    )
    reach = 1e3 * wall(shape)  # of the normals, from m to mm
    own = ax is None
    with drawing(ax, None, 3.5, 2.35) as ax:
        if own:
            clearance = quantity("clearance").shown(float(scene.value("clearance")))
            entitle(ax.figure, f"total play $C$ = {clearance:.3g} mm, drawn {magnify:g} times as wide")
        _draw_slipper(
            ax, shape, still, reach * np.asarray(shape.normals), shape.names, point_colors(len(shape.names))
        )
        frame(ax, still[None], 1.3 * reach)
    return ax


def default_magnification(shape: Section, gaps: float | np.ndarray = 0.0) -> float:
    """Return the magnification that draws the mean play as 8 % of the section's height, and no gap above 25 % of it.

    **Arguments:** `gaps`: the gaps to be drawn [m]. **Returns:** two digits, 1 or more.
    """
    sizes = {0.08: float(np.mean(shape.play)), 0.25: float(np.max(np.abs(gaps)))}
    wanted = [share * height(shape) / size for share, size in sizes.items() if size > 0]
    return float(f"{max(1.0, min(wanted, default=1.0)):.2g}")


def height(shape: Section) -> float:
    """Return the height of the section [m], or 0.3 of its width where this is more, as for a single face."""
    # a single face has no height
    width, tall = np.ptp(np.asarray(shape.points), axis=0)
    return float(max(tall, 0.3 * width))


def wall(shape: Section) -> float:
    """Return the thickness of the drawn slipper [m]."""
    return 0.2 * height(shape)


def drawn_points(
    shape: Section, gap: Float[np.ndarray, "*n points"], offset: Float[np.ndarray, "*n points"], magnify: float
) -> Float[np.ndarray, "*n points 2"]:
    """Return the slipper's points as drawn [m]: the rail's points plus the magnified displacement from them.

    Across its face a point moves by exactly `magnify` times its gap: it is drawn on its face where it touches, and
    inside the rail head where it penetrates. The rail head does not move.

    **Arguments:** `gap`: [m]; `offset`: along the faces, see `slipperjax.model.kinematics.face_offsets` [m].
    """
    across = np.asarray(shape.normals)
    along = np.stack([across[:, 1], -across[:, 0]], axis=1)
    # across the face by the gap, along the face by the offset
    moved = gap[..., None] * across + offset[..., None] * along
    return np.asarray(shape.track_points) + magnify * moved


def contour(shape: Section) -> Int[np.ndarray, " points"]:
    """Return the points' indices clockwise around the rail head, from one side of the slipper's opening to the other.

    The opening is the widest space between two faces.
    """
    points = np.asarray(shape.points)
    faces = np.array([[shape.names.index(corner) for corner in face] for face in shape.faces])
    middle = points[faces].mean(axis=1) - points.mean(axis=0)
    # clockwise, by the angles of the faces' middles
    faces = faces[np.argsort(-np.arctan2(middle[:, 1], middle[:, 0]), kind="stable")]
    # from the end of each face to the beginning of the next
    spaces = np.linalg.norm(points[np.roll(faces[:, 0], -1)] - points[faces[:, 1]], axis=1)
    return np.roll(faces, -1 - int(np.argmax(spaces)), axis=0).ravel()


def rail_outline(shape: Section) -> Float[np.ndarray, "corners 2"]:
    """Return the corners [mm] of the rail head with a web through the slipper's opening."""
    head = 1e3 * np.asarray(shape.track_points)[contour(shape)]
    across = head[0] - head[-1]  # of the opening
    down = np.array([-across[1], across[0]]) / np.linalg.norm(across)  # out of the rail head, as it goes clockwise
    one = head[-1] + 0.3 * across
    other = head[-1] + 0.7 * across
    down = 600 * height(shape) * down
    return np.concatenate([head, [one, one + down, other + down, other]])


def label_places(shape: Section) -> Float[np.ndarray, "points 2"]:
    """Return places of the points' labels inside the rail head [mm]."""
    points = np.asarray(shape.track_points)
    face = shape.face_of_point
    middles = np.array([points[face == k].mean(axis=0) for k in range(len(shape.faces))])
    # towards the middle of the face, away from the corner where the next face also has a point
    along = middles[face] - points
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return 1e3 * (points + height(shape) * (0.07 * along - 0.13 * np.asarray(shape.normals)))


def _draw_slipper(
    ax: Axes,
    shape: Section,
    points: Float[np.ndarray, "points 2"],
    arrows: Float[np.ndarray, "points 2"],
    labels: Sequence[str],
    colors: Sequence[str],
) -> tuple[Polygon, PathCollection, Quiver]:
    """Draw the rail head with its web and labels inside it, and the slipper around it.

    **Arguments:** `points`: of the slipper [m]; `arrows`: from these points [mm]; `colors`: of the points.

    **Returns:** the slipper's patch, its points and its arrows.
    """
    ax.fill(*rail_outline(shape).T, **RAIL_STYLE)
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.6, "lw": 0}
    # labels are inside the rail head
    for label, (y, z) in zip(labels, label_places(shape), strict=True):
        ax.text(y, z, label, fontsize=6.5, ha="center", va="center", zorder=6, bbox=box)
    (patch,) = ax.fill(*outline(shape, points).T, **SLIPPER_STYLE)
    dots = ax.scatter(*(1e3 * points.T), s=14, color=colors, lw=1.0, zorder=4)
    quiver = ax.quiver(*(1e3 * points.T), *arrows.T, color=colors, **ARROWS)
    return patch, dots, quiver


def outline(shape: Section, points: Float[np.ndarray, "*n points 2"]) -> Float[np.ndarray, "*n corners 2"]:
    """Return the corners [mm] of the slipper with its points at `points` [m]: along the inside, and back outside."""
    order = contour(shape)
    inner = 1e3 * points[..., order, :]
    # the outside follows the same corners back
    outer = inner + 1e3 * wall(shape) * np.asarray(shape.normals)[order]
    return np.concatenate([inner, outer[..., ::-1, :]], axis=-2)


def frame(ax: Axes, points: Float[np.ndarray, "n points 2"], margin: float) -> None:
    """Set equal scales in mm, and limits that leave a margin [mm] around all points [m]."""
    low = 1e3 * points.min(axis=(0, 1)) - margin
    high = 1e3 * points.max(axis=(0, 1)) + margin
    ax.set(
        xlim=(low[0], high[0]),
        ylim=(low[1], high[1]),
        xlabel="$y$ [mm]",
        ylabel="$z$ [mm]",
        aspect="equal",
    )
    ax.grid(False)
    ax.tick_params(color=COLORS["grey"])


def animate(
    run: Run,
    scene: Scene | None = None,
    *,
    magnify: float | None = None,
    last: float | None = 2.0,
    every: int = 1,
    fps: float = 20.0,
) -> "matplotlib.animation.FuncAnimation":
    """Animate the slipper's front and rear section around the rail head, with the play magnified.

    For a sled there is a row for each slipper.

    The rail head is drawn to scale and does not move; the slipper moves relative to it. The slipper's displacement is
    drawn `magnify` times as large, so that the drawn gap of every point is `magnify` times its gap: a point is drawn
    on the rail head where it touches, and inside the rail head where it penetrates. Penetrations of millimetres are
    real, because the contact law is soft. Arrows are the contact forces on the slipper, along the normals, all at one
    scale. Points with a force are filled. Below are the forces of the points with the highest forces in the shown
    periods, with a cursor.

    `animate(run).save("slipper.gif")` writes a GIF, and an MP4 where ffmpeg is installed; in a notebook,
    `HTML(animate(run).to_jshtml())` of `IPython.display` gives a player.

    **Arguments:**

    - `run`: a `Trajectory`, or one case as a dataset over time, its `ds`, or
        `sweep(..., record="history")`. A dataset has no motion of elastic modes, which are left out then.
    - `scene`: the scene of a dataset; values that the dataset has as coordinates replace its values.
    - `magnify`: default as for `section`, but no gap is drawn above a quarter of the section's height.
    - `last`: number of shown forcing periods at the end of the run, None for all.
    - `every`: show each saved state, or each second, third, ...
    - `fps`: frames per second.

    **Returns:** a `matplotlib.animation.FuncAnimation`.

    **Raises:** `ValueError` that names the argument, for a dataset of several cases or without its scene.
    """
    every = whole("every", every, 1)
    interval = 1e3 / number(positive, "fps", fps)  # in ms
    picture = _Picture(frames_of(run, scene, magnify=magnify, last=last))
    from matplotlib.animation import FuncAnimation  # here, because its import takes long

    frames = range(0, len(picture.period), every)
    return FuncAnimation(picture.figure, picture.show, frames, init_func=lambda: [], interval=interval)


def instant(
    run: Run,
    scene: Scene | None = None,
    *,
    at: float | None = None,
    magnify: float | None = None,
    last: float | None = 2.0,
) -> Figure:
    """Draw one picture of `animate`: the saved state nearest to `at` [forcing periods], default the last state.

    **Arguments:** as for `animate`. **Returns:** the figure.
    """
    picture = _Picture(frames_of(run, scene, magnify=magnify, last=last))
    k = -1 if at is None else int(np.argmin(np.abs(picture.period - number(finite, "at", at))))
    picture.show(k)
    return picture.figure


class Frames(NamedTuple):
    """A slipper at the front and the rear over time, as drawn around the rail head."""

    name: str
    """Name on a sled; empty for a single slipper."""
    colors: list[str]
    """Names of the points."""
    ds: xr.Dataset
    """The drawn instants."""
    shape: Section
    period: Float[np.ndarray, " time"]
    """Time [forcing periods]."""
    points: Float[np.ndarray, "time 2 points 2"]
    """Places where the slipper's points are drawn [m], see `drawn_points`."""
    force: Float[np.ndarray, "time 2 points"]
    """Contact forces [N]."""
    magnify: float
    """Factor of drawn displacements."""
    arrows: Float[np.ndarray, "time 2 points 2"]
    """Forces as arrows [mm]; the longest arrow has half the height of the section."""


def frames_of(
    run: Run,
    scene: Scene | None = None,
    *,
    magnify: float | None = None,
    last: float | None = 2.0,
) -> list[Frames]:
    """Return the frames that `animate` draws for each slipper; arguments and errors as for `animate`."""
    ds = check_dataset(run, TRAJECTORY_SOURCE, "contact_force", argument="run").squeeze()
    over = ds["contact_force"].dims
    one = set(over) - set(POINT_DIMS) == {"time"}
    require(one, "run", "be one case over time", shown=f"over {', '.join(map(str, over))}")
    if scene is None:
        scene = scene_of(ds)
    scene = check_scene(scene)
    force = ds["contact_force"].transpose("time", *point_dims(ds))
    need = "have the contact points of its scene"
    require(force[0].size == scene.points, "run", need, shown=f"a dataset with {force[0].size} of {scene.points}")
    # peaks of the shown periods
    drawn = slice(None)
    if last is not None:
        drawn = ds["period"].values > ds["period"].values[-1] - number(positive, "last", last) + 1e-9
    motion = jax.tree.map(lambda a: a[drawn], _motion_of(run, ds))
    ds = ds.drop_vars(["peak_force", "peak_period"], errors="ignore").isel(time=drawn)
    period = ds["period"].values
    # from the model, because the dataset has no offsets
    at_one = lambda p, m: (contacts(rail_frame(scene, p), m).gap, face_offsets(scene, p, m))
    of_slippers = (len(period), len(scene.mounted), 2, -1)
    values = (force.values[drawn], *jax.jit(jax.vmap(at_one))(period, motion))
    forces, gap, offset = (np.asarray(a).reshape(of_slippers) for a in values)
    if not (np.isfinite(gap).all() and np.isfinite(forces).all()):
        raise ValueError("Argument `run` must have finite motions in what is drawn, but has NaN; shorten the run.")
    shapes = [slipper.section for slipper in scene.mounted]
    if magnify is None:
        magnify = min(default_magnification(shape, gap) for shape in shapes)
    magnify = number(positive, "magnify", magnify)
    # arrows in mm per newton: half the height, which is in m
    newton = 500 * height(shapes[0]) / max(float(forces.max()), 1e-9)
    frames = []
    for k, (name, shape) in enumerate(zip(scene.slipper.names or [""], shapes, strict=True)):
        points = drawn_points(shape, gap[:, k], offset[:, k], magnify)
        arrows = newton * forces[:, k, ..., None] * np.asarray(shape.normals)
        frames.append(
            Frames(name, point_colors(len(shape.names), k), ds, shape, period, points, forces[:, k], magnify, arrows)
        )
    return frames


def _motion_of(run: Run, ds: xr.Dataset) -> Motion:
    """Return the motion at the instants of a dataset, with elastic modes where the run has them."""
    state = getattr(run, "state", None)
    if isinstance(state, State):
        return state.motion
    y, z, *angles = (np.asarray(ds[name].values, float) for name in ("y", "z", "roll", "pitch", "yaw"))
    return Motion(y, z, *quaternion_from_euler(*angles), *[np.zeros_like(y)] * 5)


class _Picture:
    """The figure, and the artists that change with time."""

    def __init__(self, frames: list[Frames]):
        self.frames = frames
        ds = frames[0].ds
        self.period = frames[0].period
        rows = len(frames)
        # a single slipper has the height of two of several slippers
        panels = 1.3 + 1.7 * rows
        with styled():
            figure, grid = plt.subplot_mosaic(
                [*([f"front {k}", f"rear {k}"] for k in range(rows)), ["forces", "forces"]],
                height_ratios=[panels / rows] * rows + [1.25],
                figsize=(page_width(), panels + 1.3),
                layout="constrained",
            )
            self.figure = figure
            self.ends = []
            for row, of in enumerate(frames):
                margin = 450 * height(of.shape)
                for k, end in enumerate(("front", "rear")):
                    ax = grid[f"{end} {row}"]
                    labels = [f"{name}{k + 1}" for name in of.shape.names]
                    artists = _draw_slipper(ax, of.shape, of.points[0, k], of.arrows[0, k], labels, of.colors)
                    self.ends.append((of, k, artists))
                    frame(ax, of.points.reshape(-1, *of.points.shape[2:]), margin)
                    ax.set_title(f"{of.name} {end}".strip(), fontsize=8)
                    # labels only at the left and at the bottom
                    if k:
                        ax.set_ylabel("")
                    if row < rows - 1:
                        ax.set_xlabel("")
            contact_forces(ds, grid["forces"], last=None)
            self.along = Along.of(ds)
            self.cursor = grid["forces"].axvline(self.along.unit * self.period[0], lw=0.9, color="black")
            first = grid["front 0"]
            self.time = first.text(0.02, 0.97, "", transform=first.transAxes, va="top", fontsize=7)
            scales = f"play and displacement × {frames[0].magnify:g}"
            if not lost(ds):
                scales += f", longest arrow {max(float(of.force.max()) for of in frames) / 1e3:.3g} kN"
            entitle(figure, "; ".join(filter(None, [case_title(ds), scales])))
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # the panels do not move while the picture changes

    def show(self, k: int) -> list[Artist]:
        """Draw the instant with index `k`; return the artists that changed."""
        changed = [self.cursor, self.time]
        # the artists stay, and get new places
        for of, end, (patch, dots, arrows) in self.ends:
            points = of.points[k, end]
            patch.set_xy(outline(of.shape, points))
            dots.set_offsets(1e3 * points)
            dots.set_facecolors(np.where(of.force[k, end] > 0, of.colors, "white"))
            arrows.set_offsets(1e3 * points)
            arrows.set_UVC(*of.arrows[k, end].T)
            changed += [patch, dots, arrows]
        instant = self.along.unit * self.period[k]
        self.cursor.set_xdata([instant] * 2)
        self.time.set_text(self.along.words.format(instant))
        return changed
