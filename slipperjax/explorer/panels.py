"""The right side of the page: one case around the rail head, over time, and in the plane of a coordinate."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, CustomJS, Div, Row, Select, Slider, Toggle
from bokeh.plotting import figure

from ..flow.status import Status, is_lost
from ..model.parameters import PARAMETERS, quantity
from ..model.quantities import SECTIONS
from ..plots.sections import frames_of, label_places, rail_outline
from ..plots.style import COLORS
from ..plots.trajectories import most_loaded
from .pictures import label, slipper_columns
from .session import SETTLED, SLIDERS, Shown

_PARTS = (Path(__file__).parent / "page.js").read_text().split("//// ")[1:]
CODE = {part.partition("\n")[0].partition(":")[0]: part.partition("\n")[2] for part in _PARTS}
"""Scripts of the browser by name: the parts of page.js, each after a line with its name."""


def source(*columns: str) -> ColumnDataSource:
    """Return an empty data source with these columns."""
    return ColumnDataSource(data={name: [] for name in columns})


def panel(title: str, across: str = "", up: str = "", **options: object) -> figure:
    """Return a small figure with labelled axes."""
    options = dict(width=346, height=212, tools="wheel_zoom,pan,reset", toolbar_location=None) | options
    f: Any = figure(title=title, x_axis_label=across, y_axis_label=up, **options)
    f.title.text_font_size = "12px"
    f.axis.axis_label_text_font_size = "11px"
    f.axis.minor_tick_line_color = None
    return f


class Panels:
    """The right side of the page: one case."""

    def __init__(self, slippers: Sequence[str], chosen: Callable[[], None]):
        """**Arguments:** `slippers`: of a sled; `chosen`: called when another slipper, or motion, is chosen."""
        blue = COLORS["blue"]
        names = [(velocity, label(quantity(coordinate))) for velocity, coordinate in SECTIONS.items()]
        self.motion = Select(title="Motion shown below", options=names, value="v_z", width=225)
        self.slipper = Select(
            title="Slipper", options=[("", "all"), *slippers], value="", width=90, visible=bool(slippers)
        )
        self.title = Div(width=355 if slippers else 457, styles={"font-size": "12px"}, name="case")
        for choice in (self.motion, self.slipper):
            choice.on_change("value", lambda attr, old, new: chosen())
        self.time = panel("Motion over time", "forcing periods", name="time")
        self.phase = panel("Phase portrait, red once per period")
        self.forces = panel("Contact forces of points", "forcing periods", "force [kN]", width=692)
        self.curve = self.time.line([], [], color=blue).data_source
        self.orbit = self.phase.line([], [], color=blue, line_width=0.5).data_source
        self.strobe = self.phase.scatter([], [], color=COLORS["red"], size=5).data_source
        self.lines = source("xs", "ys", "name", "color", "dash")
        self.forces.multi_line(
            "xs", "ys", source=self.lines, color="color", line_dash="dash", line_width=1.5, legend_field="name"
        )
        self.forces.add_layout(self.forces.legend[0], "right")
        self.cursor = source("x")
        self.window = source("x")
        # the shown instant, and the window of a run
        for f in (self.time, self.forces):
            f.vspan("x", source=self.cursor, color="black")
            f.vspan("x", source=self.window, color=COLORS["orange"], line_width=2)
        self.root = column(
            row(self.title, self.slipper, self.motion), *self._slipper(), row(self.time, self.phase), self.forces
        )

    def _slipper(self) -> list[Row]:
        """Return the panels of both ends, with the slider of instants. The browser plays them without the server."""
        self.frames = source()
        self.ends = {}
        args: dict[str, object] = {}
        figures = []
        # the same glyphs at both ends; the browser sets their data for each instant
        for end in ("front", "rear"):
            f = panel("Slipper around the rail head", "y [mm]", "z [mm]", height=250, match_aspect=True)
            rail = f.patch([], [], color="#d9d9d9", line_color="#8a8a8a").data_source
            slipper = f.patch([], [], color=COLORS["blue"], fill_alpha=0.4).data_source
            dots = source("x", "y", "tip_x", "tip_y", "color", "alpha", "name", "at_x", "at_y")
            f.segment("x", "y", "tip_x", "tip_y", source=dots, color="color", line_width=4)
            f.scatter("x", "y", source=dots, size=8, line_color="color", fill_color="color", fill_alpha="alpha")
            text = dict(text_font_size="10px", text_align="center", text_baseline="middle")
            f.text("at_x", "at_y", "name", source=dots, **text)
            args |= {end: slipper, f"{end}_dots": dots}
            self.ends[end] = f, rail, dots
            figures.append(f)
        self.instant = Slider(start=0, end=79, value=0, step=1, title="instant", show_value=False, width=270)
        self.play = Toggle(label="Play", width=70, name="play")
        self.scale = Div(width=330)
        args |= dict(time=self.instant, frames=self.frames, cursor=self.cursor)
        show = CustomJS(args=args, code=CODE["show"])
        self.instant.js_on_change("value", show)
        self.frames.js_on_change("data", show)
        args = dict(toggle=self.play, time=self.instant)
        self.play.js_on_change("active", CustomJS(args=args, code=CODE["play"]))
        return [row(*figures), row(self.play, self.instant, self.scale)]

    def show(self, shown: Shown | None) -> None:
        """Draw a case, if there is one already."""
        if shown is None:
            return
        velocity = self.motion.value
        coordinate = SECTIONS[velocity]
        across, up = quantity(coordinate), quantity(velocity)
        plane = lambda ds: dict(x=across.shown(ds[coordinate].values), y=up.shown(ds[velocity].values))
        window = shown.case.window  # None for a steady motion
        self.title.text = _words(shown)
        last = phase = shown.ds
        # a steady motion is drawn over its last periods, a run over all periods
        if window is None:
            every = (shown.ds.sizes["time"] - 1) // SETTLED
            self.strobe.data = plane(shown.ds.isel(time=slice(None, None, every)))
            last = shown.ds.isel(time=slice(-4 * every - 1, None))  # forcing periods
            phase = shown.ds.isel(time=slice(-64 * every - 1, None))
        else:
            self.time.xaxis.axis_label = self.forces.xaxis.axis_label = "distance [m]"
            self.window.data = {"x": window}
        time = last["period"].values * shown.unit
        self.curve.data = {"x": time, "y": across.shown(last[coordinate].values)}
        self.orbit.data = plane(phase)
        # peaks of the whole run may be before the drawn part
        lines = most_loaded(last.drop_vars(["peak_force", "peak_period"], errors="ignore"), 6, self.slipper.value)
        # points in contact
        lines = [line for line in lines if line.peak > 0]
        self.lines.data = {
            "xs": [time for _ in lines],
            "ys": [line.force for line in lines],
            "name": [line.name for line in lines],
            "color": [line.style["color"] for line in lines],
            "dash": ["solid" if line.style["ls"] == "-" else "dashed" for line in lines],
        }
        self.time.yaxis.axis_label = self.phase.xaxis.axis_label = label(across)
        self.phase.yaxis.axis_label = label(up)
        self._show_slipper(shown)

    def _show_slipper(self, shown: Shown) -> None:
        steady = shown.case.window is None
        # a browser easily draws some hundred instants
        ds = shown.ds if steady else shown.ds.thin(time=-(-shown.ds.sizes["time"] // 640))
        try:
            frames = frames_of(ds, shown.run.scene, last=2.0 if steady else None)
        except ValueError:  # the motion is not finite
            return
        # among all slippers, the one with the highest force
        wanted = [of for of in frames if self.slipper.value in ("", of.name)]
        drawn = max(wanted, key=lambda of: of.force.max())
        head = rail_outline(drawn.shape)
        places = label_places(drawn.shape)
        zero = np.zeros(len(places))
        # parts that do not move; all others follow from the frames
        for k, (end, (f, rail, dots)) in enumerate(self.ends.items(), 1):
            f.title.text = f"{drawn.name or 'Slipper'} around the rail head, {end}"
            rail.data = {"x": head[:, 0], "y": head[:, 1]}
            dots.data = {
                **dict.fromkeys(("x", "y", "tip_x", "tip_y", "alpha"), zero),
                "at_x": places[:, 0],
                "at_y": places[:, 1],
                "color": drawn.colors,
                "name": [f"{name}{k}" for name in drawn.shape.names],
            }
        self.frames.data = slipper_columns(drawn, shown.unit)
        # begin with the highest force
        self.instant.end = len(drawn.period) - 1
        self.instant.value = int(np.argmax(drawn.force.max(axis=(1, 2))))
        longest = "lines are forces"
        if not is_lost(int(shown.run.status)):
            longest += f", the longest {float(drawn.force.max()) / 1e3:.3g} kN"
        self.scale.text = f"displacements × {drawn.magnify:g}; {longest}; filled: touches"


def _words(shown: Shown) -> str:
    """Return a case in two lines of HTML: its parameters, and its motion."""
    scene = shown.case.scene
    words = []
    for name in SLIDERS:
        q = PARAMETERS[name]
        value = q.of(scene)
        # parameters with a single number
        if value is not None and np.ndim(value) == 0:
            words.append(f"{q.name} {float(q.shown(float(value))):.4g} {q.display_unit}".removesuffix(" 1"))
    kind = f"period {shown.period}" if shown.kind == "period" else shown.kind
    if shown.case.window is not None:
        begin, end = shown.case.window
        kind = f"{begin:.6g} to {end:.6g} m"
    status = Status(int(shown.run.status))
    said = f"<b>{kind}</b>"
    # the status comes first, and numbers of a lost motion mean nothing
    if status != Status.FINITE:
        said += f'; <span style="color:{COLORS["red"]}">{html.escape(str(status))}</span>'
    if is_lost(status):
        return f"<b>{', '.join(words)}</b><br>{said}"
    peak = shown.run.peak
    force = "no contact"
    if float(peak.force) > 0:
        at = scene.point_names[int(peak.point)]
        force = f"highest force {float(peak.force) / 1e3:.3g} kN at {html.escape(at)}"
    return f"<b>{', '.join(words)}</b><br>{said}; {force}"
