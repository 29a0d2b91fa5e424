"""How rails bend around a sled: deflections over the distance ahead of it, at one instant and in motion."""

import functools
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ..model.dynamics import State
from ..model.kinematics import contact_points
from ..model.parameters import DIRECTIONS
from ..model.quantities import Quantity
from ..tools.checks import finite, number, positive, require, whole
from .style import drawing, legend_above, page_width, styled, with_unit
from .trajectories import Run

if TYPE_CHECKING:
    import matplotlib.animation

DEFLECTION = Quantity("deflection", "m", "deflection of the rail", shown_unit="mm")
REACH = 8.0
"""Length of rail that is drawn ahead of and behind the sled [m]."""


def bending(run: Run, ax: Axes | None = None, *, at: float | None = None, reach: float = REACH) -> Axes:
    """Draw how the rails bend around the sled at one instant, in the frame that travels along.

    Dots are the ends of slippers, where the rail is pressed. Deflections to the left and upwards are positive.

    **Arguments:**

    - `run`: of a scene with a `Beam`.
    - `ax`: the Axes to draw into; default the Axes of a new figure.
    - `at`: the saved state nearest to this time is drawn [s]; default the last state.
    - `reach`: length of rail ahead and behind [m].

    **Returns:** the Axes.
    """
    picture = _Rails(run, reach)
    times = np.asarray(run.time)
    k = -1 if at is None else int(np.argmin(np.abs(times - number(finite, "at", at))))
    with drawing(ax, width=page_width()) as ax:
        picture.draw(ax)
        picture.show(k)
        ax.relim()
        # room for the words above the highest crest
        ax.margins(y=0.2)
    return ax


def animate_bending(
    *runs: Run, reach: float = REACH, every: int = 1, fps: float = 20.0
) -> "matplotlib.animation.FuncAnimation":
    """Animate how rails bend around the sleds of some runs, one panel for each run, all at one scale.

    **Arguments:** `runs`: of scenes with a `Beam`, with equally many saved states; `reach`: length of rail ahead and
    behind [m]; `every`: show each saved state, or each second, third, ...; `fps`: frames per second.

    **Returns:** a `matplotlib.animation.FuncAnimation`.
    """
    every = whole("every", every, 1)
    interval = 1e3 / number(positive, "fps", fps)  # in ms
    require(runs, "runs", "be one run or several", shown="none")
    pictures = [_Rails(run, reach) for run in runs]
    counts = {len(run.period) for run in runs}
    require(len(counts) == 1, "runs", "have equally many saved states", shown=f"of {sorted(counts)}")
    with styled():
        figure, grid = plt.subplots(
            len(runs), figsize=(page_width(), 0.6 + 1.7 * len(runs)), layout="constrained", squeeze=False, sharex=True
        )
        most = 1.1 * max(picture.most for picture in pictures)
        for picture, ax in zip(pictures, grid[:, 0], strict=True):
            picture.draw(ax)
            ax.set_ylim(-most, most)
            if ax is not grid[-1, 0]:
                ax.set_xlabel("")
        legend_above(grid[0, 0])
        figure.draw_without_rendering()
        # inches of a metre along the rail, and of a metre of deflection
        box = grid[0, 0].get_window_extent()
        ratio = (box.height / (2e-3 * most)) / (box.width / (2 * pictures[0].reach))
        figure.suptitle(f"deflections are drawn {ratio:,.0f} times as large as distances")
    from matplotlib.animation import FuncAnimation  # here, because its import takes long

    show = lambda k: [artist for picture in pictures for artist in picture.show(k)]
    return FuncAnimation(figure, show, range(0, counts.pop(), every), init_func=lambda: [], interval=interval)


class _Rails:
    """The lines of a run's rails, which change with time."""

    def __init__(self, run: Run, reach: float):
        state = getattr(run, "state", None)
        rail = state.rail if isinstance(state, State) else None
        if rail is None:
            raise ValueError("Argument `run` must be of slipperjax.simulate, of a scene with a beam.")
        self.run = run
        self.reach = number(positive, "reach", reach)
        self.most = DEFLECTION.shown(float(np.max(np.abs(rail.deflection)))) or 1.0
        self.places = np.linspace(-self.reach, self.reach, 801)
        self.nodes = np.asarray(contact_points(run.scene).arm[0]).reshape(run.scene.nodes[1], -1)[:, 0]

        moved = np.abs(np.asarray(rail.deflection)).max(axis=(0, 2))
        # rounding errors of a motion in one direction are none of the other
        self.directions = np.flatnonzero(moved > 1e-6 * moved.max())

    @functools.cached_property
    def speed(self) -> str:
        """The speed, and how it compares to those at which waves travel with a load."""
        scene = self.run.scene
        critical = np.asarray(scene.beam.critical_speed)[self.directions]
        ratios = " and ".join(f"{float(scene.speed) / one:.2g}" for one in critical)
        return f"{float(scene.speed):g} m/s, {ratios} of the critical speed"

    def shapes(self, k: int) -> Float[np.ndarray, "rails 2 places"]:
        """Return the lateral and vertical deflections of the rails at the state with index `k` [m]."""
        real, imag = (np.asarray(part[k]).sum(axis=2) for part in self.run.state.rail.waves)
        turn = np.outer(self.run.scene.beam.wave_numbers, self.places)
        return real @ np.cos(turn) - imag @ np.sin(turn)

    def draw(self, ax: Axes) -> None:
        """Draw lines of the directions in which rails bend, and the dots and words that change with them."""
        self.lines: list[tuple[int, int, Line2D]] = []
        for rail, name in enumerate(self.run.scene.track.rails or ("",)):
            for direction in self.directions:
                words = f"{name} {DIRECTIONS[direction]}".strip()
                (line,) = ax.plot(self.places, np.zeros_like(self.places), lw=1.1, label=words)
                self.lines.append((rail, int(direction), line))
        self.dots = ax.scatter([], [], s=12, color="black", zorder=3, label="ends of slippers")
        self.words = ax.text(0.01, 0.95, "", transform=ax.transAxes, va="top", fontsize=7)
        ax.set_xlim(-self.reach, self.reach)
        ax.set_xlabel(with_unit("distance ahead of the centre of mass", "m", brackets=True))
        ax.set_ylabel(with_unit("deflection", DEFLECTION.display_unit, brackets=True))

    def show(self, k: int) -> list[Artist]:
        """Draw the state with index `k`; return the artists that changed."""
        shapes = DEFLECTION.shown(self.shapes(k))
        for rail, direction, line in self.lines:
            line.set_ydata(shapes[rail, direction])
        pressed = DEFLECTION.shown(np.asarray(self.run.state.rail.deflection[k]))[self.directions]
        self.dots.set_offsets(np.column_stack([np.tile(self.nodes, len(pressed)), np.ravel(pressed)]))
        force = np.linalg.norm(np.asarray(self.run.reactions.contact_force[k]), ord=1)
        time = 1e3 * float(self.run.time[k])
        self.words.set_text(f"{self.speed}; {time:.2f} ms, contact forces {force / 1e3:.1f} kN")
        return [self.dots, self.words, *(line for *_, line in self.lines)]
