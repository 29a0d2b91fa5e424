"""The page: a map on the left, the case that was clicked on the right. Bokeh draws, `Session` computes."""

import dataclasses
import functools
import html
from collections.abc import Callable, Iterable
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
from ..plots.style import COLORS, NOT_RUN_LABEL, quantity_of
from . import pictures
from .panels import CODE, Panels, source
from .scripts import python_of
from .session import SLIDERS, Case, Session, Shown, View
from .worker import Worker

WIDTH = 545
"""Width of the left side [pixels]."""
HELP = (
    "Click a point: that case. Drag a box: computed finer. "
    "Keys: arrows to the neighbour, [ back, ] forward, Esc stop, space play."
)


class Page:
    """One window."""

    def __init__(self, doc: Any, session: Session, keep: Callable[[Session], None]):
        """**Arguments:** `keep`: called with the session when it changes, so that another window can go on."""
        self.doc = doc
        self.session = session
        self.keep = keep
        self.quiet = False  # whether widgets are set by the page and not by a hand
        self.worker = Worker(("case", "orbit", "branch", "map"), self._deliver, self._ended)
        self.panels = Panels(lambda: self._show_case())
        sides = row(self._left(), self.panels.root, spacing=12)
        doc.title = "slipperjax explore"
        doc.add_root(column(self._header(), sides, styles={"padding": "4px 8px"}))
        args = dict(keys=self.keys, toggle=self.panels.play)
        doc.js_on_event(DocumentReady, CustomJS(args=args, code=CODE["keys"]))
        doc.on_event(DocumentReady, self._begin)
        if session.view.growing:
            doc.add_periodic_callback(self._refresh, 2000)
        self._show_view()
        self._show_case()

    def _begin(self, event: Any) -> None:
        """Compute what is shown first, when the page is there: tracing would delay it."""
        session = self.session
        if session.shown is None or session.shown.case is not session.case:
            self._look(session.case)
        if session.view.ds is None:
            self._compute(session.view)

    # --- what computes ----------------------------------------------------------------------------------------------

    def _deliver(self, piece: Any, wanted: Callable[[], bool]) -> None:
        """Hand a piece from the worker's thread to the page, and wait until it is there, or ten seconds."""
        # Bokeh changes documents in the thread of its loop only
        there: Future = Future()

        def hand() -> None:
            try:
                there.set_result(self._take(piece) if wanted() else None)
            except Exception as error:  # which would be lost here
                there.set_exception(error)

        self.doc.add_next_tick_callback(hand)
        if wait([there], 10.0).done:
            there.result()

    def _take(self, piece: Any) -> None:
        """Show a piece of what is computed."""
        session = self.session
        # each kind of piece has its place
        if isinstance(piece, tuple) and isinstance(piece[0], View):
            session.views[session.at], text, share = piece
            self._say(text, share)
            self._show_view()
        elif isinstance(piece, Shown):
            session.shown = piece
            self.worker.submit("orbit", session.find_orbit(piece))
            self._show_case()
        elif isinstance(piece, PeriodicOrbit):
            session.orbit = piece if int(piece.status) == Status.FINITE else None
            self._show_orbit()
        elif isinstance(piece, OrbitBranch):
            session.branch = piece
            self._say(f"following the branch: {piece.points.sizes['point']} orbits, {len(piece.events)} events")
            self._show_case()
        self._write_texts()

    def _ended(self, error: Exception | None) -> None:
        if error is not None:
            text = " ".join(str(error).split()) or type(error).__name__
            self.doc.add_next_tick_callback(lambda: self._say(text, wrong=True))
        # nothing is left to do
        elif not self.worker.is_busy():
            self.doc.add_next_tick_callback(lambda: self._say(HELP))
        self.doc.add_next_tick_callback(self._show_orbit)

    def _show_orbit(self) -> None:
        self.panels.show_orbit(self.session, self.worker.is_busy("orbit"))

    def _say(self, text: str, share: float | None = None, *, wrong: bool = False) -> None:
        """Write the line of what happens, with a bar where it is known how far it is."""
        bar = "" if share is None else f'<progress value="{share:.3f}" style="width:140px"></progress> '
        color = COLORS["red"] if wrong else "#222"
        self.line.text = f'{bar}<span style="color:{color}">{html.escape(text)}</span>'

    def _compute(self, view: View) -> None:
        self._say("computing; the first time its program is compiled, which takes a while", 0.0)
        self.worker.submit("map", self.session.compute(view))

    def _look(self, case: Case) -> None:
        session = self.session
        session.case = case
        session.orbit = session.branch = None
        # what belongs to the case before
        self.worker.submit("orbit", None)
        self.worker.submit("branch", None)
        self._set_sliders(case)
        self._mark()
        self.worker.submit("case", session.look(case))

    def _refresh(self) -> None:
        if self.session.refreshed() is not None:
            self._show_view()

    # --- what there is ----------------------------------------------------------------------------------------------

    def _header(self) -> Any:
        acts = {
            "◀ Back": lambda: self._step(-1),
            "Forward ▶": lambda: self._step(1),
            "■ Stop": self._stop,
            "Copy as Python": lambda: self._say("the script is in the clipboard"),
            "Save scene": lambda: self._say("the scene is in the browser's downloads"),
        }
        buttons = {text: Button(label=text, width=108) for text in acts}
        # those that end in the browser only say so here
        for text, act in acts.items():
            buttons[text].on_click(act)
        self.back = buttons["◀ Back"]
        self.forward = buttons["Forward ▶"]
        self.texts = source("python")
        self.toml = source("content")
        buttons["Copy as Python"].js_on_click(CustomJS(args=dict(texts=self.texts), code=CODE["copy"]))
        buttons["Save scene"].js_on_click(CustomJS(args=dict(source=self.toml), code=CODE["save"]))
        self.keys = TextInput(visible=False)
        self.keys.on_change("value", lambda attr, old, new: self._key(new.rpartition(" ")[0]))
        self.line = Div(text=HELP, width=WIDTH, name="line", styles={"font-size": "13px", "line-height": "1.25"})
        return row(*buttons.values(), self.line, self.keys)

    def _left(self) -> Any:
        self.choice = Select(title="Shown", options=[], width=190)
        self.choice.on_change("value", self._chosen)
        starts = [("map", "from the map's start"), ("end", "from the end of the case before")]
        self.begin = Select(title="Start of the next case", name="begin", options=starts, value="map", width=250)
        self.legend = Div(width=WIDTH, styles={"font-size": "12px", "line-height": "1.7"})
        options: dict[str, Any] = dict(tools="box_select,wheel_zoom,pan,reset,save", active_drag="box_select")
        ranges = dict(x_range=Range1d(0, 1), y_range=Range1d(0, 1))
        self.map: Any = figure(width=WIDTH, height=440, name="map", **options, **ranges)
        self.map.toolbar.logo = self.map.axis.minor_tick_line_color = None
        self.map.grid.visible = False
        self.map.on_event(Tap, lambda e: self._look_at(self.session.nearest(*self._si(e.x, e.y))))
        self.map.on_event(SelectionGeometry, self._boxed)
        self.mapper: Any = LinearColorMapper(palette=["#ffffff"], nan_color="rgba(0,0,0,0)")
        self.pixels = source("image", "x", "y", "dw", "dh")
        self.map.image("image", "x", "y", "dw", "dh", color_mapper=self.mapper, source=self.pixels)
        self.bar = ColorBar(color_mapper=self.mapper, width=12, visible=False)
        self.map.add_layout(self.bar, "right")
        self.dots = source("x", "y", "color")
        self.map.scatter("x", "y", source=self.dots, size=3, color="color")
        self.sample = source("x", "y", "value")
        colors = {"field": "value", "transform": self.mapper}
        self.map.scatter("x", "y", source=self.sample, size=5, color=colors)
        self.curve = source("x", "y")
        self.map.step("x", "y", source=self.curve, mode="before", color=COLORS["blue"])
        self.cross = source("x", "y")
        self.place = source("x")
        self.map.vspan("x", source=self.place, color="black", line_dash="dotted")
        style = dict(marker="cross", size=18, source=self.cross)
        self.map.scatter("x", "y", line_width=5, color="white", **style)  # an edge, seen on dark colours
        self.map.scatter("x", "y", line_width=2, color="black", name="cross", **style)
        self.sliders = {}
        # each slider computes its case while it moves
        for name, ends in SLIDERS.items():
            low, high = map(PARAMETERS[name].shown, ends)
            options = dict(start=low, end=high, value=low, step=(high - low) / 480, format="0.[000]", name=name)
            self.sliders[name] = Slider(title=pictures.label(PARAMETERS[name]), width=WIDTH // 2 - 16, **options)
            self.sliders[name].on_change("value", functools.partial(self._slid, name))
        self.path = Select(title="Parameter of the branch", options=[], width=170)
        follow = Button(label="Follow the branch", width=150)
        follow.on_click(self._follow)
        again = Button(label="Map with this case's values", width=190)
        again.on_click(lambda: self._show_new(self.session.with_case()))
        one, two, three, four = self.sliders.values()
        follows = row(self.path, column(Div(height=12), row(follow, again)))
        self.controls = column(row(one, two), row(three, four), follows)
        self.code = Div(width=WIDTH)
        choices = row(self.choice, self.begin)
        return column(choices, self.legend, self.map, self.controls, self.panels.branch, self.code)

    # --- the map ----------------------------------------------------------------------------------------------------

    def _show_view(self) -> None:
        """Draw the left side anew."""
        session, view = self.session, self.session.view
        self.back.disabled = session.at == 0
        self.forward.disabled = session.at + 1 == len(session.views)
        names = [] if view.is_run else [name for name in reversed(view.names) if not name.startswith("start_")]
        self.quiet = True
        for select, options in ((self.choice, pictures.choices(view)), (self.path, [*names, *SLIDERS])):
            select.options = list(dict.fromkeys(options))
            select.value = select.value if select.value in options else options[0]
        self.quiet = False
        self.begin.visible = self.controls.visible = not view.is_run
        self.legend.text = ""
        self.bar.visible = False
        # the parts of other views are empty
        for data in (self.pixels, self.dots, self.sample, self.curve):
            data.data = {name: [] for name in data.data}
        if len(view.names) == 2:
            self._show_map(view)
        else:
            self._show_line(view)
        self._mark()
        self._write_texts()

    def _show_line(self, view: View) -> None:
        """Draw a number of a run over distance, or a diagram over a parameter."""
        choice = self.choice.value
        q = view.quantity(view.names[0])
        up = pictures.label(quantity_of(choice, view.ds))
        if view.is_run:
            self.curve.data = curve = pictures.along(view, choice)
            self._axes(pictures.label(q), up, curve["x"], np.append(curve["y"], 0.0))
            return
        if view.ds is not None:
            self.dots.data = pictures.dots(view, choice)
        self.legend.text = _legend((color, f"followed {way}") for way, color in pictures.ways(view).items())
        self._axes(pictures.label(q), up, q.shown(view.axis(view.names[0])), np.asarray(self.dots.data["y"]))

    def _show_map(self, view: View) -> None:
        """Draw cases over two parameters: a grid as an image, a sample as dots."""
        quantities = [view.quantity(name) for name in view.names]
        y, x = (q.shown(view.axis(name)) for q, name in zip(quantities, view.names, strict=True))
        up, across = map(pictures.label, quantities)
        # cells reach to the borders of the map
        if view.ds is None or view.ds["status"].ndim == 2:
            self._axes(across, up, pictures.cells(x), pictures.cells(y), margin=0.0)
        else:
            self._axes(across, up, x, y)
        if view.ds is None:
            return
        picture = pictures.picture_of(view, self.choice.value)
        if picture.names:
            pairs = [*zip(picture.colors, picture.names, strict=True)]
            pairs += [("#ffffff", NOT_RUN_LABEL)] * bool(np.isnan(picture.values).any())
            self.legend.text = _legend(pairs)
            self.mapper.update(palette=picture.colors, low=-0.5, high=len(picture.names) - 0.5)
        else:
            low, high = _ends(picture.values)
            self.mapper.update(palette=list(Cividis256), low=low, high=high)
            self.legend.text = f"Colours: {html.escape(picture.label)}"
            self.bar.visible = True
        if view.ds["status"].ndim == 2:
            self.pixels.data = pictures.image(x, y, picture.values)
        else:
            self.sample.data = {"x": x, "y": y, "value": picture.values}

    def _axes(self, across: str, up: str, x: np.ndarray, y: np.ndarray, margin: float = 0.02) -> None:
        self.map.xaxis.axis_label = across
        self.map.yaxis.axis_label = up
        # with a margin, and a reset that leads back
        for extent, values in ((self.map.x_range, x), (self.map.y_range, y)):
            low, high = _ends(values)
            wide = margin * (high - low)
            low, high = low - wide, high + wide
            extent.update(start=low, end=high, reset_start=low, reset_end=high)

    def _mark(self) -> None:
        """Draw where the case is: a cross on a map, a line in a diagram."""
        view = self.session.view
        places = zip(view.names, self.session.place(), strict=True)
        shown = [float(view.quantity(name).shown(place)) for name, place in places]
        self.place.data = {"x": shown if len(shown) == 1 else []}
        self.cross.data = {"x": shown[1:], "y": shown[: len(shown) - 1]}

    def _si(self, x: float, y: float) -> list[float]:
        """Return a place of the map along the names of the view [SI units]."""
        view = self.session.view
        places = (y, x)[-len(view.names) :]
        return [float(view.quantity(name).from_shown(p)) for name, p in zip(view.names, places, strict=True)]

    def _look_at(self, index: dict[str, int]) -> None:
        self._look(self.session.begun(self.session.case_at(index), self.begin.value == "end"))

    def _boxed(self, event: Any) -> None:
        ends = event.geometry
        if not event.final or ends.get("type") != "rect":
            return
        # the same windows, nearer
        if self.session.view.is_run:
            self.map.x_range.update(start=ends["x0"], end=ends["x1"])
            return
        low = self._si(ends["x0"], ends["y0"])
        high = self._si(ends["x1"], ends["y1"])
        self._show_new(self.session.box(*zip(low, high, strict=True)))

    def _show_new(self, view: View | None) -> None:
        """Show a view, and compute it."""
        if view is not None:
            self.session.show(view)
            self._show_view()
            self._compute(view)

    def _step(self, by: int) -> None:
        if self.session.move(by):
            self.worker.submit("map", None)
            self._show_view()
            self._say(HELP)

    def _stop(self) -> None:
        self.worker.stop()
        self._say("stopped; what was finished is kept")

    def _key(self, key: str) -> None:
        steps = {"ArrowLeft": (0, -1), "ArrowRight": (0, 1), "ArrowUp": (1, 0), "ArrowDown": (-1, 0)}
        session = self.session
        if key == "Escape":
            self._stop()
        elif key in ("[", "]"):
            self._step(1 if key == "]" else -1)
        elif key in steps:
            index = session.nearest(*session.place())
            names = session.view.names
            # an axis each, the first upwards
            for name, by in zip(names, steps[key][-len(names) :], strict=True):
                if name in index:  # a sample has no neighbours
                    index[name] = int(np.clip(index[name] + by, 0, len(session.view.axis(name)) - 1))
            self._look_at(index)

    def _chosen(self, attr: str, old: str, new: str) -> None:
        view = self.session.view
        if self.quiet:
            return
        # a number that was not recorded is computed
        if view.grid is not None and view.ds is not None and new not in (*view.ds, "motion"):
            view = dataclasses.replace(view, record=(*view.record, new), ds=None)
            self.session.views[self.session.at] = view
            self._compute(view)
        else:
            self._show_view()

    # --- the case ---------------------------------------------------------------------------------------------------

    def _show_case(self) -> None:
        self.panels.show(self.session)
        self._show_orbit()
        self._mark()

    def _set_sliders(self, case: Case) -> None:
        self.quiet = True
        # a scene may lack a number, or have it for each point
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
            changed = dataclasses.replace(case, scene=scene, steps=None)
            self._look(self.session.begun(changed, self.begin.value == "end"))

    def _follow(self) -> None:
        if self.session.orbit is None:
            self._say(f"a branch needs an orbit. {self.panels.circle.title.text}", wrong=True)
        else:
            self._say("following the branch; the first time its programs are compiled, which takes a while")
            self.worker.submit("branch", self.session.follow(self.path.value))

    # --- texts ------------------------------------------------------------------------------------------------------

    def _write_texts(self) -> None:
        session = self.session
        self.keep(session.copied())
        text = python_of(session)
        try:
            toml = scene_to_toml(session.case.scene)
        except ValueError as error:  # of parts that plain text cannot hold
            toml = f"# {error}\n"
        self.texts.data = {"python": [text]}
        self.toml.data = {"content": [toml]}
        pre = f'<pre style="font-size:11px;white-space:pre-wrap">{html.escape(text)}</pre>'
        self.code.text = f'<details><summary style="cursor:pointer">The script</summary>{pre}</details>'


def _legend(pairs: Iterable[tuple[str, str]]) -> str:
    """Return colours and their names as HTML."""
    square = '<span style="display:inline-block;width:12px;height:12px;background:{};border:1px solid #777"></span>'
    entry = f'<span style="white-space:nowrap">{square} {{}}</span>'
    return " &ensp; ".join(entry.format(color, html.escape(name)) for color, name in pairs)


def _ends(values: np.ndarray) -> tuple[float, float]:
    """Return the least and the greatest finite value, apart from one another."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)
