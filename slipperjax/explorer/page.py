"""The page: a map on the left, the case that was clicked on the right. Bokeh draws, `Session` computes."""

import base64
import functools
import html
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from bokeh.events import DocumentReady, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    Div,
    HoverTool,
    LabelSet,
    LinearColorMapper,
    Range1d,
    Select,
    Slider,
    TextInput,
    Toggle,
)
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from ..flow.status import Status
from ..model.quantities import PARAMETERS, SECTIONS, quantity
from ..model.scene import scene_to_toml
from ..orbits.branches import OrbitBranch
from ..orbits.periodic import PeriodicOrbit
from ..plots.style import COLORS
from . import pictures, scripts
from .session import SLIDERS, Case, Session, Shown, View
from .worker import Worker

LEFT, RIGHT, LOW = 560, 352, 218
"""Width of the left side, and width and height of the panels on the right [pixels]."""
STARTS = {
    "map": "from the map's start",
    "picked": "from the state clicked in the section",
    "end": "from the end of the case before",
}
"""Choices of a start."""
REFRESH = 2000
"""Milliseconds between two looks at a growing store."""
PATIENCE = 10.0
"""Seconds that a computation waits for the page to take a piece."""
HELP = (
    "Click a point: that case. Drag a box: computed finer. Keys: arrows to the neighbour, [ and ] back and forward, "
    "Esc stop, space play."
)
SHOW = """
const k = time.value, f = frames.data
const put = (source, columns) => {
  const data = {}
  for (const [name, key] of Object.entries(columns)) {
    const all = f[key], n = all.length / count
    data[name] = Array.from({length: n}, (_, i) => all[k * n + i])
  }
  source.data = {...source.data, ...data}
}
for (const [end, patch, dots] of [["front", front, front_dots], ["rear", rear, rear_dots]]) {
  put(patch, {x: end + "_corner_y", y: end + "_corner_z"})
  put(dots, {x: end + "_point_y", y: end + "_point_z", tip_x: end + "_tip_y", tip_y: end + "_tip_z", force: end + "_force"})
  dots.data = {...dots.data, alpha: Array.from(dots.data.force, (v) => v > 0 ? 1 : 0)}
}
cursor.data = {x: [f.period[k]]}
"""
PLAY = """
clearInterval(window.slipper_timer)
if (toggle.active) window.slipper_timer = setInterval(() => { time.value = (time.value + 1) % (time.end + 1) }, 50)
toggle.label = toggle.active ? "Pause" : "Play"
"""
KEYS = """
window.addEventListener("keydown", (event) => {
  const path = event.composedPath(), typed = path[0].tagName
  if (typed == "INPUT" || typed == "SELECT" || path.some((e) => e.classList && e.classList.contains("noUi-handle"))) return
  if (["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "[", "]", "Escape"].includes(event.key)) {
    keys.value = event.key + " " + Date.now()
    event.preventDefault()
  } else if (event.key == " " && typed != "BUTTON") { toggle.active = !toggle.active; event.preventDefault() }
})
"""
COPY = """
const text = texts.data.python[0]
const old_way = () => {
  const area = document.createElement("textarea")
  area.value = text; document.body.appendChild(area); area.select(); document.execCommand("copy"); area.remove()
}
if (navigator.clipboard) navigator.clipboard.writeText(text).catch(old_way)
else old_way()
"""
SAVE = """
const [content, name] = %s
if (!content) return
const link = document.createElement("a")
link.href = URL.createObjectURL(new Blob([content], {type: "application/octet-stream"}))
link.download = name
link.click()
"""
SAVE_SCENE = SAVE % '[texts.data.toml[0], "scene.toml"]'
SAVE_PICTURE = SAVE % '[Uint8Array.from(atob(texts.data.png[0]), (c) => c.charCodeAt(0)), "slipper.png"]'


class Page:
    """One window."""

    def __init__(self, doc: Any, session: Session, keep: Callable[[Session], None]):
        """**Arguments:** `keep`: called with the session when it changes, so that another window can go on."""
        self.doc, self.session, self.keep = doc, session, keep
        self.quiet = False  # whether widgets are set by the page and not by a hand
        self.asked = 0.0
        workers = {
            name: (Worker(self._deliver(got), self._failed, self._ended))
            for name, got in (("map", self._got_view), ("case", self._got_case), ("file", self._got_picture))
        }
        self.workers = workers
        self._make_left()
        self._make_right()
        doc.title = "slipperjax explore"
        doc.add_root(column(self._header(), row(self.left, self.right, spacing=14), styles={"padding": "6px 10px"}))
        doc.js_on_event(DocumentReady, CustomJS(args=dict(keys=self.keys, toggle=self.play), code=KEYS))
        doc.on_session_destroyed(lambda context: self.close())
        self._show_view()
        view = session.view
        if view.growing:
            doc.add_periodic_callback(self._refresh, REFRESH)
        if session.case is not None:
            self._look(session.case)
        if view.ds is None:
            self._compute(view)

    def close(self) -> None:
        """Ends its computations."""
        for worker in self.workers.values():
            worker.close()

    # --- what computes ----------------------------------------------------------------------------------------------

    def _deliver(self, got: Callable[[Any], None]) -> Callable[[Any], None]:
        """Makes a function that hands a piece from a worker's thread to the page, and waits until it is there."""

        def deliver(piece: Any) -> None:
            there = threading.Event()

            def take() -> None:
                try:
                    got(piece)
                finally:
                    there.set()

            self.doc.add_next_tick_callback(take)
            there.wait(PATIENCE)

        return deliver

    def _failed(self, error: Exception) -> None:
        text = " ".join(str(error).split()) or type(error).__name__
        self.doc.add_next_tick_callback(lambda: self._say(text, wrong=True))

    def _ended(self) -> None:
        self.doc.add_next_tick_callback(lambda: self._say())

    def _say(self, text: str = "", share: float | None = None, *, wrong: bool = False) -> None:
        """Writes the line of what happens, with a bar where it is known how far it is."""
        bar = "" if share is None else f'<progress value="{share:.3f}" style="width:140px"></progress> '
        self.line.text = (
            f'{bar}<span style="color:{COLORS["red"] if wrong else "#222"}">{html.escape(text or HELP)}</span>'
        )

    def _compute(self, view: View) -> None:
        self._say("computing the map; the first time its program is compiled, which takes a while", 0.0)
        self.workers["map"].submit(lambda: self.session.compute(view))

    def _got_view(self, piece: tuple[View, float]) -> None:
        view, share = piece
        self.session.views[self.session.at] = view
        if share < 1:
            self._say("computing the map", share)
        self._show_view()

    def _look(self, case: Case) -> None:
        self.asked = time.perf_counter()
        session = self.session
        session.case, session.orbit, session.branch = case, None, None
        self._set_sliders(case)
        self._mark()
        self.workers["case"].submit(lambda: session.look(case))

    def _got_case(self, piece: Any) -> None:
        if isinstance(piece, Shown):
            self.session.shown = piece
            self._show_case()
        elif isinstance(piece, PeriodicOrbit):
            self.session.orbit = piece if int(piece.status) == Status.FINITE else None
            self._show_orbit()
        elif isinstance(piece, OrbitBranch):
            self.session.branch = piece
            self._say(f"following the branch: {piece.points.sizes['point']} orbits, {len(piece.events)} events")
            self._show_branch()
        else:
            self._show_window(piece)
        self._write_texts()

    def _refresh(self) -> None:
        if self.session.refreshed() is not None:
            self._show_view()

    # --- the left side ----------------------------------------------------------------------------------------------

    def _header(self) -> Any:
        buttons = {}
        for name, text, act in (
            ("back", "◀ Back", lambda: self._step(-1)),
            ("forward", "Forward ▶", lambda: self._step(1)),
            ("stop", "■ Stop", self._stop),
            ("copy", "Copy as Python", None),
            ("scene", "Save scene", None),
            ("picture", "Save picture", lambda: self.workers["file"].submit(self._draw_picture)),
        ):
            buttons[name] = Button(label=text, width=112, name=name)
            if act is not None:
                buttons[name].on_click(act)
        self.back, self.forward = buttons["back"], buttons["forward"]
        self.texts = ColumnDataSource(data={"python": [""], "toml": [""], "png": [""]})
        self.png = ColumnDataSource(data={"png": []}, name="png")
        buttons["copy"].js_on_click(CustomJS(args=dict(texts=self.texts), code=COPY))
        buttons["copy"].on_click(lambda: self._say("the script is in the clipboard"))
        buttons["scene"].js_on_click(CustomJS(args=dict(texts=self.texts), code=SAVE_SCENE))
        self.png.js_on_change("data", CustomJS(args=dict(texts=self.png), code=SAVE_PICTURE))
        self.keys = TextInput(visible=False)
        self.keys.on_change("value", lambda *change: self._key(change[2].rpartition(" ")[0]))
        self.line = Div(width=LEFT, styles={"font-size": "13px", "line-height": "1.25"}, name="line")
        self._say()
        return row(*buttons.values(), self.line, self.keys)

    def _make_left(self) -> None:
        self.choice = Select(title="Colours", options=[], width=200)
        self.choice.on_change("value", self._chosen)
        self.begin = Select(title="Start of the next case", options=list(STARTS.items()), value="map", width=250)
        self.legend = Div(width=LEFT, styles={"font-size": "12px", "line-height": "1.7"})
        self.map = figure(
            width=LEFT,
            height=430,
            tools="box_select,wheel_zoom,pan,reset,save",
            active_drag="box_select",
            x_range=Range1d(0, 1),
            y_range=Range1d(0, 1),
            toolbar_location="above",
            name="map",
        )
        self.map.toolbar.logo = None
        self.map.grid.visible = False
        self.map.on_event(Tap, lambda event: self._clicked(event.x, event.y))
        self.map.on_event(SelectionGeometry, self._boxed)
        self.pixels = ColumnDataSource(data={"image": [], "x": [], "y": [], "dw": [], "dh": []})
        self.mapper = LinearColorMapper(palette=["#ffffff"], nan_color="rgba(0,0,0,0)")
        self.image = self.map.image("image", "x", "y", "dw", "dh", color_mapper=self.mapper, source=self.pixels)
        self.bar = ColorBar(color_mapper=self.mapper, width=12, visible=False, title="")
        self.map.add_layout(self.bar, "right")
        self.points = ColumnDataSource(data={"x": [], "y": [], "color": []})
        self.map.scatter("x", "y", source=self.points, size=3, color="color")
        self.curve = ColumnDataSource(data={"x": [], "y": []})
        self.map.step("x", "y", source=self.curve, mode="before", color=COLORS["blue"])
        self.marks = {name: ColumnDataSource(data={"x": [], "y": []}) for name in ("case", "stable", "unstable")}
        for name, dash in (("stable", "solid"), ("unstable", "dashed")):
            for color, width in (("white", 5), ("black", 2)):
                self.map.line("x", "y", source=self.marks[name], color=color, line_width=width, line_dash=dash)
        self.events = ColumnDataSource(data={"x": [], "y": [], "label": [], "name": []})
        _event_marks(self.map, self.events)
        for color, width in (("white", 5), ("black", 2)):
            self.map.scatter(
                "x", "y", source=self.marks["case"], marker="cross", size=18, line_width=width, color=color
            )
        self.sliders = {}
        for name, (low, high) in SLIDERS.items():
            q = PARAMETERS[name]
            low, high = q.shown(low), q.shown(high)
            self.sliders[name] = Slider(
                start=low,
                end=high,
                value=low,
                step=(high - low) / 480,
                title=pictures.label(q),
                width=LEFT // 2 - 16,
                format="0[.]000",
                name=name,
            )
            self.sliders[name].on_change("value", functools.partial(self._slid, name))
        self.path = Select(title="Parameter of the branch", options=[], width=170)
        follow = Button(label="Follow the branch", width=150, name="follow")
        follow.on_click(self._follow)
        again = Button(label="Map with this case's values", width=200, name="again")
        again.on_click(lambda: self._show_new(self.session.with_case()))
        sliders = list(self.sliders.values())
        self.case_controls = column(
            row(*sliders[:2]), row(*sliders[2:]), row(self.path, column(Div(height=14), row(follow, again)))
        )
        self.code = Div(width=LEFT)
        self.left = column(row(self.choice, self.begin), self.legend, self.map, self.case_controls, self.code)

    def _show_view(self) -> None:
        """Draws the left side anew."""
        session, view = self.session, self.session.view
        self.keep(session.copied())
        self.back.disabled, self.forward.disabled = session.at == 0, session.at + 1 == len(session.views)
        options = pictures.choices(view)
        self.quiet = True
        self.choice.options = options
        self.choice.value = self.choice.value if self.choice.value in options else (options or [""])[0]
        names = [n for n in ([] if view.is_run else view.names) if not n.startswith("start_")]
        self.path.options = list(dict.fromkeys([*reversed(names), *SLIDERS]))
        self.path.value = self.path.value if self.path.value in self.path.options else self.path.options[0]
        self.quiet = False
        self.begin.visible = self.case_controls.visible = not view.is_run
        empty: dict[str, Any] = {"image": [], "x": [], "y": [], "dw": [], "dh": []}
        pixels, points, curve = empty, {"x": [], "y": [], "color": []}, {"x": [], "y": []}
        self.legend.text, self.bar.visible = "", False
        if view.is_run:
            curve = pictures.along(view.ds)
            self._axes("distance [m]", "highest contact force [kN]", curve["x"], np.append(curve["y"], 0.0))
        elif len(view.names) == 1:
            (name,) = view.names
            q, x = view.quantity(name), view.quantity(name).shown(view.axis(name))
            y = np.array([0.0, 1.0])
            text = self.choice.value
            if view.ds is not None:
                xs, y, text = pictures.dots(view, self.choice.value)
                points = {"x": xs, "y": y, "color": [COLORS["blue"]] * len(xs)}
            self._axes(pictures.label(q), text, x, y if len(y) else np.array([0.0, 1.0]))
        else:
            (up, across), ds = view.names, view.ds
            (qx, qy) = view.quantity(across), view.quantity(up)
            x, y = qx.shown(view.axis(across)), qy.shown(view.axis(up))
            grid = ds is None or ds["status"].ndim == 2
            ends = (pictures.cells(x), pictures.cells(y)) if grid else (x, y)
            self._axes(pictures.label(qx), pictures.label(qy), *ends, margin=0.0 if grid else 0.02)
            if ds is not None:
                picture = pictures.picture_of(view, self.choice.value)
                self._color(picture)
                if grid:
                    pixels = pictures.image(x, y, picture.values)
                else:
                    points = {"x": x, "y": y, "color": self._colors(picture.values)}
        self.pixels.data, self.points.data, self.curve.data = pixels, points, curve
        self._mark()
        self._show_branch()
        self._write_texts()

    def _axes(self, across: str, up: str, x: np.ndarray, y: np.ndarray, margin: float = 0.02) -> None:
        self.map.xaxis.axis_label, self.map.yaxis.axis_label = across, up
        for range_, values in ((self.map.x_range, x), (self.map.y_range, y)):
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            wide = margin * (high - low) or (0.0 if high > low else 0.5)
            range_.update(start=low - wide, end=high + wide, reset_start=low - wide, reset_end=high + wide)

    def _color(self, picture: pictures.Picture) -> None:
        if picture.names:
            square = '<span style="display:inline-block;width:12px;height:12px;background:{};border:1px solid #777"></span>&nbsp;{}'
            pairs = [*zip(picture.colors, picture.names, strict=True)]
            if np.isnan(picture.values).any():
                pairs.append(("#ffffff", "not computed yet"))
            self.legend.text = " &ensp; ".join(
                square.format(color, html.escape(name).replace(" ", "&nbsp;")) for color, name in pairs
            )
            self.mapper.update(palette=picture.colors, low=-0.5, high=len(picture.names) - 0.5)
        else:
            finite = picture.values[np.isfinite(picture.values)]
            low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
            self.mapper.update(palette=list(Cividis256), low=low, high=high if high > low else low + 1.0)
            self.legend.text = html.escape(picture.label)
            self.bar.visible = True

    def _colors(self, values: np.ndarray) -> list[str]:
        """The colour bar's colours of numbers."""
        low, high, palette = self.mapper.low, self.mapper.high, self.mapper.palette
        share = np.nan_to_num((values - low) / (high - low), nan=0.0)
        index = np.clip((share * len(palette)).astype(int), 0, len(palette) - 1)
        return [palette[k] if np.isfinite(v) else "#dddddd" for k, v in zip(index, values, strict=True)]

    def _mark(self) -> None:
        """Draws a cross where the case is."""
        place, view = self.session.place(), self.session.view
        data: dict[str, list[float]] = {"x": [], "y": []}
        if place is not None:
            shown = [float(view.quantity(name).shown(p)) for name, p in zip(view.names, place, strict=True)]
            data = {"x": [shown[-1]], "y": [shown[0] if len(shown) == 2 else self.map.y_range.start]}
        self.marks["case"].data = data

    def _si(self, x: float, y: float) -> list[float]:
        """A place of the map along the names of the view [SI units]."""
        names = self.session.view.names
        return [
            float(self.session.view.quantity(n).from_shown(p))
            for n, p in zip(names, (y, x)[-len(names) :], strict=True)
        ]

    def _clicked(self, x: float, y: float) -> None:
        if self.session.view.is_run:
            self.marks["case"].data = {"x": [x], "y": [0.0]}
            self._say("running over that window once more, with its neighbours")
            self.workers["case"].submit(lambda: self.session.window(x))
            return
        case = self.session.case_at(self.session.nearest(*self._si(x, y)))
        self._look(self.session.begun(case, self.begin.value))

    def _boxed(self, event: Any) -> None:
        ends = event.geometry
        if not event.final or ends.get("type") != "rect" or self.session.view.is_run:
            return
        low, high = self._si(ends["x0"], ends["y0"]), self._si(ends["x1"], ends["y1"])
        self._show_new(self.session.box(*zip(low, high, strict=True)))

    def _show_new(self, view: View | None) -> None:
        """Shows a view, and computes it."""
        if view is not None:
            self.session.show(view)
            self._show_view()
            self._compute(view)

    def _step(self, by: int) -> None:
        self.workers["map"].stop()
        if self.session.move(by):
            self._show_view()
            self._say()

    def _stop(self) -> None:
        for worker in self.workers.values():
            worker.stop()
        self._say("stopped; what was finished is kept")

    def _key(self, key: str) -> None:
        steps = {"ArrowLeft": (0, -1), "ArrowRight": (0, 1), "ArrowUp": (1, 0), "ArrowDown": (-1, 0)}
        if key == "Escape":
            self._stop()
        elif key in ("[", "]"):
            self._step(1 if key == "]" else -1)
        elif key in steps and (place := self.session.place()) is not None:
            index = self.session.nearest(*place)
            names, by = self.session.view.names, steps[key]
            by = by if len(names) == 2 else by[1:]
            if "case" not in index:
                moved = {
                    n: int(np.clip(index[n] + b, 0, len(self.session.view.axis(n)) - 1))
                    for n, b in zip(names, by, strict=True)
                }
                self._look(self.session.begun(self.session.case_at(moved), self.begin.value))

    def _chosen(self, attr: str, old: str, new: str) -> None:
        view = self.session.view
        if self.quiet:
            return
        if view.grid is not None and view.ds is not None and new not in view.ds and new not in ("motion", "regime"):
            import dataclasses

            again = dataclasses.replace(view, record=tuple(dict.fromkeys([*view.record, new])), ds=None)
            self.session.views[self.session.at] = again
            self._compute(again)
            return
        self._show_view()

    def _set_sliders(self, case: Case) -> None:
        self.quiet = True
        for name, slider in self.sliders.items():
            value = PARAMETERS[name].of(case.scene)
            slider.disabled = value is None or np.ndim(value) > 0
            if not slider.disabled:
                value = float(PARAMETERS[name].shown(float(value)))
                slider.update(start=min(slider.start, value), end=max(slider.end, value), value=value)
        self.quiet = False

    def _slid(self, name: str, attr: str, old: float, new: float) -> None:
        case = self.session.case
        if self.quiet or case is None:
            return
        import dataclasses

        scene = case.scene.replace(**{name: float(PARAMETERS[name].from_shown(new))})
        self._look(self.session.begun(dataclasses.replace(case, scene=scene, steps=None), self.begin.value))

    def _follow(self) -> None:
        if self.session.orbit is None:
            self._say("a branch needs a periodic orbit: click a case of a period first", wrong=True)
            return
        self._say("following the branch; the first time its programs are compiled, which takes a while")
        name = self.path.value
        self.workers["case"].submit(lambda: self.session.follow(name))

    # --- the right side ---------------------------------------------------------------------------------------------

    def _make_right(self) -> None:
        self.title = Div(width=2 * RIGHT - 180, styles={"font-size": "14px", "line-height": "1.35"}, name="case")
        names = [(v, f"{q}, {v}".replace("_", " ")) for v, q in SECTIONS.items()]
        self.motion = Select(title="Motion", options=names, value="v_z", width=160)
        self.motion.on_change("value", lambda *_: self._show_case())
        self._make_slipper()
        empty = lambda *columns: ColumnDataSource(data={name: [] for name in columns})
        self.data = {name: empty("x", "y") for name in ("time", "phase", "section", "spectrum", "circle")}
        self.lines = empty("xs", "ys", "name", "color", "dash")
        self.panels = {
            "time": _panel("Motion", "forcing periods", ""),
            "forces": _panel("Contact forces of points", "forcing periods", "force [kN]"),
            "phase": _panel("Phase portrait", "", ""),
            "section": _panel("Section once per period: click a start", "", ""),
            "spectrum": _panel("Spectrum", "multiples of the forcing frequency", "", y_axis_type="log"),
            "circle": _panel("Multipliers of the orbit", "real part", "imaginary part", match_aspect=True),
        }
        blue = COLORS["blue"]
        self.panels["time"].line("x", "y", source=self.data["time"], color=blue)
        _force_lines(self.panels["forces"], self.lines)
        self.panels["phase"].line("x", "y", source=self.data["phase"], color=blue, line_width=0.5)
        self.panels["phase"].scatter("x", "y", source=self.data["section"], color=COLORS["red"], size=4)
        self.panels["section"].scatter("x", "y", source=self.data["section"], color=COLORS["red"], size=4)
        self.panels["section"].on_event(Tap, lambda event: self._picked(event.x, event.y))
        self.panels["spectrum"].line("x", "y", source=self.data["spectrum"], color=blue)
        for name in ("time", "forces"):
            self.panels[name].vspan("x", source=self.cursor, color="black", line_width=1)
        turn = np.linspace(0, 2 * np.pi, 90)
        self.panels["circle"].line(np.cos(turn), np.sin(turn), color=COLORS["grey"])
        self.panels["circle"].scatter("x", "y", source=self.data["circle"], size=7, color=blue, line_color="white")
        self.branch_panel = _panel("Branch of the orbit", "", "", width=2 * RIGHT, visible=False, name="branch")
        self.branch_data = {name: empty("x", "y") for name in ("stable", "unstable")}
        for name, dash in (("stable", "solid"), ("unstable", "dashed")):
            self.branch_panel.line(
                "x", "y", source=self.branch_data[name], color=blue, line_dash=dash, line_width=2, legend_label=name
            )
        self.branch_events = empty("x", "y", "label", "name")
        _event_marks(self.branch_panel, self.branch_events)
        self.window_lines = empty("xs", "ys", "name", "color", "dash")
        self.window = _panel(
            "Contact forces in the window and before", "distance [m]", "force [kN]", width=2 * RIGHT, height=420
        )
        _force_lines(self.window, self.window_lines)
        names = list(self.panels)
        rows = [row(self.panels[a], self.panels[b]) for a, b in zip(names[::2], names[1::2], strict=True)]
        self.case_panels = column(
            row(self.ends["front"], self.ends["rear"]),
            row(self.play, self.time, self.scale),
            *rows,
            self.branch_panel,
        )
        self.right = column(row(self.title, self.motion), self.case_panels, self.window)

    def _make_slipper(self) -> None:
        self.ends, self.rails, self.outlines, self.dots = {}, {}, {}, {}
        self.cursor, self.frames = ColumnDataSource(data={"x": []}), ColumnDataSource(data={})
        for end in ("front", "rear"):
            self.ends[end] = f = _panel(f"Slipper around the rail head, {end}", "y [mm]", "z [mm]", match_aspect=True)
            self.rails[end] = ColumnDataSource(data={"x": [], "y": []})
            self.outlines[end] = ColumnDataSource(data={"x": [], "y": []})
            self.dots[end] = ColumnDataSource(
                data={n: [] for n in ("x", "y", "tip_x", "tip_y", "color", "alpha", "name", "at_x", "at_y", "force")}
            )
            f.patch("x", "y", source=self.rails[end], color="#d9d9d9", line_color="#8a8a8a")
            f.patch("x", "y", source=self.outlines[end], color=COLORS["blue"], fill_alpha=0.4)
            f.segment("x", "y", "tip_x", "tip_y", source=self.dots[end], color="color", line_width=4)
            f.scatter(
                "x", "y", source=self.dots[end], size=8, line_color="color", fill_color="color", fill_alpha="alpha"
            )
            f.text(
                "at_x",
                "at_y",
                "name",
                source=self.dots[end],
                text_font_size="10px",
                text_align="center",
                text_baseline="middle",
            )
        self.time = Slider(start=0, end=79, value=79, step=1, title="instant", show_value=False, width=280)
        self.play = Toggle(label="Play", width=70, name="play")
        self.scale = Div(width=330, styles={"font-size": "12px"})
        args = dict(
            time=self.time,
            frames=self.frames,
            front=self.outlines["front"],
            rear=self.outlines["rear"],
            front_dots=self.dots["front"],
            rear_dots=self.dots["rear"],
            cursor=self.cursor,
            count=80,
        )
        self.time.js_on_change("value", CustomJS(args=args, code=SHOW))
        self.frames.js_on_change("data", CustomJS(args=args, code=SHOW))
        self.play.js_on_change("active", CustomJS(args=dict(toggle=self.play, time=self.time), code=PLAY))

    def _show_case(self) -> None:
        """Draws the case."""
        session, shown, velocity = self.session, self.session.shown, self.motion.value
        if shown is None:
            return
        coordinate = SECTIONS[velocity]
        status, unit = (
            Status(int(shown.run.status)),
            {name: pictures.label(quantity(name)) for name in (coordinate, velocity)},
        )
        self._title(shown, status)
        self.data["time"].data = pictures.over_time(shown, coordinate)
        self.panels["time"].yaxis.axis_label = unit[coordinate]
        self.lines.data = pictures.forces(shown)
        self.data["phase"].data = pictures.phase(shown, coordinate, velocity)
        self.data["section"].data = pictures.section(session, coordinate, velocity)
        for name in ("phase", "section"):
            self.panels[name].xaxis.axis_label, self.panels[name].yaxis.axis_label = unit[coordinate], unit[velocity]
        self.data["spectrum"].data = pictures.spectrum(shown, velocity)
        self.panels["spectrum"].yaxis.axis_label = f"density of {quantity(velocity).name}"
        drawn = pictures.slipper(shown)
        if drawn is not None:
            for end, number in (("front", 1), ("rear", 2)):
                self.rails[end].data = {"x": drawn.rail[:, 0], "y": drawn.rail[:, 1]}
                nothing = np.zeros(len(drawn.names))
                places = {
                    "at_x": drawn.places[:, 0],
                    "at_y": drawn.places[:, 1],
                    "name": [f"{n}{number}" for n in drawn.names],
                }
                if self.dots[end].data["name"] != places["name"]:
                    self.dots[end].data = {
                        **{n: nothing for n in ("x", "y", "tip_x", "tip_y", "alpha", "force")},
                        "color": drawn.colors,
                        **places,
                    }
            self.frames.data = drawn.frames
            self.scale.text = (
                f"displacements × {drawn.magnify:g}, longest line {drawn.highest:.3g} kN, filled: touches"
            )
        self._show_orbit()
        self._show_branch()

    def _title(self, shown: Shown, status: Status) -> None:
        scene, words = shown.case.scene, []
        for name in SLIDERS:
            q = PARAMETERS[name]
            if (value := q.of(scene)) is not None and np.ndim(value) == 0:
                words.append(f"{q.name} {float(q.shown(float(value))):.4g} {q.display_unit}".removesuffix(" 1"))
        kind = {"period": f"period {shown.period}", "torus": "quasi-periodic", "unresolved": "no period found"}.get(
            shown.kind, shown.kind
        )
        peak = f"; {shown.run.peak.text(scene)}" if status != Status.NOT_FINITE else ""
        wrong = (
            ""
            if status == Status.FINITE
            else f' <span style="color:{COLORS["red"]}">{html.escape(str(status))}</span>'
        )
        self.title.text = (
            f"<b>{', '.join(words)}</b><br><b>{kind}</b> {html.escape(f'{peak}, {shown.case.origin}')}{wrong}"
        )

    def _show_orbit(self) -> None:
        orbit = self.session.orbit
        mu = np.array([]) if orbit is None else np.asarray(orbit.multipliers)
        self.data["circle"].data = {"x": mu.real, "y": mu.imag}
        text = (
            "no orbit"
            if orbit is None
            else f"period {orbit.period}, {'stable' if orbit.stable else 'unstable'}, largest {abs(mu[0]):.3g}"
        )
        self.panels["circle"].title.text = f"Multipliers of the orbit: {text}"

    def _show_branch(self) -> None:
        branch, view = self.session.branch, self.session.view
        self.branch_panel.visible = branch is not None
        nothing: dict[str, Any] = {"x": [], "y": []}
        on_map: dict[str, Any] = {"stable": nothing, "unstable": nothing}
        marks: dict[str, Any] = nothing | {"label": [], "name": []}
        if branch is not None:
            coordinate = SECTIONS[self.motion.value]
            name = branch.parameter.name
            lines = pictures.branch_lines(branch, coordinate)
            self.branch_events.data = events = pictures.branch_events(branch, coordinate)
            for kind, (x, y) in lines.items():
                self.branch_data[kind].data = {"x": x, "y": y}
            self.branch_panel.xaxis.axis_label = pictures.label(branch.parameter)
            self.branch_panel.yaxis.axis_label = pictures.label(quantity(coordinate))
            self.branch_panel.title.text = (
                f"Branch of period {branch.period}: the state at the start of a forcing period"
            )
            if not view.is_run and name in view.names and len(view.names) == 2:
                k = view.names.index(name)
                other = view.names[1 - k]
                height = (
                    float(view.quantity(other).shown(float(branch.scene.value(other))))
                    if not other.startswith("start_")
                    else 0.0
                )
                axes = ("y", "x") if k == 0 else ("x", "y")
                on_map = {
                    kind: dict(zip(axes, (x, np.where(np.isnan(y), np.nan, height)), strict=True))
                    for kind, (x, y) in lines.items()
                }
                marks = {**events, axes[0]: events["x"], axes[1]: [height] * len(events["x"])}
        for kind, data in on_map.items():
            self.marks[kind].data = data
        self.events.data = marks

    def _picked(self, x: float, y: float) -> None:
        velocity = self.motion.value
        coordinate = SECTIONS[velocity]
        if self.session.shown is None or self.session.case is None:
            return
        self.session.pick(coordinate, velocity, quantity(coordinate).from_shown(x), quantity(velocity).from_shown(y))
        self.begin.value = "picked"
        self._look(self.session.begun(self.session.case, "picked"))

    def _show_window(self, ds: Any) -> None:
        self.window_lines.data = pictures.in_window(ds)
        self.title.text = f"<b>{float(ds['distance'][0]):.6g} to {float(ds['distance'][-1]):.6g} m</b>"

    # --- texts and files --------------------------------------------------------------------------------------------

    def _write_texts(self) -> None:
        session = self.session
        self.keep(session.copied())
        self.case_panels.visible, self.window.visible = not session.view.is_run, session.view.is_run
        text = scripts.python_of(session)
        scene = session.view.scene if session.case is None else session.case.scene
        try:
            toml = scene_to_toml(scene)
        except ValueError:
            toml = ""
        self.texts.data = {"python": [text], "toml": [toml], "png": [""]}
        self.code.text = f'<details><summary style="cursor:pointer">The script</summary><pre style="font-size:11px">{html.escape(text)}</pre></details>'

    def _draw_picture(self) -> Iterator[bytes]:
        """The case, or the run, as `slipperjax.plots` draws it."""
        import matplotlib

        matplotlib.use("Agg")
        from ..plots.runs import run_overview
        from ..plots.style import png
        from ..plots.trajectories import overview

        view, shown = self.session.view, self.session.shown
        if view.is_run or shown is not None:
            axes = run_overview(view.ds) if shown is None else overview(shown.run.to_xarray())
            yield png(np.ravel(axes)[0].figure, 200)

    def _got_picture(self, content: bytes) -> None:
        self.png.data = {"png": [base64.b64encode(content).decode()]}


def _panel(title: str, across: str, up: str, **options: Any) -> Any:
    options = dict(width=RIGHT, height=LOW, tools="wheel_zoom,pan,reset", toolbar_location=None) | options
    f = figure(title=title, x_axis_label=across, y_axis_label=up, **options)
    f.title.text_font_size, f.grid.grid_line_alpha = "12px", 0.4
    return f


def _force_lines(f: Any, source: Any) -> None:
    """Lines of forces with a legend of points."""
    f.multi_line("xs", "ys", source=source, color="color", line_dash="dash", legend_field="name", line_width=1.5)
    f.legend.update(
        location="top_left",
        label_text_font_size="10px",
        spacing=0,
        padding=3,
        background_fill_alpha=0.7,
        glyph_width=14,
    )


def _event_marks(f: Any, source: Any) -> None:
    marks = f.scatter("x", "y", source=source, marker="diamond", size=11, color=COLORS["orange"], line_color="black")
    f.add_layout(LabelSet(x="x", y="y", text="label", source=source, x_offset=5, y_offset=4, text_font_size="11px"))
    f.add_tools(HoverTool(renderers=[marks], tooltips=[("event", "@name"), ("at", "@x")]))
