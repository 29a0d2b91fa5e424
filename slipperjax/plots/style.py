"""Style, colours, labels with display units, titles that state the case, and pictures as files."""

import io
import json
import re
import string
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise, product
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from ..flow.datasets import has_one_scene
from ..flow.status import Status, is_lost, texts_of_status
from ..model.parameters import MAIN, PARAMETERS, QUANTITIES, START, check_units
from ..model.quantities import NET_DIMS, REACTIONS, Quantity, ShownUnits, point_dims
from ..tools.checks import instance, number, positive, require
from ..tools.files import listed

COLORS = {"blue": "#12355b", "red": "#c1121f", "green": "#2a9d6f", "orange": "#e07a1f", "grey": "#a0a0a0"}
"""Colours of lines and dots."""

STYLE: dict[str, Any] = {
    "font.size": 8,
    "figure.titlesize": 7,
    "legend.fontsize": 6.5,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.4,
    "axes.linewidth": 0.6,
    "axes.prop_cycle": plt.cycler(color=[COLORS[name] for name in ("blue", "red", "green", "orange")]),
    # PDF files contain whole fonts, and text stays text in SVG files, so that it can be searched and edited
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    # resolution of the parts that are pixels in PDF and SVG files
    "savefig.dpi": 300,
}
"""Matplotlib settings of all figures of this package."""
COLUMN = 3.5
"""Width of a figure with one panel [inches]."""
PAGE = 7.2
"""Width of a figure with several panels [inches]."""

Units = Sequence[str] | None
"""Units that a user chooses, such as ("ft", "lbf"); None for the units of the scene's file."""
OWN_UNITS = ShownUnits()
"""The display units of quantities."""
AXES = {"y": "lateral", "z": "vertical"}
"""Names of the axes of net forces."""

FLAGGED_LABEL = "not trusted"
"""Legend entry of cases that are left out because of their status."""
UNITS = "shown_units"
"""Attribute of a result with the units of the scene's file in JSON."""
NOT_RUN_LABEL = "not computed yet"
"""Legend entry of missing cases of a store, which are white."""

MOTION_COLORS = {
    "period 1": "#7ec0fd",
    "period 2": "#4c6dbf",
    "period 3": "#ffea81",
    "period 4": "#2e2ebc",
    "other periods": "#000666",
    "quasi-periodic": "#87de9f",
    "regular": "#1d9352",
    "chaotic": "#af1111",
    "transient chaos": "#f67619",
    "unresolved": "#6a6a73",
    FLAGGED_LABEL: "#261919",
}
# no picture has both this kind and single periods
MOTION_COLORS["periodic"] = MOTION_COLORS["period 2"]
"""Colours of motions, by name. Any two colours of one picture, and white for missing cases, differ by 25 in CIELAB or
more, also for readers who cannot see red or green."""

POINT_COLORS = (
    *("#1f77b4", "#e07a1f", "#c1121f", "#7b4ea3", "#2a9d6f"),
    *("#17a2b8", "#8c564b", "#d6589f", "#7f8c1f", "#12355b"),
)
"""Colours of the contact points, see `point_colors`."""


class Look(NamedTuple):
    """Look of new figures, which `styled` decides."""

    settings: Mapping[str, Any] = STYLE
    """Settings of matplotlib."""
    width: float | None = None
    """Width of figures [inches]; None for `COLUMN` or `PAGE`."""
    titles: bool = True
    letters: bool = True


PLAIN = Look()
"""The look outside of any `styled`."""
_look: ContextVar[Look] = ContextVar("look", default=PLAIN)
"""The present look, from the innermost `styled`."""


@contextmanager
def styled(
    settings: Mapping[str, Any] | None = None,
    *,
    width: float | None = None,
    titles: bool | None = None,
    letters: bool | None = None,
) -> Iterator[None]:
    """Apply slipperjax's style to the pictures drawn and saved inside, with a user's own changes.

    Save PDF and SVG files inside, too, because the form of text in these files is part of the style.

    ```python
    cycle = plt.cycler(color=["#0072b2", "#d55e00", "#009e73", "#cc79a7"])
    with plots.styled({"font.family": "serif", "axes.prop_cycle": cycle}, width=7.2, titles=False):
        plots.bifurcations(ds)[0].figure.savefig("fig5.pdf")
    ```

    **Arguments:** the default of each is its value outside this context.

    - `settings`: of matplotlib, by their names in `plt.rcParams`, in place of the style's own. Lines and dots take
        the colours of `axes.prop_cycle` in turn; kinds of motion and contact points keep their colours.
    - `width`: of new figures [inches]; at first 3.5, a column, for one panel, and 7.2, a page, for several.
    - `titles`: whether new figures state their case; a status other than 0 is always stated.
    - `letters`: whether panels of a page have letters (a), (b) and so on.

    **Raises:** `ValueError` for a setting that matplotlib does not have, or a width that is not positive.
    """
    rc: Any = plt.rcParams
    for name in settings or {}:
        require(name in rc, "settings", "have names of matplotlib's settings", name)
    if width is not None:
        width = number(positive, "width", width, "in")
    around = _look.get()
    given = dict(width=width, titles=titles, letters=letters)
    changes: Any = {name: value for name, value in given.items() if value is not None}
    look = around._replace(settings={**around.settings, **(settings or {})}, **changes)
    # `plt.rc_context` would restore every setting. The first figure of a session may switch interactive mode on; if
    # this were undone, a notebook would show no further picture.
    before = {name: rc[name] for name in look.settings}
    token = _look.set(look)
    try:
        rc.update(look.settings)
        yield
    finally:
        rc.update(before)
        _look.reset(token)


def setting(name: str) -> Any:
    """Return a setting of the present style, also for Axes that were made without the style."""
    return _look.get().settings[name]


def line_color(number: int) -> str:
    """Return the colour of a line by its number in the cycle, which begins again after its end."""
    colors = setting("axes.prop_cycle").by_key()["color"]
    return colors[number % len(colors)]


def point_colors(points: int, slipper: int = 0) -> list[str]:
    """Return the colours of a number of contact points; `slipper`: the number of their slipper on a sled."""
    # the same points of other slippers have other colours
    return [POINT_COLORS[(k + 3 * slipper) % len(POINT_COLORS)] for k in range(points)]


def by_contact(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset with one dimension `contact` in place of the dimensions of contact points.

    Its labels are the points' names, as in `Scene.point_names`: A1 at the front, A2 at the rear, for a sled left2_A1.
    Further coordinates along it are "end", "point", for a sled "slipper", and "color".
    """
    flat = ds.stack(contact=point_dims(ds), create_index=False)
    names = flat["point"].str.cat(xr.where(flat["end"] == "rear", "2", "1"))
    if "slipper" in flat.coords:
        names = flat["slipper"].str.cat(names, sep="_")
    of_slippers = [point_colors(ds["point"].size, slipper) for slipper in range(ds.sizes.get("slipper", 1))]
    colors = np.repeat(of_slippers, ds["end"].size, axis=0).ravel()
    return flat.assign_coords(contact=names.values, color=("contact", colors))


def by_load(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset with one dimension `load` in place of the dimensions of slippers' net forces, with labels such
    as "left1 vertical", for a single slipper "vertical"."""
    dims = point_dims(ds)
    each = product(*(ds[dim].values for dim in dims))
    labels = [" ".join(AXES.get(str(label), str(label)) for label in one) for one in each]
    return ds.stack(load=dims, create_index=False).assign_coords(load=labels)


def typeset(unit: str) -> str:
    """Return a unit such as m/s^2 with its exponents raised, as matplotlib writes them."""
    return re.sub(r"\^(-?[\d.]+)", r"$^{\1}$", unit)


def with_unit(text: str, unit: str, *, brackets: bool = False) -> str:
    """Return a text followed by a unit, unless the unit is 1."""
    if unit == "1":
        return text
    return f"{text} [{typeset(unit)}]" if brackets else f"{text} {typeset(unit)}"


def quantity_of(name: str, ds: xr.Dataset, units: ShownUnits | None = None) -> Quantity:
    """Return the quantity of a variable or coordinate, from the registry or else from its attributes in `ds`, in
    units that a user chose; None: for all of the result, see `in_units`."""
    chosen = shown_units(ds) if units is None else units
    if name in QUANTITIES:
        return chosen.of(QUANTITIES[name])
    # a path, or a number from a user's record
    attrs = ds[name].attrs if name in ds else {}
    of = attrs.get("quantity", name)
    symbol, shown_unit = (attrs.get(key, "") for key in ("symbol", "shown_unit"))
    return chosen.of(Quantity(of, attrs.get("units", "1"), of.replace("_", " "), symbol, shown_unit=shown_unit))


def shown(ds: xr.Dataset, name: str, units: ShownUnits | None = None) -> xr.DataArray:
    """Return a variable or coordinate in its display unit, with the attributes by which `label` labels its axis."""
    q = quantity_of(name, ds, units)
    return in_display_unit(q, ds[name], short=name in QUANTITIES and name not in {**PARAMETERS, **REACTIONS})


def in_display_unit(q: Quantity, values: xr.DataArray, *, short: bool = False) -> xr.DataArray:
    """Return values of a quantity [SI unit] in its display unit, with the attributes by which `label`, and xarray's
    own plots, label axes.

    **Arguments:** `short`: whether the symbol stands for the name.
    """
    text = name_and_symbol(q)
    if short and q.symbol:
        text = "start " * q.name.startswith(START) + f"${q.symbol}$"
    return q.shown(values).assign_attrs(long_name=text, units=q.display_unit)


def label(values: xr.DataArray) -> str:
    """Return the axis label of what `shown` returns: name or symbol, and unit in brackets; a pure number has none."""
    return with_unit(values.attrs["long_name"], values.attrs["units"], brackets=True)


def label_axes(ax: Axes, x: xr.DataArray, y: xr.DataArray) -> None:
    """Label both axes by what they show."""
    ax.set(xlabel=label(x), ylabel=label(y))


def name_and_symbol(q: Quantity) -> str:
    """Return the name of a quantity, and its symbol, if any."""
    return q.words + (f" ${q.symbol}$" if q.symbol else "")


def highest(ds: xr.Dataset, name: str, *dims: str, units: ShownUnits | None = None) -> xr.DataArray:
    """Return a variable over `dims` as `shown` does, with its maximum along all other dimensions."""
    given = shown(ds, name, units)
    # for net loads the greatest magnitude
    values = abs(given) if set(NET_DIMS) & set(given.dims) else given.astype(float)
    # xarray ignores NaN, and infinities cannot be drawn
    values = values.where(np.isfinite(values)).max([d for d in values.dims if d not in dims])
    return values.transpose(*dims).assign_attrs(given.attrs)


def shown_columns(ds: xr.Dataset, *along: str, units: Units = None) -> pd.DataFrame:
    """Return the coordinates and variables over some dimensions as columns, in display units stated in their heads.

    **Arguments:** `along`: names of the dimensions; none for one case, whose table has one row; `units`: such as
    ("ft", "lbf").
    """
    chosen = shown_units(ds, units)
    columns = {}
    for name, variable in ds.variables.items():
        if set(variable.dims) == set(along) or (set(variable.dims) <= set(along) and name in ds.coords):
            q = quantity_of(str(name), ds, chosen)
            values = np.ravel(variable.set_dims({dim: ds.sizes[dim] for dim in along}).transpose(*along))
            if variable.dtype.kind in "fiu" and q.display_unit not in ("1", ""):
                columns[f"{name} [{q.display_unit}]"] = values if q.per_shown == 1 else q.shown(values)
            else:
                columns[str(name)] = values
    return pd.DataFrame(columns)


def check_dataset(ds: object, source: str, *names: str, argument: str = "ds") -> xr.Dataset:
    """Return `ds`, or the dataset of a result.

    **Arguments:** `source`: function that makes such datasets, for the error; `names`: variables that it must have.

    **Raises:** `ValueError` for any other value, and for variables that are not in SI units.
    """
    ds = getattr(ds, "ds", ds)
    if not isinstance(ds, xr.Dataset):
        raise ValueError(f"Argument `{argument}` must be a dataset of {source}, but is {type(ds).__name__}.")
    check_units(ds, argument)
    for name in names:
        instance("name", name, str, "the name of a variable")
        if name not in ds:
            has = listed(list(map(str, ds)))
            raise ValueError(f"Argument `{argument}` must be a dataset of {source}, with `{name}`, but has {has}.")
    return ds


@contextmanager
def drawing(
    ax: Axes | None, ds: xr.Dataset | None = None, width: float = COLUMN, height: float = 2.4, *, full: bool = True
) -> Iterator[Axes]:
    """Yield `ax`, or the Axes of a new figure [inches] in `STYLE`, whose title is the fixed parameters of `ds`.

    In the end a legend is drawn above the Axes.
    """
    if ax is not None:
        yield instance("ax", ax, Axes, "Axes of matplotlib")
        legend_above(ax)
        return
    with styled():
        figure, ax = plt.subplots(figsize=(_look.get().width or width, height), layout="constrained")
        if ds is not None:
            entitle(figure, case_title(ds, full=full))
        yield ax
        legend_above(ax)


@contextmanager
def page(
    rows: int, columns: int, height: float, ds: xr.Dataset | None = None, *, full: bool = True, **options: Any
) -> Iterator[np.ndarray]:
    """Yield the Axes of a new figure in `STYLE`, as wide as a page and `height` inches high, titled as by `drawing`.

    **Arguments:** `options`: as for `plt.subplots`.
    """
    with styled():
        figure, axes = plt.subplots(rows, columns, figsize=(page_width(), height), layout="constrained", **options)
        if ds is not None:
            entitle(figure, case_title(ds, full=full))
        yield axes
        # removed panels have no figure
        letter([ax for ax in np.ravel(axes) if ax.figure is not None])


@contextmanager
def rows_of(*counts: int, height: float) -> Iterator[np.ndarray]:
    """Yield the Axes of a new figure as `page` does, with a number of panels for each row.

    Each row has its own layout: a colour bar or a long label takes no space from the panels above and below it.
    """
    with styled():
        figure = plt.figure(figsize=(page_width(), height), layout="constrained")
        rows = figure.add_gridspec(len(counts), 1)
        cells = [cell for row, count in zip(rows, counts, strict=True) for cell in row.subgridspec(1, count)]
        axes = np.array([figure.add_subplot(cell) for cell in cells])
        yield axes
        letter(axes)


def page_width() -> float:
    """Return the width of figures with several panels [inches]."""
    return _look.get().width or PAGE


def letter(axes: Sequence[Axes] | np.ndarray) -> None:
    """Write (a), (b) and so on at the upper left corners of several panels, if the style has letters."""
    if not _look.get().letters or len(axes) == 1:
        return
    # outside, next to a legend and above the labels of ticks, where letters hide nothing
    place: Any = dict(xycoords="axes fraction", textcoords="offset points", va="bottom", ha="right")
    for ax, name in zip(axes, string.ascii_lowercase, strict=False):
        ax.annotate(f"({name})", (0, 1), (-4, 4), fontsize=setting("axes.labelsize"), **place)


def label_lowest(panels: np.ndarray) -> None:
    """Keep labels along x only at the lowest of neighbouring panels (rows, columns) with the same limits."""
    for column in panels.T:
        for ax, below in pairwise(column):
            if np.allclose(ax.get_xlim(), below.get_xlim()):
                ax.set_xlabel("")
                ax.tick_params(labelbottom=False)


def legend_above(ax: Axes, handles: Sequence[Artist] | None = None) -> None:
    """Draw a legend above the axes, in as many columns as its longest entry allows; none without entries.

    Dots are larger there than in the axes, so that their colours are visible.

    **Arguments:** `handles`: its entries; default all things with a label in the axes, each label once.
    """
    if handles is None:
        found, labels = ax.get_legend_handles_labels()
        handles = list(dict(zip(labels, found, strict=True)).values())
    if not handles:
        return
    font_size = setting("legend.fontsize")
    lines = [line for handle in handles for line in str(handle.get_label()).splitlines()]
    # a letter is about half as wide as the font is high; marker and spaces are as wide as six letters
    column = 0.45 * font_size * (max(map(len, lines)) + 6)
    width = 72 * ax.get_position().width * ax.figure.canvas.figure.get_figwidth()
    legend = ax.legend(
        handles=handles,
        ncols=int(np.clip(width / column, 1, len(handles))),
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        borderaxespad=0.3,
        frameon=False,
        fontsize=font_size,
        handletextpad=0.4,
        columnspacing=1.2,
        handlelength=1.6,
    )
    dots = [line for line in legend.get_lines() if line.get_marker() == "."]
    plt.setp(dots, markersize=5)


def legend_patch(ax: Axes, label: str, **style: object) -> None:
    """Add a patch only to the legend of the axes: the patch is a polygon without corners."""
    ax.fill([], [], label=label, **style)


def is_wide(values: np.ndarray) -> bool:
    """Return whether values need a logarithmic scale: all positive, the largest more than 8 times the smallest."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and np.min(finite) > 0 and np.max(finite) > 8 * np.min(finite))


def color_norm(values: np.ndarray) -> Normalize:
    """Return the colour scale of the finite values, logarithmic where they need it."""
    finite = np.ma.masked_invalid(values).compressed()
    # the limits of the scale are those of the values that can be drawn
    norm = LogNorm() if is_wide(finite) else Normalize()
    norm.autoscale(finite)
    return norm


def color_bar(ax: Axes, mappable: ScalarMappable, label: str, cax: Axes | None = None) -> None:
    """Draw a colour bar next to the axes, or into the Axes `cax`."""
    bar = ax.figure.colorbar(mappable, ax=ax, cax=cax, label=label)
    if isinstance(mappable.norm, LogNorm):
        set_log_ticks(bar.ax.yaxis)


def fit_scale(ax: Axes, values: np.ndarray) -> None:
    """Make the vertical axis logarithmic where values need it."""
    if is_wide(values):
        ax.set_yscale("log")
        set_log_ticks(ax.yaxis)


class PlainTicks(LogLocator):
    """Ticks at 1, 2, 5, 10, ... where the axis has space for their labels, and otherwise at powers of ten.

    matplotlib leaves out powers of ten where even these need more space than the axis has.
    """

    def __init__(self, fine: tuple[int, ...] = (1, 2, 5)):
        super().__init__()
        self.fine = fine

    def tick_values(self, vmin: float, vmax: float) -> Any:
        space = 9 if self.axis is None else self.axis.get_tick_space()
        self.set_params(subs=self.fine)
        fine = super().tick_values(vmin, vmax)
        # matplotlib returns no ticks of this kind where it must leave out powers of ten
        if 2 <= _within(fine, vmin, vmax) <= space:
            return fine
        self.set_params(subs=(1,))
        powers = super().tick_values(vmin, vmax)
        return powers if _within(powers, vmin, vmax) >= 2 else fine


def _within(ticks: np.ndarray, vmin: float, vmax: float) -> int:
    """Return how many ticks lie within the limits of an axis, where alone matplotlib draws them."""
    low, high = sorted((vmin, vmax))
    return int(np.sum((low <= ticks) & (ticks <= high)))


def set_log_ticks(axis: Axis, fine: tuple[int, ...] = (1, 2, 5)) -> None:
    """Label a logarithmic axis with plain numbers: `fine` in each decade where there is space, see `PlainTicks`."""
    axis.set_major_locator(PlainTicks(fine))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def swept(array: xr.DataArray, *inner: str, count: int = 1) -> tuple[str, ...]:
    """Return the dimensions over which an array was swept: all but `inner`.

    **Raises:** `ValueError` where they are not `count`.
    """
    dims = tuple(str(d) for d in array.dims if d not in inner)
    if len(dims) != count:
        raise ValueError(f"Argument `ds` must be swept over {count} parameter(s), but is over {dims}.")
    return dims


def status_of(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Return the status of each case, shape as `dims`; 0 where the dataset has none."""
    if "status" not in ds:
        return np.zeros([ds.sizes[d] for d in dims], int)
    return ds["status"].transpose(*dims).values


def flagged(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Return whether each case has a status other than 0, shape as `dims`."""
    return status_of(ds, *dims) != Status.FINITE


def lost(ds: xr.Dataset) -> bool:
    """Return whether the numbers of a dataset mean nothing, by the status of its one case, or of all its cases."""
    return bool(np.all(is_lost(ds.get("status", ds.attrs.get("status", int(Status.FINITE))))))


def mark_cases(ax: Axes, x: np.ndarray, label: str, color: str = COLORS["grey"]) -> None:
    """Draw crosses near the bottom of the axes at `x` [display unit]."""
    if len(x):
        y = np.full(len(x), 0.04)  # of the height of the axes
        ax.plot(x, y, "x", ms=3, mew=0.7, color=color, label=label, transform=ax.get_xaxis_transform())


def png(figure: Figure, dpi: int) -> bytes:
    """Return a figure as the content of a PNG file with `dpi` pixels per inch; the figure is closed."""
    # level 3 takes a quarter less time than matplotlib's level 6, for files that are a fifth larger
    return content_of(figure, "png", dpi=number(positive, "dpi", dpi), pil_kwargs={"compress_level": 3})


def content_of(figure: Figure, form: str, **options: Any) -> bytes:
    """Return a figure as the content of a file; the figure is closed.

    **Arguments:** `form`: png, pdf or svg; `options`: of `Figure.savefig`.
    """
    instance("figure", figure, Figure, "a figure of matplotlib")
    content = io.BytesIO()
    with styled():
        figure.savefig(content, format=form, **options)
    plt.close(figure)
    return content.getvalue()


def case_title(ds: xr.Dataset, *, full: bool = False) -> str:
    """Return the fixed parameters of a dataset, as in "speed 1250 m/s, clearance 1 mm, length 0.2 m".

    Parameters come from the attributes, and from coordinates with one value, such as those of one case of a sweep.
    Parameters that vary or are absent are left out.

    **Arguments:** `ds`: of any run; `full`: all parameters and wavelengths, in two lines.

    **Returns:** the text, empty where the dataset has no parameter.
    """
    ds = instance("ds", getattr(ds, "ds", ds), xr.Dataset, "a dataset of a run")
    rows = [[*MAIN], []]
    if full:
        rows[0] += ["mass", "gravity"]
        rows[1] += ["stiffness", "restitution", "amplitude", "roll_amplitude"]
    units = shown_units(ds)
    if not has_one_scene(ds):
        ds = ds.drop_attrs(deep=False)
    lines = [[_stated(ds, units.of(PARAMETERS[name])) for name in row] for row in rows]
    waves = np.ravel(ds.attrs.get("wavelengths [m]", []))
    if full and "track" in ds.attrs:
        # RandomTrack and RandomRails become "a random track" and "random rails"
        words = re.sub("(?<=[a-z])(?=[A-Z])", " ", ds.attrs["track"]).lower()
        lines[1].append(f"on {words}" if words.endswith("s") else f"on a {words}")
    if full and len(waves):
        lines[1].append(f"wavelength {' and '.join(f'{w:.4g}' for w in waves)} m")
    return "\n".join(filter(None, (", ".join(filter(None, line)) for line in lines)))


def _stated(ds: xr.Dataset, q: Quantity) -> str:
    """Return a parameter with its value, as in "clearance 1 mm"; an empty text where it varies or is absent."""
    # names of attributes contain their unit, as in "speed [m/s]"
    fixed = ds.attrs.get(q.attribute, [])
    values = np.ravel(ds[q.name] if q.name in ds.coords else fixed)
    if values.size != 1:
        return ""
    text = f"{q.words} {plain_number(q.shown(values[0]))}"
    return with_unit(text, q.display_unit).replace(" degrees", "°")


def shown_units(ds: xr.Dataset, units: Units = None) -> ShownUnits:
    """Return the units of a shown result: `units`, or by default those of its scene's file."""
    if units is not None:
        return ShownUnits(units)
    return ShownUnits(json.loads(ds.attrs.get(UNITS, "[]")))


def in_units(ds: xr.Dataset, units: Units) -> xr.Dataset:
    """Return a result whose pictures have these units; None leaves those of its scene's file."""
    return ds if units is None else ds.assign_attrs({UNITS: json.dumps(ShownUnits(units).units)})


def plain_number(value: float) -> str:
    """Return a number of four digits, with a power of ten as matplotlib writes it."""
    digits, power, exponent = f"{float(value):.4g}".partition("e")
    if not power:
        return digits
    tens = f"$10^{{{int(exponent)}}}$"
    return tens if digits == "1" else f"{digits} $\\times$ {tens}"


def entitle(figure: Figure, *lines: str) -> None:
    """Write lines above a figure, below its title, if the style has titles."""
    text = "\n".join(filter(None, [figure.get_suptitle(), *lines]))
    if text and _look.get().titles:
        size = setting("figure.titlesize")
        # a letter is half as wide as the font is high, with a margin for wide ones
        letters = int(72 * figure.get_figwidth() / (0.54 * size))
        figure.suptitle("\n".join(_wrapped(line, letters) for line in text.splitlines()), fontsize=size, wrap=True)


def _wrapped(line: str, letters: int) -> str:
    """Return a line in lines of so many letters, which end at a comma or semicolon, never between name and value."""
    joined = re.sub("(?<![,;]) ", "\xa0", line)
    return textwrap.fill(joined, letters, break_long_words=False, break_on_hyphens=False).replace("\xa0", " ")


def name_status(figure: Figure, code: int) -> None:
    """Write a status other than 0 above a figure, in red below its title."""
    if code != Status.FINITE:
        _write_problem(figure, f"status: {Status(code)}")


def name_statuses(figure: Figure, ds: xr.Dataset) -> None:
    """Write how many runs of a dataset have a status other than 0, as `name_status`; nothing where it has none."""
    for text in texts_of_status(ds["status"].values) if "status" in ds else ():
        _write_problem(figure, text)


def _write_problem(figure: Figure, text: str) -> None:
    text = f"{figure.get_suptitle()}\n{textwrap.fill(text, 90)}".strip()
    figure.suptitle(text, color=COLORS["red"], fontsize=setting("figure.titlesize"))
