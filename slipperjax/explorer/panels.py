"""The right side of the page: one case around the rail head, over time, in planes, and its orbit and branch."""

import html
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.events import Tap
from bokeh.layouts import column, row
from bokeh.models import (
    ColumnDataSource,
    CustomJS,
    Div,
    HoverTool,
    LabelSet,
    Legend,
    LegendItem,
    Select,
    Slider,
    Toggle,
)
from bokeh.plotting import figure

from ..flow.status import Status
from ..model.parameters import PARAMETERS, quantity
from ..model.quantities import SECTIONS
from ..plots.style import COLORS
from . import pictures
from .session import SLIDERS, Session, Shown, no_orbit

WIDTH, LOW = 346, 212
"""Width and height of a panel [pixels]."""
_PARTS = (Path(__file__).parent / "page.js").read_text().split("//// ")[1:]
CODE = {part.partition("\n")[0].partition(":")[0]: part.partition("\n")[2] for part in _PARTS}
"""Bodies of callbacks by name."""
KINDS = {"torus": "quasi-periodic", "unresolved": "no period found"}
"""Words for kinds of motions other than their own."""


def source(*columns: str) -> ColumnDataSource:
    """An empty source."""
    return ColumnDataSource(data={name: [] for name in columns})


def panel(title: str, across: str = "", up: str = "", **options: Any) -> Any:
    """A small figure."""
    options = dict(width=WIDTH, height=LOW, tools="wheel_zoom,pan,reset", toolbar_location=None) | options
    f: Any = figure(title=title, x_axis_label=across, y_axis_label=up, **options)
    f.title.text_font_size, f.axis.axis_label_text_font_size = "12px", "11px"
    f.grid.grid_line_alpha, f.axis.minor_tick_line_color = 0.4, None
    return f


def event_marks(f: Any) -> ColumnDataSource:
    """Marks of a branch's events, with their labels."""
    data = source("x", "y", "label", "name")
    marks = f.scatter("x", "y", source=data, marker="diamond", size=11, color=COLORS["orange"], line_color="black")
    f.add_layout(LabelSet(x="x", y="y", text="label", source=data, x_offset=5, y_offset=4, text_font_size="11px"))
    f.add_tools(HoverTool(renderers=[marks], tooltips=[("event", "@name"), ("at", "@x")]))
    return data


def _force_lines(f: Any) -> ColumnDataSource:
    """Lines of forces, with a legend of points beside them."""
    data = source("xs", "ys", "name", "color", "dash")
    lines = f.multi_line("xs", "ys", source=data, color="color", line_dash="dash", line_width=1.5)
    items = [LegendItem(label={"field": "name"}, renderers=[lines])]
    f.add_layout(Legend(items=items, label_text_font_size="10px", spacing=0, padding=2, glyph_width=16), "right")
    return data


class Panels:
    """The right side."""

    def __init__(self, picked: Callable[[float, float], None], chosen: Callable[[], None]):
        """**Arguments:** called with a place that is clicked in the section, and when another motion is chosen."""
        blue, red = COLORS["blue"], COLORS["red"]
        self.title = Div(width=2 * WIDTH - 180, styles={"font-size": "13px", "line-height": "1.35"}, name="case")
        names = [
            (v, quantity(q).long_name.removesuffix(" angle").removesuffix(" displacement"))
            for v, q in SECTIONS.items()
        ]
        self.motion = Select(title="Motion shown below", options=names, value="v_z", width=160)
        self.motion.on_change("value", lambda attr, old, new: chosen())
        self.cursor, self.window = source("x"), source("x")
        self.time = panel("Motion over time", "forcing periods", name="time")
        self.forces = panel("Contact forces of points", "forcing periods", "force [kN]")
        self.phase = panel("Phase portrait")
        shared = dict(x_range=self.phase.x_range, y_range=self.phase.y_range)
        self.section = panel("Section once per period: click a start", name="section", **shared)
        self.spectrum = panel("Spectrum", "multiples of the forcing frequency", y_axis_type="log")
        self.circle = panel("Multipliers", "real part", "imaginary part", match_aspect=True, name="circle")
        self.branch = panel("Branch", width=545, height=280, visible=False, name="branch")
        self.lines = _force_lines(self.forces)
        self.data = {name: source("x", "y") for name in ("time", "phase", "section", "spectrum", "circle")}
        for name in ("time", "phase", "spectrum"):
            getattr(self, name).line(
                "x", "y", source=self.data[name], color=blue, line_width=0.5 if name == "phase" else 1
            )
        for f in (self.phase, self.section):
            f.scatter("x", "y", source=self.data["section"], color=red, size=5)
        self.section.on_event(Tap, lambda event: picked(event.x, event.y))
        for f in (self.time, self.forces):
            f.vspan("x", source=self.cursor, color="black", line_width=1)
            f.vspan("x", source=self.window, color=COLORS["orange"], line_width=2)
        turn = np.linspace(0, 2 * np.pi, 90)
        self.circle.line(np.cos(turn), np.sin(turn), color=COLORS["grey"])
        self.circle.scatter("x", "y", source=self.data["circle"], size=7, color=blue, line_color="white")
        for name, dash in (("stable", "solid"), ("unstable", "dashed")):
            self.data[name] = source("x", "y")
            style = dict(color=blue, line_dash=dash, line_width=2, legend_label=name)
            self.branch.line("x", "y", source=self.data[name], **style)
        self.events = event_marks(self.branch)
        slipper = self._slipper()
        rows = (self.time, self.forces), (self.phase, self.section), (self.spectrum, self.circle)
        self.root = column(row(self.title, self.motion), *slipper, *(row(*pair) for pair in rows))

    def _slipper(self) -> list[Any]:
        self.frames, self.ends, self.dots, self.rails, args = source(), [], [], [], {}
        for end in ("front", "rear"):
            f = panel(f"Slipper around the rail head, {end}", "y [mm]", "z [mm]", height=250, match_aspect=True)
            rail, slipper = source("x", "y"), source("x", "y")
            dots = source("x", "y", "tip_x", "tip_y", "color", "alpha", "name", "at_x", "at_y")
            f.patch("x", "y", source=rail, color="#d9d9d9", line_color="#8a8a8a")
            f.patch("x", "y", source=slipper, color=COLORS["blue"], fill_alpha=0.4)
            f.segment("x", "y", "tip_x", "tip_y", source=dots, color="color", line_width=4)
            f.scatter("x", "y", source=dots, size=8, line_color="color", fill_color="color", fill_alpha="alpha")
            f.text(
                "at_x",
                "at_y",
                "name",
                source=dots,
                text_font_size="10px",
                text_align="center",
                text_baseline="middle",
            )
            args |= {end: slipper, f"{end}_dots": dots}
            self.ends.append(f)
            self.dots.append(dots)
            self.rails.append(rail)
        self.instant = Slider(start=0, end=79, value=0, step=1, title="instant", show_value=False, width=270)
        self.play = Toggle(label="Play", width=70, name="play")
        self.scale = Div(width=330, styles={"font-size": "12px"})
        show = CustomJS(
            args=dict(time=self.instant, frames=self.frames, cursor=self.cursor, **args), code=CODE["show"]
        )
        self.instant.js_on_change("value", show)
        self.frames.js_on_change("data", show)
        self.play.js_on_change("active", CustomJS(args=dict(toggle=self.play, time=self.instant), code=CODE["play"]))
        return [row(*self.ends), row(self.play, self.instant, self.scale)]

    @property
    def names(self) -> tuple[str, str]:
        """The coordinate that is shown, and its velocity."""
        return SECTIONS[self.motion.value], self.motion.value

    def show(self, session: Session) -> None:
        """Draws the case, its orbit and its branch."""
        shown, window = session.shown, session.case.window
        for f in (self.section, self.spectrum, self.circle):  # of steady motions
            f.visible = window is None
        if shown is None:
            return
        (coordinate, velocity), data = self.names, self.data
        across, up = (pictures.label(quantity(name)) for name in self.names)
        self.title.text = _words(shown)
        if window is None:
            data["section"].data = pictures.section(session, coordinate, velocity)
            data["spectrum"].data = pictures.spectrum(shown, velocity)
            self.spectrum.yaxis.axis_label = f"density of {velocity} [({quantity(velocity).unit})²/Hz]"
        else:
            self.time.xaxis.axis_label = self.forces.xaxis.axis_label = "distance [m]"
            self.window.data = {"x": window}
        data["time"].data = pictures.over_time(shown, coordinate)
        self.time.yaxis.axis_label = across
        self.lines.data = pictures.forces(shown)
        data["phase"].data = pictures.phase(shown, coordinate, velocity)
        for f in (self.phase, self.section):
            f.xaxis.axis_label, f.yaxis.axis_label = across, up
        if (drawn := pictures.slipper(shown)) is not None:
            for k, (dots, rail) in enumerate(zip(self.dots, self.rails, strict=True), 1):
                rail.data = {"x": drawn.rail[:, 0], "y": drawn.rail[:, 1]}
                here = {"at_x": drawn.places[:, 0], "at_y": drawn.places[:, 1], "color": drawn.colors}
                here |= {"name": [f"{name}{k}" for name in drawn.names]}
                zero = np.zeros(len(drawn.names))
                dots.data = {**here, **dict.fromkeys(("x", "y", "tip_x", "tip_y", "alpha"), zero)}
            self.frames.data, self.instant.end = drawn.frames, len(drawn.frames["x"]) - 1
            self.instant.value = drawn.busiest
            longest = f"lines are forces, the longest {drawn.highest:.3g} kN"
            self.scale.text = f"displacements × {drawn.magnify:g}; {longest}; filled: touches"
        self.show_orbit(session)
        self.show_branch(session)

    def show_orbit(self, session: Session, busy: bool = False) -> None:
        """Draws the orbit's multipliers.

        **Arguments:** `busy`: whether it is being looked for.
        """
        orbit = session.orbit
        mu = np.array([]) if orbit is None else np.asarray(orbit.multipliers)
        self.data["circle"].data = {"x": mu.real, "y": mu.imag}
        text = "looking for the orbit" if busy else "none found"
        if session.shown is not None and (reason := no_orbit(session.shown)):
            text = reason
        elif orbit is not None:
            text = f"period {orbit.period}, {'stable' if orbit.stable else 'unstable'}"
        self.circle.title.text = f"Multipliers: {text}"

    def show_branch(self, session: Session) -> None:
        """Draws the branch, with its events."""
        branch, coordinate = session.branch, self.names[0]
        self.branch.visible = branch is not None
        if branch is None:
            return
        for kind, (x, y) in pictures.branch_lines(branch, coordinate).items():
            self.data[kind].data = {"x": x, "y": y}
        self.events.data = pictures.branch_events(branch, coordinate)
        self.branch.xaxis.axis_label, self.branch.yaxis.axis_label = map(
            pictures.label, (branch.parameter, quantity(coordinate))
        )
        self.branch.title.text = f"Branch of period {branch.period}: the state at the start of a forcing period"


def _words(shown: Shown) -> str:
    """A case in two lines of HTML: its parameters, and what it does."""
    scene, words, status = shown.case.scene, [], Status(int(shown.run.status))
    for name in SLIDERS:
        q = PARAMETERS[name]
        if (value := q.of(scene)) is not None and np.ndim(value) == 0:
            words.append(f"{q.name} {float(q.shown(float(value))):.4g} {q.display_unit}".removesuffix(" 1"))
    kind = f"period {shown.period}" if shown.kind == "period" else KINDS.get(shown.kind, shown.kind)
    if shown.case.window is not None:
        begin, end, low, high = (*shown.case.window, *shown.unit * shown.ds["period"].values[[0, -1]])
        kind = f"{begin:.6g} to {end:.6g} m, drawn from {low:.6g} to {high:.6g} m"
    peak = shown.run.peak
    force = "no contact"
    if float(peak.force) > 0:
        at = f"{scene.section.names[int(peak.point)]}{int(peak.end) + 1}"
        force = f"highest force {float(peak.force) / 1e3:.3g} kN at {html.escape(at)}"
    wrong = f'<br><span style="color:{COLORS["red"]}">{html.escape(str(status))}</span>'
    said = "; ".join([f"<b>{kind}</b>", force, *filter(None, [html.escape(shown.case.origin)])])
    return f"<b>{', '.join(words)}</b><br>{said}{wrong * (status != Status.FINITE)}"
