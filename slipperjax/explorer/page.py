"""The page: a map on the left, the case that was clicked on the right. Bokeh draws, `Session` computes."""

import base64
import dataclasses
import functools
import html
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from typing import Any

import numpy as np
from bokeh.events import DocumentReady, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import Button, ColorBar, CustomJS, Div, LinearColorMapper, Range1d, Select, Slider, TextInput
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from ..flow.status import Status
from ..model.parameters import PARAMETERS
from ..model.scene import scene_to_toml
from ..orbits.branches import OrbitBranch
from ..orbits.periodic import PeriodicOrbit
from ..plots.runs import run_overview
from ..plots.style import COLORS, png
from ..plots.trajectories import overview
from . import pictures
from .panels import CODE, Panels, event_marks, source
from .scripts import python_of
from .session import SLIDERS, Case, Session, Shown, View
from .worker import Worker

WIDTH = 545
"""Of the left side [pixels]."""
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
    "Click a point: that case. Drag a box: computed finer. "
    "Keys: arrows to the neighbour, [ back, ] forward, Esc stop, space play."
)
NO_IMAGE: dict[str, Any] = {"image": [], "x": [], "y": [], "dw": [], "dh": []}
NO_DOTS: dict[str, Any] = {"x": [], "y": [], "color": []}
NO_LINE: dict[str, Any] = {"x": [], "y": []}
SQUARE = (
    '<span style="white-space:nowrap"><span style="display:inline-block;width:12px;height:12px;background:{};'
    'border:1px solid #777"></span> {}</span>'
)


class Page:
    """One window."""

    def __init__(self, doc: Any, session: Session, keep: Callable[[Session], None]):
        """**Arguments:** `keep`: called with the session when it changes, so that another window can go on."""
        self.doc, self.session, self.keep = doc, session, keep
        self.quiet = False  # whether widgets are set by the page and not by a hand
        got = {"map": self._got_view, "case": self._got_case, "orbit": self._got_case, "file": self._got_picture}
        self.workers = {
            name: Worker(functools.partial(self._deliver, take), self._ended) for name, take in got.items()
        }
        self.panels = Panels(self._picked, lambda: self._show_case())
        sides = row(self._left(), self.panels.root, spacing=12)
        doc.title = "slipperjax explore"
        doc.add_root(column(self._header(), sides, styles={"padding": "4px 8px"}))
        args = dict(keys=self.keys, toggle=self.panels.play)
        doc.js_on_event(DocumentReady, CustomJS(args=args, code=CODE["keys"]))
        doc.on_event(DocumentReady, self._begin)
        if session.view.growing:
            doc.add_periodic_callback(self._refresh, REFRESH)
        self._show_view()
        self._show_case()

    def _begin(self, event: Any) -> None:
        """Computes what is shown first, when the page is there: tracing would delay it."""
        session = self.session
        if session.shown is None or session.shown.case is not session.case:
            self._look(session.case)
        if session.view.ds is None:
            self._compute(session.view)
        if not session.view.is_run:
            self.workers["file"].submit(session.warm)

    def close(self) -> None:
        """Ends its computations."""
        for worker in self.workers.values():
            worker.close()

    # --- what computes ----------------------------------------------------------------------------------------------

    def _deliver(self, take: Callable[[Any], None], piece: Any, wanted: Callable[[], bool]) -> None:
        """Hands a piece from a worker's thread to the page, and waits until it is there."""
        there: Future = Future()

        def hand() -> None:
            try:
                there.set_result(take(piece) if wanted() else None)
            except Exception as error:  # which would be lost here
                there.set_exception(error)

        self.doc.add_next_tick_callback(hand)
        if wait([there], PATIENCE).done:
            there.result()

    def _ended(self, error: Exception | None) -> None:
        if error is not None:
            text = " ".join(str(error).split()) or type(error).__name__
            self.doc.add_next_tick_callback(lambda: self._say(text, wrong=True))
        elif not any(worker.busy for worker in self.workers.values()):
            self.doc.add_next_tick_callback(lambda: self._say(HELP))
        self.doc.add_next_tick_callback(self._show_orbit)

    def _show_orbit(self) -> None:
        self.panels.show_orbit(self.session, self.workers["orbit"].busy)

    def _say(self, text: str, share: float | None = None, *, wrong: bool = False) -> None:
        """Writes the line of what happens, with a bar where it is known how far it is."""
        bar = "" if share is None else f'<progress value="{share:.3f}" style="width:140px"></progress> '
        color = COLORS["red"] if wrong else "#222"
        self.line.text = f'{bar}<span style="color:{color}">{html.escape(text)}</span>'

    def _compute(self, view: View) -> None:
        self._say("computing; the first time its program is compiled, which takes a while", 0.0)
        self.workers["map"].submit(lambda: self.session.compute(view))

    def _got_view(self, piece: tuple[View, str, float]) -> None:
        self.session.views[self.session.at], text, share = piece
        self._say(text, share)
        self._show_view()

    def _look(self, case: Case) -> None:
        session = self.session
        session.case, session.orbit, session.branch = case, None, None
        self.workers["orbit"].submit(None)
        self._set_sliders(case)
        self._mark()
        self.workers["case"].submit(lambda: session.look(case))

    def _got_case(self, piece: Any) -> None:
        session = self.session
        if isinstance(piece, Shown):
            session.shown = piece
            self._show_case()
            # on a thread of its own: a program is compiled for each period, and the next click need not wait
            self.workers["orbit"].submit(lambda: session.find_orbit(piece))
            self._show_orbit()
        elif isinstance(piece, PeriodicOrbit):
            session.orbit = piece if int(piece.status) == Status.FINITE else None
            self._show_orbit()
        elif isinstance(piece, OrbitBranch):
            session.branch = piece
            count = f"{piece.points.sizes['point']} orbits, {len(piece.events)} events"
            self._say(f"following the branch: {count}")
            self._show_case()
        self._write_texts()

    def _refresh(self) -> None:
        if self.session.refreshed() is not None:
            self._show_view()

    # --- what there is ----------------------------------------------------------------------------------------------

    def _header(self) -> Any:
        picture = lambda: self.workers["file"].submit(self._draw_picture)
        acts = {
            "◀ Back": lambda: self._step(-1),
            "Forward ▶": lambda: self._step(1),
            "■ Stop": self._stop,
            "Copy as Python": lambda: self._say("the script is in the clipboard"),
            "Save scene": lambda: self._say("the scene is in the browser's downloads"),
            "Save picture": picture,
        }
        buttons = [Button(label=text, width=108) for text in acts]
        for button, act in zip(buttons, acts.values(), strict=True):
            button.on_click(act)
        self.back, self.forward, _, copy, scene, _ = buttons
        self.texts, self.toml, self.png = source("python"), source("content"), source("content")
        # as an argument the picture's source becomes a part of the page
        copy.js_on_click(CustomJS(args=dict(texts=self.texts, png=self.png), code=CODE["copy"]))
        scene.js_on_click(CustomJS(args=dict(source=self.toml, name="scene.toml", text64=False), code=CODE["save"]))
        args = dict(source=self.png, name="slipper.png", text64=True)
        self.png.js_on_change("data", CustomJS(args=args, code=CODE["save"]))
        self.keys = TextInput(visible=False)
        self.keys.on_change("value", lambda attr, old, new: self._key(new.rpartition(" ")[0]))
        self.line = Div(text=HELP, width=WIDTH, name="line", styles={"font-size": "13px", "line-height": "1.25"})
        return row(*buttons, self.line, self.keys)

    def _left(self) -> Any:
        self.choice = Select(title="Shown", options=[], width=190)
        self.choice.on_change("value", self._chosen)
        self.begin = Select(
            title="Start of the next case", name="begin", options=list(STARTS.items()), value="map", width=250
        )
        self.legend = Div(width=WIDTH, styles={"font-size": "12px", "line-height": "1.7"})
        options: dict[str, Any] = dict(tools="box_select,wheel_zoom,pan,reset,save", active_drag="box_select")
        ranges = dict(x_range=Range1d(0, 1), y_range=Range1d(0, 1))
        self.map: Any = figure(width=WIDTH, height=440, name="map", **options, **ranges)
        self.map.toolbar.logo, self.map.grid.visible, self.map.axis.minor_tick_line_color = None, False, None
        self.map.on_event(Tap, lambda e: self._look_at(self.session.nearest(*self._si(e.x, e.y))))
        self.map.on_event(SelectionGeometry, self._boxed)
        self.pixels, self.dots, self.curve = source(*NO_IMAGE), source(*NO_DOTS), source(*NO_LINE)
        self.mapper: Any = LinearColorMapper(palette=["#ffffff"], nan_color="rgba(0,0,0,0)")
        self.map.image("image", "x", "y", "dw", "dh", color_mapper=self.mapper, source=self.pixels)
        self.bar = ColorBar(color_mapper=self.mapper, width=12, visible=False)
        self.map.add_layout(self.bar, "right")
        self.map.scatter("x", "y", source=self.dots, size=3, color="color")
        self.map.step("x", "y", source=self.curve, mode="before", color=COLORS["blue"])
        self.marks = {name: source("x", "y") for name in ("stable", "unstable", "case", "line")}
        self.map.vspan("x", source=self.marks["line"], color="black", line_dash="dotted")
        for color, width in (("white", 5), ("black", 2)):
            for name, dash in (("stable", "solid"), ("unstable", "dashed")):
                self.map.line("x", "y", source=self.marks[name], color=color, line_width=width, line_dash=dash)
            style = dict(marker="cross", size=18, line_width=width, color=color)
            self.map.scatter("x", "y", source=self.marks["case"], name="cross" * (width == 2), **style)
        self.events = event_marks(self.map)
        self.sliders = {}
        for name, ends in SLIDERS.items():
            low, high = map(PARAMETERS[name].shown, ends)
            options = dict(start=low, end=high, value=low, step=(high - low) / 480, format="0.[000]", name=name)
            self.sliders[name] = Slider(title=pictures.label(PARAMETERS[name]), width=WIDTH // 2 - 16, **options)
            self.sliders[name].on_change("value", functools.partial(self._slid, name))
        self.path = Select(title="Parameter of the branch", options=[], width=170)
        follow, again = (
            Button(label="Follow the branch", width=150),
            Button(label="Map with this case's values", width=190),
        )
        follow.on_click(self._follow)
        again.on_click(lambda: self._show_new(self.session.with_case()))
        one, two, three, four = self.sliders.values()
        follows = row(self.path, column(Div(height=12), row(follow, again)))
        self.controls = column(row(one, two), row(three, four), follows)
        self.code = Div(width=WIDTH)
        choices = row(self.choice, self.begin)
        return column(choices, self.legend, self.map, self.controls, self.panels.branch, self.code)

    # --- the map ----------------------------------------------------------------------------------------------------

    def _show_view(self) -> None:
        """Draws the left side anew."""
        session, view = self.session, self.session.view
        self.back.disabled, self.forward.disabled = session.at == 0, session.at + 1 == len(session.views)
        names = [] if view.is_run else [name for name in reversed(view.names) if not name.startswith("start_")]
        self.quiet = True
        for select, options in (
            (self.choice, pictures.choices(view)),
            (self.path, [*dict.fromkeys([*names, *SLIDERS])]),
        ):
            select.options = options
            select.value = select.value if select.value in options else options[0]
        self.quiet = False
        self.begin.visible = self.controls.visible = not view.is_run
        self.legend.text, self.bar.visible = "", False
        pixels, dots, curve = NO_IMAGE, NO_DOTS, NO_LINE
        if view.is_run:
            curve = pictures.along(view, self.choice.value)
            across, up = (pictures.label(pictures.unit_of(name, view)) for name in ("distance", self.choice.value))
            self._axes(across, up, np.array(view.span or curve["x"]), np.append(curve["y"], 0.0))
        elif len(view.names) == 1:
            q = view.quantity(view.names[0])
            up = pictures.label(pictures.unit_of(self.choice.value, view))
            if view.ds is not None:
                dots = pictures.dots(view, self.choice.value)
            self.legend.text = _legend((color, f"followed {way}") for way, color in pictures.ways(view).items())
            self._axes(pictures.label(q), up, q.shown(view.axis(view.names[0])), np.asarray(dots["y"]))
        else:
            pixels, dots = self._show_map(view)
        self.pixels.data, self.dots.data, self.curve.data = pixels, dots, curve
        self._mark()
        self._write_texts()

    def _show_map(self, view: View) -> tuple[dict[str, Any], dict[str, Any]]:
        quantities = [view.quantity(name) for name in view.names]
        y, x = (q.shown(view.axis(name)) for q, name in zip(quantities, view.names, strict=True))
        up, across = map(pictures.label, quantities)
        grid = view.ds is None or view.ds["status"].ndim == 2
        self._axes(across, up, *map(pictures.cells, (x, y)) if grid else (x, y), margin=0.0 if grid else 0.02)
        if view.ds is None:
            return NO_IMAGE, NO_DOTS
        picture = pictures.picture_of(view, self.choice.value)
        if picture.names:
            pairs = [*zip(picture.colors, picture.names, strict=True)]
            pairs += [("#ffffff", "not computed yet")] * bool(np.isnan(picture.values).any())
            self.legend.text = _legend(pairs)
            self.mapper.update(palette=picture.colors, low=-0.5, high=len(picture.names) - 0.5)
        else:
            low, high = _ends(picture.values)
            self.mapper.update(palette=list(Cividis256), low=low, high=high)
            self.legend.text, self.bar.visible = f"Colours: {html.escape(picture.label)}", True
        if grid:
            return pictures.image(x, y, picture.values), NO_DOTS
        palette, low, high = self.mapper.palette, self.mapper.low, self.mapper.high
        share = np.clip(np.nan_to_num((picture.values - low) / (high - low)), 0, 1 - 1e-9)
        colors = [
            palette[int(s * len(palette))] if np.isfinite(v) else "#ddd"
            for s, v in zip(share, picture.values, strict=True)
        ]
        return NO_IMAGE, {"x": x, "y": y, "color": colors}

    def _axes(self, across: str, up: str, x: np.ndarray, y: np.ndarray, margin: float = 0.02) -> None:
        self.map.xaxis.axis_label, self.map.yaxis.axis_label = across, up
        for extent, values in ((self.map.x_range, x), (self.map.y_range, y)):
            low, high = _ends(values)
            low, high = low - margin * (high - low), high + margin * (high - low)
            extent.update(start=low, end=high, reset_start=low, reset_end=high)

    def _mark(self) -> None:
        """Draws a cross where the case is, and the branch of its orbit as a line, where these are on the map."""
        session, view = self.session, self.session.view
        names, places = view.names, session.place()
        shown = [float(view.quantity(n).shown(p)) for n, p in zip(names, places, strict=True)]
        marks: dict[str, dict[str, Any]] = {"stable": NO_LINE, "unstable": NO_LINE}
        marks["case"] = {"x": shown[1:], "y": shown[: len(shown) - 1]}
        marks["line"] = {"x": shown, "y": shown} if len(shown) == 1 else NO_LINE
        events: dict[str, Any] = {"x": [], "y": [], "label": [], "name": []}
        branch = session.branch
        if branch is not None and len(shown) == 2 and branch.parameter.name in names:
            k = names.index(branch.parameter.name)
            along, beside = ("y", "x") if k == 0 else ("x", "y")
            coordinate, still = self.panels.names[0], shown[1 - k]
            for kind, (x, y) in pictures.branch_lines(branch, coordinate).items():
                marks[kind] = {along: x, beside: np.where(np.isnan(y), np.nan, still)}
            events = pictures.branch_events(branch, coordinate)
            events = events | {along: events["x"], beside: [still] * len(events["x"])}
        for name, data in marks.items():
            self.marks[name].data = data
        self.events.data = events

    def _si(self, x: float, y: float) -> list[float]:
        """A place of the map along the names of the view [SI units]."""
        view = self.session.view
        places = (y, x)[-len(view.names) :]
        return [float(view.quantity(name).from_shown(p)) for name, p in zip(view.names, places, strict=True)]

    def _look_at(self, index: dict[str, int]) -> None:
        self._look(self.session.begun(self.session.case_at(index), self.begin.value))

    def _boxed(self, event: Any) -> None:
        ends = event.geometry
        if event.final and ends.get("type") == "rect":
            low, high = self._si(ends["x0"], ends["y0"]), self._si(ends["x1"], ends["y1"])
            self._show_new(self.session.box(*zip(low, high, strict=True)))

    def _show_new(self, view: View | None) -> None:
        """Shows a view, and computes it."""
        if view is not None:
            self.session.show(view)
            self._show_view()
            self._compute(view)

    def _step(self, by: int) -> None:
        if self.session.move(by):
            self.workers["map"].submit(None)
            self._show_view()
            self._say(HELP)

    def _stop(self) -> None:
        for worker in self.workers.values():
            worker.submit(None)
        self._say("stopped; what was finished is kept")

    def _key(self, key: str) -> None:
        steps = {"ArrowLeft": (0, -1), "ArrowRight": (0, 1), "ArrowUp": (1, 0), "ArrowDown": (-1, 0)}
        session = self.session
        if key == "Escape":
            self._stop()
        elif key in ("[", "]"):
            self._step(1 if key == "]" else -1)
        elif key in steps:
            index, names = session.nearest(*session.place()), session.view.names
            for name, by in zip(names, steps[key][-len(names) :], strict=True):
                if name in index:
                    index[name] = int(np.clip(index[name] + by, 0, len(session.view.axis(name)) - 1))
            self._look_at(index)

    def _chosen(self, attr: str, old: str, new: str) -> None:
        view = self.session.view
        if self.quiet:
            return
        if view.grid is not None and view.ds is not None and new not in (*view.ds, "motion"):
            view = dataclasses.replace(view, record=(*view.record, new), ds=None)
            self.session.views[self.session.at] = view
            self._compute(view)
        else:
            self._show_view()

    # --- the case ---------------------------------------------------------------------------------------------------

    def _show_case(self) -> None:
        self.panels.show(self.session)
        self._mark()

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
        if not self.quiet:
            scene = case.scene.replace(**{name: float(PARAMETERS[name].from_shown(new))})
            self._look(self.session.begun(dataclasses.replace(case, scene=scene, steps=None), self.begin.value))

    def _follow(self) -> None:
        if self.session.orbit is None:
            self._say(f"a branch needs an orbit. {self.panels.circle.title.text}", wrong=True)
        else:
            name = self.path.value
            self._say("following the branch; the first time its programs are compiled, which takes a while")
            self.workers["case"].submit(lambda: self.session.follow(name))

    def _picked(self, x: float, y: float) -> None:
        if self.session.shown is not None:
            self.session.pick(*self.panels.names, x, y)
            self.begin.value = "picked"
            self._look(self.session.begun(self.session.case, "picked"))

    # --- texts and files --------------------------------------------------------------------------------------------

    def _write_texts(self) -> None:
        session = self.session
        self.keep(session.copied())
        text = python_of(session)
        try:
            toml = scene_to_toml(session.case.scene)
        except ValueError as error:  # of parts that plain text cannot hold
            toml = f"# {error}\n"
        self.texts.data, self.toml.data = {"python": [text]}, {"content": [toml]}
        pre = f'<pre style="font-size:11px;white-space:pre-wrap">{html.escape(text)}</pre>'
        self.code.text = f'<details><summary style="cursor:pointer">The script</summary>{pre}</details>'

    def _draw_picture(self) -> Iterator[bytes]:
        """The case, or the run, as `slipperjax.plots` draws it."""
        shown, view = self.session.shown, self.session.view
        if shown is not None:
            axes = run_overview(view.ds) if view.is_run else overview(shown.run)
            yield png(np.ravel(axes)[0].figure, 200)

    def _got_picture(self, content: bytes | None) -> None:
        if content is not None:  # that of a program which was compiled in advance
            self.png.data = {"content": [base64.b64encode(content).decode()]}


def _legend(pairs: Iterable[tuple[str, str]]) -> str:
    """Colours and their names as HTML."""
    return " &ensp; ".join(SQUARE.format(color, html.escape(name)) for color, name in pairs)


def _ends(values: np.ndarray) -> tuple[float, float]:
    """The least and the greatest finite value, apart from one another."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)
