"""Style, colours, labels with display units, titles that state the case, and pictures as files."""

import io
import re
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from ..flow.status import Status, is_lost
from ..model.parameters import PARAMETERS, quantity
from ..model.quantities import REACTIONS, Quantity, point_dims
from ..tools.checks import instance, number, positive
from ..tools.files import listed

STYLE: dict[str, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.4,
    "axes.linewidth": 0.6,
    # whole fonts are embedded in PDF files, so that their text can be searched and copied
    "pdf.fonttype": 42,
}
"""Matplotlib settings of all figures made here; column width is 3.5 inches, page width 7.2."""

COLORS = {"blue": "#12355b", "red": "#c1121f", "green": "#2a9d6f", "orange": "#e07a1f", "grey": "#a0a0a0"}
"""Colours of lines and dots."""

FLAGGED_LABEL = "status not 0"
"""Legend entry of cases that are left out because of their status."""
NOT_RUN_LABEL = "not computed yet"
"""Legend entry of cases that a store does not have yet; they are left white."""

MOTION_COLORS = {
    "period 1": "#d0fcff",
    "period 2": "#79a7f8",
    "period 3": "#ffea81",
    "period 4": "#4055c8",
    "other periods": "#001951",
    "quasi-periodic": "#aff1b5",
    "regular": "#009b68",
    "chaotic": "#af2b19",
    "transient chaos": "#ff7d20",
    "unresolved": "#aca0bf",
    FLAGGED_LABEL: "#453131",
}
# no picture has both this and single periods
MOTION_COLORS["periodic"] = MOTION_COLORS["period 2"]
"""Colours of motions, of whatever name. Each two that one picture may have differ by 25 in CIELAB or more, also for
readers without red or green."""

POINT_COLORS = (
    *("#1f77b4", "#e07a1f", "#c1121f", "#7b4ea3", "#2a9d6f"),
    *("#17a2b8", "#8c564b", "#d6589f", "#7f8c1f", "#12355b"),
)
"""Colours of the contact points, see `point_colors`."""


@contextmanager
def styled() -> Iterator[None]:
    """Apply `STYLE`, and nothing else, to the pictures drawn inside."""
    # not plt.rc_context, which restores every setting: the first figure of a session may switch interactive mode on,
    # and a notebook would show no further picture once that is undone
    settings: Any = plt.rcParams
    before = {name: settings[name] for name in STYLE}
    settings.update(STYLE)
    try:
        yield
    finally:
        settings.update(before)


def line_color(number: int) -> str:
    """Return the colour of a line by its number: blue, red, green, orange, then again."""
    return COLORS[("blue", "red", "green", "orange")[number % 4]]


def point_colors(points: int, slipper: int = 0) -> list[str]:
    """Return the colours of a number of contact points; `slipper`: the number of theirs on a sled."""
    # the same points of other slippers differ
    return [POINT_COLORS[(k + 3 * slipper) % len(POINT_COLORS)] for k in range(points)]


def by_contact(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset with one dimension `contact` in place of those of contact points.

    Its labels are the points' names, as in `Scene.point_names`: A1 at the front, A2 at the rear, of a sled left2_A1.
    Further coordinates along it are "end", "point", of a sled "slipper", and "color".
    """
    flat = ds.stack(contact=point_dims(ds), create_index=False)
    names = flat["point"].str.cat(xr.where(flat["end"] == "rear", "2", "1"))
    if "slipper" in flat.coords:
        names = flat["slipper"].str.cat(names, sep="_")
    of_slippers = [point_colors(ds["point"].size, slipper) for slipper in range(ds.sizes.get("slipper", 1))]
    colors = np.repeat(of_slippers, ds["end"].size, axis=0).ravel()
    return flat.assign_coords(contact=names.values, color=("contact", colors))


def typeset(unit: str) -> str:
    """Return a unit such as m/s^2 with its exponents raised, as matplotlib writes them."""
    return re.sub(r"\^(-?[\d.]+)", r"$^{\1}$", unit)


def with_unit(text: str, unit: str, *, brackets: bool = False) -> str:
    """Return a text and a unit after it, where that is not 1."""
    if unit == "1":
        return text
    return f"{text} [{typeset(unit)}]" if brackets else f"{text} {typeset(unit)}"


def quantity_of(name: str, ds: xr.Dataset | None = None) -> Quantity:
    """Return the quantity of a variable or coordinate: of the registry, or else by its attributes in `ds`."""
    try:
        return quantity(name)
    # a path, or a number that a user records
    except KeyError:
        attrs = {} if ds is None or name not in ds else ds[name].attrs
        of = attrs.get("quantity", name)
        symbol, shown_unit = (attrs.get(key, "") for key in ("symbol", "shown_unit"))
        return Quantity(of, attrs.get("units", "1"), of.replace("_", " "), symbol, 1.0, shown_unit)


def axis_label(name: str, ds: xr.Dataset | None = None) -> str:
    """Return the axis label of a quantity: name or symbol, and display unit in brackets; a pure number has none.

    **Arguments:**

    - `name`: as in datasets, for instance clearance, start_v_y, w_x or contact_force. A name that is not in the
      registry of quantities, such as the path section.play.2, is its own label.
    - `ds`: a dataset that has the unit of such a name.
    """
    q = quantity_of(name, ds)
    if name.startswith("start_"):
        return f"start {axis_label(name.removeprefix('start_'))}"
    if not q.symbol or name in PARAMETERS or name in REACTIONS:
        return name_label(q)
    return with_unit(f"${q.symbol}$", q.display_unit, brackets=True)


def name_label(q: Quantity) -> str:
    """Return an axis label with name, symbol and display unit."""
    text = q.name.replace("_", " ") + (f" ${q.symbol}$" if q.symbol else "")
    return with_unit(text, q.display_unit, brackets=True)


def shown(ds: xr.Dataset, name: str) -> np.ndarray:
    """Return the values of a variable or coordinate in its display unit, which its axis label names."""
    return quantity_of(name, ds).shown(ds[name].values)


def highest(ds: xr.Dataset, name: str, *dims: str) -> np.ndarray:
    """Return a variable over `dims` in its display unit, with its maximum along all other dimensions."""
    values = ds[name].astype(float)
    # xarray leaves NaN out, and infinities are no numbers to draw
    values = values.where(np.isfinite(values)).max([d for d in values.dims if d not in dims]).transpose(*dims)
    return quantity_of(name, ds).shown(values.values)


def as_dataset(result: object) -> object:
    """Return the dataset of a trajectory, a design or a branch, and anything else as it is."""
    return result.to_xarray() if hasattr(result, "to_xarray") else getattr(result, "points", result)


def check_dataset(ds: object, source: str, *names: str, argument: str = "ds") -> xr.Dataset:
    """Return `ds`, or the dataset of a result that has one.

    **Arguments:** `source`: what makes such datasets, for the error; `names`: variables that it must have.

    **Raises:** `ValueError` for anything else.
    """
    ds = as_dataset(ds)
    if not isinstance(ds, xr.Dataset):
        raise ValueError(f"Argument `{argument}` must be a dataset of {source}, but is {type(ds).__name__}.")
    # each variable that the picture needs
    for name in names:
        instance("name", name, str, "the name of a variable")
        if name not in ds:
            variables = listed([str(variable) for variable in ds])
            raise ValueError(
                f"Argument `{argument}` must be a dataset of {source}, with `{name}`, but has {variables}."
            )
    return ds


@contextmanager
def drawing(
    ax: Axes | None, ds: xr.Dataset | None = None, width: float = 3.5, height: float = 2.4, *, full: bool = True
) -> Iterator[Axes]:
    """Yield `ax`, or the Axes of a new figure [inches] in `STYLE`, whose title is the fixed parameters of `ds`."""
    if ax is not None:
        yield instance("ax", ax, Axes, "Axes of matplotlib")
        return
    with styled():
        figure, ax = plt.subplots(figsize=(width, height), layout="constrained")
        if ds is not None:
            name_case(figure, ds, full=full)
        yield ax


@contextmanager
def page(
    rows: int, columns: int, height: float, ds: xr.Dataset | None = None, *, full: bool = True, **options: Any
) -> Iterator[np.ndarray]:
    """Yield the Axes of a new figure in `STYLE`, 7.2 by `height` inches, titled as that of `drawing`.

    **Arguments:** `options`: as for `plt.subplots`.
    """
    with styled():
        figure, axes = plt.subplots(rows, columns, figsize=(7.2, height), layout="constrained", **options)
        if ds is not None:
            name_case(figure, ds, full=full)
        yield axes


def legend_above(ax: Axes, handles: Sequence[Artist] | None = None) -> None:
    """Draw a legend above the axes, in as many columns as its longest entry allows; none without entries.

    Dots are larger there than in the axes, so that their colours are seen.

    **Arguments:** `handles`: its entries; default what has a label in the axes, each label once.
    """
    if handles is None:
        found, labels = ax.get_legend_handles_labels()
        handles = list(dict(zip(labels, found, strict=True)).values())
    if not handles:
        return
    font_size = 6.5
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
    """Add a patch to the legend of the axes, and to nothing else: it is a polygon without corners."""
    ax.fill([], [], label=label, **style)


def is_wide(values: np.ndarray) -> bool:
    """Return whether values need a logarithmic scale: all positive, the largest more than 8 times the smallest."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and np.min(finite) > 0 and np.max(finite) > 8 * np.min(finite))


def color_norm(values: np.ndarray) -> Normalize:
    """Return the colour scale of the finite values, logarithmic where they need it."""
    finite = np.ma.masked_invalid(values).compressed()
    # the limits of the scale are those of what can be drawn
    norm = LogNorm() if is_wide(finite) else Normalize()
    norm.autoscale(finite)
    return norm


def color_bar(ax: Axes, mappable: ScalarMappable, label: str, cax: Axes | None = None) -> None:
    """Draw a colour bar beside the axes, or into the Axes `cax`."""
    bar = ax.figure.colorbar(mappable, ax=ax, cax=cax, label=label)
    if isinstance(mappable.norm, LogNorm):
        set_log_ticks(bar.ax.yaxis)


def fit_scale(ax: Axes, values: np.ndarray) -> None:
    """Make the vertical axis logarithmic where values need it."""
    if is_wide(values):
        ax.set_yscale("log")
        set_log_ticks(ax.yaxis)


def set_log_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers at 1, 2, 5, 10, ..."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
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


def lost(ds: xr.Dataset) -> bool:
    """Return whether the numbers of a dataset mean nothing, by the status of its one case, or of all of its cases."""
    status = ds["status"].values if "status" in ds else ds.attrs.get("status", int(Status.FINITE))
    return bool(np.all(is_lost(status)))


def flagged(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Return whether each case has a status other than 0, shape as `dims`."""
    return status_of(ds, *dims) != Status.FINITE


def mark_cases(ax: Axes, x: np.ndarray, label: str, color: str = COLORS["grey"]) -> None:
    """Draw crosses near the bottom of the axes at `x` [display unit]."""
    if len(x):
        y = np.full(len(x), 0.04)  # of the height of the axes
        ax.plot(x, y, "x", ms=3, mew=0.7, color=color, label=label, transform=ax.get_xaxis_transform())


def png(figure: Figure, dpi: int) -> bytes:
    """Return a figure as the content of a PNG file, of `dpi` pixels per inch; the figure is closed."""
    instance("figure", figure, Figure, "a figure of matplotlib")
    number(positive, "dpi", dpi)
    content = io.BytesIO()
    # level 3 takes a quarter less time than 6, matplotlib's, for files that are a fifth larger
    figure.savefig(content, dpi=dpi, format="png", pil_kwargs={"compress_level": 3})
    plt.close(figure)
    return content.getvalue()


def case_title(ds: xr.Dataset, *, full: bool = False) -> str:
    """Return the fixed parameters of a dataset, as in "V = 1250 m/s, C = 1 mm, L = 0.2 m" with typeset symbols.

    Parameters are read from the attributes, and from coordinates with one value, such as those of one case of a
    sweep. Those that vary or are absent are left out.

    **Arguments:** `ds`: of any run; `full`: all parameters and wavelengths, in two lines.

    **Returns:** the text, empty where it has no parameter.
    """
    instance("ds", ds, xr.Dataset, "a dataset of a run")
    rows = [["speed", "clearance", "length"]]
    if full:
        rows[0] += ["mass", "gravity"]
        rows.append(["stiffness", "restitution", "amplitude", "roll_amplitude"])
    lines = []
    # lines of the title, without what varies
    for row in rows:
        lines.append([])
        for name in row:
            q = PARAMETERS[name]
            value = _number(ds, q)
            if value is not None:
                stated = with_unit(f"${q.symbol}$ = {float(q.shown(value)):.4g}", q.display_unit)
                lines[-1].append(stated.replace(" degrees", "°"))
    waves = np.ravel(ds.attrs.get("wavelengths [m]", []))
    if full and "track" in ds.attrs:
        # RandomTrack and RandomRails are "a random track" and "random rails"
        words = re.sub("(?<=[a-z])(?=[A-Z])", " ", ds.attrs["track"]).lower()
        lines[-1].append(f"on {words}" if words.endswith("s") else f"on a {words}")
    if full and len(waves):
        lines[-1].append(f"$L_X$ = {' and '.join(f'{w:.4g}' for w in waves)} m")
    return "\n".join(", ".join(line) for line in lines if line)


def name_case(figure: Figure, ds: xr.Dataset, *, full: bool = False) -> None:
    """Write the fixed parameters of a dataset above a figure."""
    text = case_title(ds, full=full)
    if text:
        figure.suptitle(text, fontsize=7)


def name_status(figure: Figure, code: int) -> None:
    """Write a status other than 0 above a figure, in red below its title."""
    if code != Status.FINITE:
        lines = [figure.get_suptitle(), textwrap.fill(f"status: {Status(code)}", 90)]
        figure.suptitle("\n".join(line for line in lines if line), color=COLORS["red"], fontsize=7)


def _number(ds: xr.Dataset, q: Quantity) -> float | None:
    """Return the value of a parameter [SI unit]; None where the dataset has several, or none."""
    if q.name in ds.coords:
        return ds[q.name].item() if ds[q.name].size == 1 else None
    # attributes are named with their unit, as in "speed [m/s]"
    value = ds.attrs.get(q.name if q.unit == "1" else f"{q.name} [{q.unit}]")
    return float(value) if np.size(value) == 1 and value is not None else None
