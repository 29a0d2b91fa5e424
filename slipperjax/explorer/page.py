"""The page: a map on the left, the chosen case on the right. Bokeh draws, `Session` computes."""

import dataclasses
import functools
import html
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady, DoubleTap, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import Button, ColorBar, Column, CustomJS, Div, LinearColorMapper, Range1d, Row, Select, Slider
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from ..model.parameters import PARAMETERS
from ..plots.style import COLORS, NOT_RUN_LABEL, quantity_of
from . import pictures
from .panels import CODE, Panels, source
from .scripts import python_of
from .session import SLIDERS, Case, Session, Shown, View
from .worker import Worker

WIDTH = 545
"""Width of the left side [pixels]."""
Piece = Shown | tuple[View, float]
"""What the worker delivers: a case, or the map so far and its finished share."""
HELP = "Click a point: that case. Drag a box: computed finer."


class Page:
    """The page in one window of a browser, with the session and the worker of that window."""

    def __init__(self, doc: Document, session: Session):
        self.doc = doc
        self.session = session
        self.quiet = False  # whether the page itself sets widgets, so that the changes are not the user's
        self.worker = Worker(("case", "map"), self._deliver, self._ended)
        slippers = session.view.scene.slipper.names
        self.panels = Panels(slippers, lambda: self.panels.show(self.session.shown))
        self.panels.slipper.on_change("value", self._chosen)
        sides = row(self._left(), self.panels.root, spacing=12)
        doc.title = "slipperjax explore"
        doc.add_root(column(self._header(), sides, styles={"padding": "4px 8px"}))
        doc.on_event(DocumentReady, self._begin)
        if session.view.growing:
            doc.add_periodic_callback(self._refresh, 2000)
        self._show_view()

    def _begin(self, event: DocumentReady) -> None:
        """Compute the first contents when the page is there, because tracing would delay the page."""
        self._look(self.session.case)
        if not self.session.view.ds:
            self._compute(self.session.view)

    # --- what computes ----------------------------------------------------------------------------------------------

    def _deliver(self, piece: Piece, wanted: Callable[[], bool]) -> None:
        """Pass a piece from the worker's thread to the page, and wait until it is there, or for ten seconds."""
        # Bokeh changes documents only in the thread of its loop
        there: Future = Future()

        def hand() -> None:
            try:
                there.set_result(self._take(piece) if wanted() else None)
            except Exception as error:  # the error would be lost here
                there.set_exception(error)

        self.doc.add_next_tick_callback(hand)
        if wait([there], 10.0).done:
            there.result()

    def _take(self, piece: Piece) -> None:
        """Show a case, or a part of the map."""
        if isinstance(piece, Shown):
            self.session.shown = piece
            self.panels.show(piece)
            self._write_texts()
            return
        # the shown view, with more of its cases
        self.session.views[-1], share = piece
        self._say(f"computing the map: {share:.0%}")
        self._show_view()

    def _ended(self, error: Exception | None) -> None:
        # an error is shown; help is shown where no work is left
        if error is not None:
            text = " ".join(str(error).split()) or type(error).__name__
            self.doc.add_next_tick_callback(lambda: self._say(text, COLORS["red"]))
        elif not self.worker.is_busy():
            self.doc.add_next_tick_callback(lambda: self._say(HELP))

    def _say(self, text: str, color: str = "black") -> None:
        """Write the status line."""
        self.line.text = f'<span style="color:{color}">{html.escape(text)}</span>'

    def _compute(self, view: View) -> None:
        """Make the worker compute a map."""
        self._say("computing; the first time its program is compiled, which takes a while")
        self.worker.submit("map", self.session.compute(view))

    def _look(self, case: Case) -> None:
        """Make the worker compute a case, and mark it at once."""
        self.session.case = case
        self._set_sliders(case)
        self._mark()
        self.worker.submit("case", self.session.look(case))

    def _refresh(self) -> None:
        if self.session.refreshed():
            self._show_view()

    # --- what there is ----------------------------------------------------------------------------------------------

    def _header(self) -> Row:
        labels = ("Back", "Stop", "Copy as Python", "Save scene")
        self.back, stop, copy, save = (Button(label=text, width=124) for text in labels)
        self.back.on_click(self._leave_box)
        stop.on_click(self._stop)
        # these run in the browser
        self.texts = source("python", "toml")
        for button, name in ((copy, "copy"), (save, "save")):
            button.js_on_click(CustomJS(args=dict(texts=self.texts), code=CODE[name]))
        self.line = Div(text=HELP, width=WIDTH, name="line")
        return row(self.back, stop, copy, save, self.line)

    def _left(self) -> Column:
        self.choice = Select(title="Shown", options=[], width=190)
        self.choice.on_change("value", self._chosen)
        self.legend = Div(width=WIDTH)
        extents = dict(x_range=Range1d(0, 1), y_range=Range1d(0, 1))
        tools = dict(tools="box_select,wheel_zoom,pan,reset,save", active_drag="box_select")
        self.map: Any = figure(width=WIDTH, height=440, name="map", **extents, **tools)
        self.map.grid.visible = False
        # a double tap is two quick clicks
        for event, heard in ((Tap, self._tapped), (DoubleTap, self._tapped), (SelectionGeometry, self._boxed)):
            self.map.on_event(event, heard)
        self.mapper = LinearColorMapper(palette=["#ffffff"], nan_color="rgba(0,0,0,0)")
        self.pixels = self.map.image([], [], [], [], [], color_mapper=self.mapper).data_source
        self.bar = ColorBar(color_mapper=self.mapper, width=12, visible=False)
        self.map.add_layout(self.bar, "right")
        blue = COLORS["blue"]
        self.dots = self.map.scatter([], [], size=3, color=blue).data_source
        self.curve = self.map.step([], [], mode="before", color=blue).data_source
        self.place = self.map.vspan([], color="black", line_dash="dotted").data_source
        self.cross = source("x", "y")
        style = dict(marker="cross", size=18, source=self.cross)
        self.map.scatter("x", "y", line_width=5, color="white", **style)  # an edge, seen on dark colours
        self.map.scatter("x", "y", line_width=2, color="black", name="cross", **style)
        self.sliders = {}
        # each slider computes its case while it moves
        for name, ends in SLIDERS.items():
            q = PARAMETERS[name]
            low, high = map(q.shown, ends)
            span = dict(start=low, end=high, value=low, step=(high - low) / 480)
            slider = Slider(title=pictures.label(q), width=WIDTH - 16, format="0.[000]", name=name, **span)
            slider.on_change("value", functools.partial(self._slid, name))
            self.sliders[name] = slider
        self.controls = column(*self.sliders.values(), visible=not self.session.view.is_run)
        return column(self.choice, self.legend, self.map, self.controls)

    # --- the map ----------------------------------------------------------------------------------------------------

    def _show_view(self) -> None:
        """Draw the left side again."""
        view = self.session.view.of_slipper(self.panels.slipper.value)
        self.back.disabled = len(self.session.views) == 1
        options = pictures.choices(view)
        self.quiet = True
        self.choice.options = options
        self.choice.value = self.choice.value if self.choice.value in options else options[0]
        self.quiet = False
        if len(view.names) == 2:
            self._show_map(view)
        else:
            self._show_line(view)
        self._mark()
        self._write_texts()

    def _show_line(self, view: View) -> None:
        """Draw a number of a run over distance, or a diagram over a parameter."""
        (name,) = view.names
        q = view.quantity(name)
        choice = self.choice.value
        x = q.shown(view.axis(name))
        y = np.array([0.0])
        if view.is_run:
            self.curve.data = pictures.along(view, choice)
            x = self.curve.data["x"]
            y = np.append(self.curve.data["y"], 0.0)
        elif view.ds:
            self.dots.data = pictures.dots(view, choice)
            y = self.dots.data["y"]
        self._set_axes(pictures.label(q), pictures.label(quantity_of(choice, view.ds)), x, y)

    def _show_map(self, view: View) -> None:
        """Draw cases over two parameters as an image."""
        up, across = map(view.quantity, view.names)
        y, x = (q.shown(view.axis(q.name)) for q in (up, across))
        self._set_axes(pictures.label(across), pictures.label(up), x, y)
        # no map before a part of it is computed
        self.pixels.data = {name: [] for name in self.pixels.data}
        if not view.ds:
            return
        picture = pictures.picture_of(view, self.choice.value)
        self.bar.visible = not picture.colors
        if picture.colors:
            missing = {NOT_RUN_LABEL: "#ffffff"} if np.isnan(picture.values).any() else {}
            self.legend.text = _legend(picture.colors | missing)
            palette = list(picture.colors.values())
            self.mapper.update(palette=palette, low=-0.5, high=len(palette) - 0.5)
        else:
            low, high = _ends(picture.values)
            self.mapper.update(palette=list(Cividis256), low=low, high=high)
            self.legend.text = f"Colours: {html.escape(picture.label)}"
        self.pixels.data = pictures.image(x, y, picture.values)

    def _set_axes(self, across: str, up: str, x: np.ndarray, y: np.ndarray) -> None:
        self.map.xaxis.axis_label = across
        self.map.yaxis.axis_label = up
        # with a margin, and a reset that restores this view
        for extent, values in ((self.map.x_range, x), (self.map.y_range, y)):
            low, high = _ends(values)
            margin = 0.02 * (high - low)
            ends = dict(start=low - margin, end=high + margin)
            extent.update(**ends, **{f"reset_{name}": end for name, end in ends.items()})

    def _mark(self) -> None:
        """Draw the place of the case: a cross on a map, a line in a diagram."""
        view = self.session.view
        places = zip(view.names, self.session.place(), strict=True)
        shown = [float(view.quantity(name).shown(place)) for name, place in places]
        self.place.data = {"x": shown if len(shown) == 1 else []}
        # empty lists draw nothing
        self.cross.data = {"x": shown[1:], "y": shown[: len(shown) - 1]}

    def _si(self, x: float, y: float) -> list[float]:
        """Return a place of the map along the names of the view [SI units]."""
        view = self.session.view
        # a diagram has only one parameter, along x
        places = (y, x)[-len(view.names) :]
        return [float(view.quantity(name).from_shown(p)) for name, p in zip(view.names, places, strict=True)]

    def _tapped(self, event: Tap | DoubleTap) -> None:
        index = self.session.nearest(*self._si(event.x, event.y))
        self._look(self.session.case_at(index))

    def _boxed(self, event: SelectionGeometry) -> None:
        ends: Any = event.geometry  # by the name of each side
        # while the user draws a box, many events arrive
        if not event.final or ends.get("type") != "rect":
            return
        # the same windows, enlarged
        if self.session.view.is_run:
            self.map.x_range.update(start=ends["x0"], end=ends["x1"])
            return
        low = self._si(ends["x0"], ends["y0"])
        high = self._si(ends["x1"], ends["y1"])
        view = self.session.box(*zip(low, high, strict=True))
        if view is not None:
            self.session.views.append(view)
            self._show_view()
            self._compute(view)

    def _leave_box(self) -> None:
        self.worker.stop()
        self.session.views.pop()
        self._show_view()
        self._say(HELP)

    def _stop(self) -> None:
        self.worker.stop()
        self._say("stopped; what was finished is kept")

    def _chosen(self, attr: str, old: str, new: str) -> None:
        if not self.quiet:
            self._show_view()

    # --- the case ---------------------------------------------------------------------------------------------------

    def _set_sliders(self, case: Case) -> None:
        self.quiet = True
        # a scene may lack a number, or have one for each point
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
            self._look(dataclasses.replace(case, scene=scene, steps=None))

    def _write_texts(self) -> None:
        """Pass the script and the scene to the browser, which copies and saves them."""
        try:
            toml = self.session.case.scene.to_toml()
        except ValueError as error:  # for parts that plain text cannot hold
            toml = f"# {error}\n"
        self.texts.data = {"python": [python_of(self.session)], "toml": [toml]}


def _legend(colors: dict[str, str]) -> str:
    """Return names and their colours as HTML."""
    square = '<span style="display:inline-block;width:12px;height:12px;background:{};border:1px solid #777"></span>'
    entry = f'<span style="white-space:nowrap">{square} {{}}</span>'
    return " &ensp; ".join(entry.format(color, html.escape(name)) for name, color in colors.items())


def _ends(values: np.ndarray) -> tuple[float, float]:
    """Return the smallest and the largest finite value, moved apart where they are equal."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)
