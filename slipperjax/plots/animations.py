"""The slipper around the rail head in motion: both end sections, forces as arrows, and their history."""

from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..flow.datasets import load_scene
from ..flow.simulate import Trajectory
from ..model.kinematics import Motion, contacts, face_offsets, quaternion_from_euler, rail_frame
from ..model.scene import Scene, check_scene
from ..tools.checks import whole
from .sections import (
    ARROWS,
    THICKNESS,
    colors_of,
    default_magnification,
    draw_rail,
    draw_slipper,
    drawn_points,
    frame,
    height,
    outline,
    positive_number,
)
from .style import case_title, styled
from .trajectories import contact_forces

LONGEST_ARROW = 0.5
"""Length of the longest arrow, in heights of the section."""


def animate(
    run: Any,
    scene: Scene | None = None,
    *,
    magnify: float | None = None,
    last: float | None = 2.0,
    every: int = 1,
    fps: float = 20.0,
    most: int = 4,
) -> Any:
    """Animates the slipper's front and rear section around the rail head, with the play magnified.

    The rail head is drawn to scale and stands still: what moves is the slipper relative to it. That displacement is
    drawn `magnify` times as large, so that the drawn gap of every point is `magnify` times its gap: a point is drawn
    on the rail head where it touches, and inside it where it penetrates. Penetrations of millimetres are real: the
    contact law is soft. Arrows are the contact forces on the slipper, along the normals, all at one scale. Points
    with a force are filled. Beneath are the forces of the points with the highest ones in what is shown, with a
    cursor.

    `animate(run).save("slipper.gif")` writes a GIF, and an MP4 where ffmpeg is installed; in a notebook,
    `HTML(animate(run).to_jshtml())` of `IPython.display` gives a player.

    **Arguments:**

    - `run`: a `Trajectory`, or one case as a dataset over time, from `Trajectory.to_xarray` or
        `sweep(..., record="history")`.
    - `scene`: that of a dataset; its values that the dataset has as coordinates are replaced.
    - `magnify`: default as for `section`, and such that no gap is drawn above a quarter of the section's height.
    - `last`: forcing periods at the end of the run that are shown, None for all.
    - `every`: show each saved state, or each second, third, ...
    - `fps`: frames per second. `most`: number of points in the history.

    **Returns:** a `matplotlib.animation.FuncAnimation`.

    **Raises:** `ValueError` that names the argument, for a dataset of several cases or without its scene.
    """
    every, interval = whole("every", every, 1), 1e3 / positive_number("fps", fps)
    picture = _Picture(run, scene, magnify, last, most)
    frames = range(0, len(picture.period), every)
    from matplotlib.animation import FuncAnimation  # here, because its import takes long

    return FuncAnimation(picture.figure, picture.show, frames, init_func=lambda: [], interval=interval)


def instant(
    run: Any,
    scene: Scene | None = None,
    *,
    at: float | None = None,
    magnify: float | None = None,
    last: float | None = 2.0,
    most: int = 4,
) -> Any:
    """Draws one picture of `animate`: the saved state nearest to `at` [forcing periods], default the last one.

    **Arguments:** as for `animate`. **Returns:** the figure.
    """
    picture = _Picture(run, scene, magnify, last, most)
    picture.show(-1 if at is None else int(np.argmin(np.abs(picture.period - at))))
    return picture.figure


class _Picture:
    """The figure, and the artists that change with time."""

    def __init__(self, run: Any, scene: Scene | None, magnify: float | None, last: float | None, most: int):
        ds, scene = _one_case(run, scene)
        # peaks are those of the periods that are shown
        ds = ds.drop_vars(["peak_force", "peak_period"], errors="ignore")
        if last is not None:
            ds = ds.isel(time=ds["period"].values > ds["period"].values[-1] - last + 1e-9)
        self.shape, self.period = scene.section, ds["period"].values
        self.force = ds["contact_force"].transpose("time", "end", "point").values
        gap, offset = _displacements(ds, scene)
        if not (np.isfinite(gap).all() and np.isfinite(self.force).all()):
            raise ValueError(
                "Argument `run` must have finite motions in what is drawn, but has NaN; shorten the run."
            )
        if magnify is None:
            magnify = default_magnification(self.shape, gap)
        self.points = drawn_points(self.shape, gap, offset, positive_number("magnify", magnify))
        highest = float(self.force.max())
        self.newton = LONGEST_ARROW * height(self.shape) / max(highest, 1e-9)  # metres drawn per newton
        with styled():
            shape: dict[str, Any] = dict(figsize=(7.2, 4.3), layout="constrained")
            self.figure, axes = plt.subplot_mosaic("FR;HH", height_ratios=(2.4, 1), **shape)
            front, rear, forces = (axes[panel] for panel in "FRH")
            self.ends = [self._draw_end(front, "front", 0), self._draw_end(rear, "rear", 1)]
            rear.set_ylabel("")
            contact_forces(ds, forces, most=most, last=None)
            self.cursor = forces.axvline(self.period[0], lw=0.9, color="black")
            self.time = front.text(0.02, 0.97, "", transform=front.transAxes, va="top", fontsize=7)
            scales = f"play and displacement × {magnify:g}, longest arrow {highest / 1e3:.3g} kN"
            self.figure.suptitle("; ".join(text for text in (case_title(ds), scales) if text), fontsize=7.5)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")  # the panels stay where they are while the picture changes

    def _draw_end(self, ax: Any, end: str, k: int) -> tuple[Any, Any, Any]:
        """Draws one end section; gives the slipper's patch, its points and its arrows."""
        draw_rail(self.shape, ax, [f"{name}{k + 1}" for name in self.shape.names])
        points, tall, colors = self.points[0, k], 1e3 * height(self.shape), colors_of(self.shape)
        patch = draw_slipper(self.shape, points, ax)
        dots = ax.scatter(*(1e3 * points.T), s=14, edgecolors=colors, lw=1.0, zorder=4)
        arrows = ax.quiver(*(1e3 * points.T), *np.zeros((2, len(points))), color=colors, **ARROWS)
        frame(ax, self.points.reshape(-1, *points.shape), (LONGEST_ARROW / 2 + THICKNESS) * tall)
        ax.set_title(end, fontsize=8)
        return patch, dots, arrows

    def show(self, k: int) -> list[Any]:
        """Draws the instant with index `k`; gives the artists that changed."""
        for end, (patch, dots, arrows) in enumerate(self.ends):
            points, force = self.points[k, end], self.force[k, end]
            patch.set_xy(outline(self.shape, points))
            dots.set_offsets(1e3 * points)
            dots.set_facecolors(np.where(force > 0, colors_of(self.shape), "white"))
            arrows.set_offsets(1e3 * points)
            arrows.set_UVC(*(1e3 * self.newton * force[:, None] * np.asarray(self.shape.normals)).T)
        self.cursor.set_xdata([self.period[k]] * 2)
        self.time.set_text(f"forcing period {self.period[k]:.2f}")
        return [self.cursor, self.time, *(artist for end in self.ends for artist in end)]


def _one_case(run: Any, scene: Scene | None) -> tuple[xr.Dataset, Scene]:
    """Gives one case over time, and its scene."""
    if isinstance(run, Trajectory):
        return run.to_xarray(), run.scene if scene is None else check_scene(scene)
    if not isinstance(run, xr.Dataset):
        raise ValueError(f"Argument `run` must be a Trajectory or a dataset of one, but is {type(run).__name__}.")
    ds = run.squeeze()
    if "contact_force" not in ds or set(ds["contact_force"].dims) != {"time", "end", "point"}:
        raise ValueError(
            f"Argument `run` must be one case with contact forces over time, but has dimensions {tuple(run.sizes)}."
        )
    return ds, load_scene(ds) if scene is None else check_scene(scene)


def _displacements(ds: xr.Dataset, scene: Scene) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Gives the gaps and displacements along the faces [m] by the model's own kinematics, (time, end, point)."""
    at = lambda name: np.asarray(ds[name].values, float)
    attitude = quaternion_from_euler(at("roll"), at("pitch"), at("yaw"))
    still = np.zeros_like(at("y"))
    both = _relative(scene, at("period"), Motion(at("y"), at("z"), *attitude, *[still] * 5))
    gap, offset = (np.asarray(a).reshape(len(still), 2, -1) for a in both)
    return gap, offset


@jax.jit
def _relative(scene: Scene, period: Any, motion: Motion) -> Any:
    at_one = lambda p, m: (contacts(rail_frame(scene, p), m).gap, face_offsets(scene, p, m))
    return jax.vmap(at_one)(period, motion)
