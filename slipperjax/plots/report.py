"""Reports of runs: a summary in words, and files of pages or tables with it."""

import functools
import importlib.util
import io
import os
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..flow.status import is_lost, step_error
from ..model.dynamics import static_loads
from ..model.parameters import PARAMETERS
from ..model.quantities import ACCELERATIONS, Quantity
from ..model.scene import PARTS, Scene
from ..model.travel import LEAST_SPEED, SpeedProgramme
from ..tools.checks import require
from ..tools.files import Content, user_path, write_each
from ..tools.units import STANDARD_GRAVITY
from .comparisons import comparison, table as table_of_designs, verdict
from .environment import environment_summary, environment_table, vibration
from .runs import (
    PEAKS,
    RunView,
    draw_panels,
    draw_speed,
    edges_of,
    edges_of_bands,
    finish_forces,
    in_hundredths,
    main_peak,
    peak_of,
    speed_name,
)
from .style import AXES, COLORS, POINT_COLORS, legend_above, line_color, page, set_log_ticks, styled, with_unit
from .tables import APART, HUNDRED, of_hundreds, of_windows, tables, words

WIDTH = 105
"""Characters in a line of the page with the summary."""
LINES = 78
"""Lines on that page."""
BINS = 200
"""Most steps in a line of the envelope of forces: more would cover other lines."""
PAGE = (7.2, 9.4)
"""Size of a page [inches]."""
LENGTHS = 8
"""Most lengths of rail that are listed with their status."""
POINTS = 5
"""Contact points or net loads that an envelope shows, those with the highest forces."""
NET = "peak_slipper_force"


def report(
    ds: xr.Dataset, file: str | os.PathLike[str], units: Sequence[str] | None = None, scene: Scene | None = None
) -> str:
    """Write the report of a run, of designs compared or of an environment: its summary, pictures and tables.

    **Arguments:**

    - `ds`: of `run`, without a grid or one case of it, of `compare`, or of `environment`, which is shown in g; also
        one that was read from a file.
    - `file`: its ending decides. FILE.pdf has pages; FILE.csv has a row for each window of distance, and
        FILE_100m.csv beside it one for each 100 m; of an environment it has one for each band; FILE.xlsx has the
        summary, all tables and the worst places as sheets.
    - `units`: such as ("ft", "lbf", "g"), each for the quantities of its kind; by default those of the scene's file.
        Distances are by default in the unit of the survey.
    - `scene`: default that of the dataset.

    **Returns:** what was written, in words.

    **Raises:** `ValueError` for another dataset, ending or unit; `OSError` for a file that cannot be written.
    """
    path = user_path(file, "file")
    return write_each(report_files(ds, path.with_suffix(""), endings(path), units, scene))


def report_files(
    ds: xr.Dataset,
    out: Path,
    ends: Sequence[str],
    units: Sequence[str] | None = None,
    scene: Scene | None = None,
) -> dict[Path, Callable[[], Content]]:
    """Return functions that make the content of files, by their paths: `out` and each of `ends`.

    **Arguments:** `ends`: of `endings`; all others as for `report`.
    """
    has = lambda name: isinstance(ds, xr.Dataset) and name in ds
    if has("best"):
        made = _of_designs(ds, units)
    elif has("density_envelope"):
        made = _of_environment(ds)
    else:
        made = _of_run(RunView.of(ds, scene, units))
    return {
        Path(f"{out}{end}"): functools.partial(MAKERS[end], made)
        for end in ends
        if end != "_100m.csv" or "100 m" in made.tables
    }


def endings(path: Path, *others: str, name: str = "file") -> tuple[str, ...]:
    """Return what the files of a report add to its name without ending.

    **Arguments:** `others`: further endings that are known to the caller; `name`: the argument's, for errors.

    **Raises:** `ValueError` for an unknown ending, or one whose package is missing.
    """
    ending = path.suffix.lower()
    known = [*others, *(end for end in MAKERS if end.startswith("."))]
    require(ending in known, name, f"end in one of {', '.join(known)}", path.name)
    if ending == ".xlsx" and importlib.util.find_spec("openpyxl") is None:
        raise ValueError(f"A workbook such as {path.name} needs openpyxl: pip install 'slipperjax[report]'.")
    return (ending, "_100m.csv") if ending == ".csv" else (ending,)


def summary(view: RunView) -> list[str]:
    """Return a run in words, a line for each result: its status first, and nothing else where it is lost."""
    lines = [f"status: {view.status}"]
    lengths = [f"{_from_to(view, *ends)}: {words(status)}" for *ends, status in view.flagged]
    lines += lengths[:LENGTHS]
    if len(lengths) > LENGTHS:
        lines.append(f"and {len(lengths) - LENGTHS} further lengths with a status")
    # numbers of a lost run mean nothing
    lost = is_lost(view.status) or is_lost(view.codes).all()
    return lines if lost else [*lines, *_results(view)]


def _results(view: RunView) -> Iterator[str]:
    """Yield the results of a run in words."""
    ds = view.ds
    speed = view.quantity("speed")
    values = speed.shown(ds[speed_name(ds)].values)
    # one speed where it does not change
    speeds = " to ".join(dict.fromkeys((f"{values.min():.4g}", f"{values.max():.4g}")))
    seconds = float(np.ptp(view.times))
    ends = edges_of(ds, "distance")[[0, -1]]
    yield f"{_from_to(view, *ends)} in {seconds:.4g} s, speed {speeds} {speed.display_unit}"
    programme = None if view.scene is None else view.scene.speed
    stops = programme.stops if isinstance(programme, SpeedProgramme) else []
    for *length, duration in stops:
        if length[0] < ends[1] and length[1] > ends[0]:
            least = _said(speed, LEAST_SPEED)
            yield f"slower than {least} from {_from_to(view, *length)}, for {duration:.3g} s: passed at that speed"
    lost = is_lost(view.codes)
    if lost.any():
        yield "without the lengths that have no meaning:"
    if NET in ds:
        yield from _net_loads(view)
    if "peak_force" in ds:
        at = peak_of(ds)
        point = f"{at['contact'].item()} ({at['end'].item()})"
        yield from _peak(view, "peak_force", "highest single contact point", point, at)
    if "impacts" in ds:
        impacts = float(ds["impacts"].sum())
        seconds = float(np.diff(view.times)[~lost].sum())
        yield f"{impacts:.0f} impacts, {impacts / seconds:.4g} per second"
    known = [name for name in ACCELERATIONS if f"peak_{name}" in ds]
    if known:
        most = [f"{name} {_said(view.quantity(name), ds[f'peak_{name}'].max())}" for name in known]
        yield f"greatest accelerations: {', '.join(most)}"
    # recorded only where the scene has friction
    if "friction_work" in ds:
        heat = view.units.of(Quantity("friction_work", "J", "heat", shown_unit="kJ"))
        yield f"friction work {_said(heat, ds['friction_work'].sum())}"
    name = main_peak(ds)
    if f"{name}_percentile" in ds:
        text = f"99th percentile of a window's {view.quantity(name).long_name}"
        yield from _worst(view, text, name, ds[f"{name}_percentile"].sel(percentile=99))
    if "rms_a_z" in ds:
        yield from _worst(view, "RMS of a_z", "a_z", ds["rms_a_z"])
    if "probe_error" in ds and view.scene is not None:
        yield step_error(view.scene, ds["probe_error"].values, ds["probe_error"].attrs.get("over", ""))


def _net_loads(view: RunView) -> Iterator[str]:
    """Yield the greatest net forces of slippers, vertical and lateral, where they were, and the greatest moments."""
    ds = view.ds
    for axis in ("z", "y"):
        at = peak_of(ds.sel(axis=[axis]), NET)
        slipper = at["slipper"].item() if "slipper" in at.coords else ""
        times = ""
        # how much harder than at rest; without gravity and load there is nothing to compare with
        if axis == "z" and view.scene is not None:
            static = static_load(view.scene, slipper, float(at["peak_slipper_distance"]))
            if static > 0:
                load = _said(view.quantity(NET), static)
                times = f": {abs(float(at[NET])) / static:.3g} times its static load of {load}"
        yield from _peak(view, NET, f"greatest net {AXES[axis]} force of a slipper", slipper, at, times)
    if "peak_slipper_moment" in ds:
        moment = abs(ds["peak_slipper_moment"])
        most = moment.max([dim for dim in moment.dims if dim != "about"])
        q = view.quantity("peak_slipper_moment")
        each = [f"{about} {_said(q, value)}" for about, value in zip(most["about"].values, most, strict=True)]
        yield f"greatest net moments of a slipper about its middle: {', '.join(each)}"


def _peak(view: RunView, name: str, text: str, at_what: str, at: xr.Dataset, times: str = "") -> Iterator[str]:
    """Yield in words a force of `PEAKS`, which `at` has, and where it was, unless nothing touched."""
    force = float(at[name])
    # NaN, too, is no force
    if not abs(force) > 0:
        return
    distance = view.quantity("distance")
    where = f"{in_hundredths(distance.shown(float(at[PEAKS[name].place])))} {distance.display_unit}"
    place = f"{where} and {_said(view.quantity('speed'), at[speed_name(view.ds)])}"
    yield f"{text} {_said(view.quantity(name), force)} at {f'{at_what}, ' * bool(at_what)}{place}{times}"


def _worst(view: RunView, text: str, name: str, values: xr.DataArray) -> Iterator[str]:
    """Yield in words the largest value of all stretches, and its stretch; nothing where none is known."""
    # stretches with lost windows are NaN
    k = int(values.fillna(-np.inf).values.argmax())
    if np.isfinite(values[k]):
        stretch = _from_to(view, *edges_of(view.ds, "stretch")[k : k + 2])
        yield f"worst {text}: {_said(view.quantity(name), values[k])} from {stretch}"


def _said(q: Quantity, value: Any) -> str:
    """Return a value [SI unit] of a quantity in words, in its display unit; an acceleration in m/s^2 also in g."""
    text = f"{q.shown(float(value)):.4g} {q.display_unit}"
    return f"{text} ({float(value) / STANDARD_GRAVITY:.3g} g)" if q.display_unit == "m/s^2" else text


def _from_to(view: RunView, begin: float, end: float) -> str:
    """Return a length of rail [m] in words."""
    ends = " to ".join(map(in_hundredths, view.places([begin, end]).tolist()))
    return f"{ends} {view.quantity('distance').display_unit}"


def static_load(scene: Scene, slipper: str, distance: float) -> float:
    """Return the share of a slipper, "" for a single one, in the weight and the load along z at a place [N]."""
    loads = np.ravel(static_loads(scene, scene.travel(scene.epoch_at(distance))))
    return float(loads[scene.slipper.names.index(slipper) if slipper else 0])


def described(view: RunView) -> list[str]:
    """Return the scene of a run in words: its named numbers, and a line for each part."""
    scene = view.scene
    if scene is None:
        return []
    numbers = []
    for name, q in PARAMETERS.items():
        value = q.of(scene)
        # those that are one number
        if value is not None and np.ndim(value) == 0:
            shown = view.units.of(Quantity(name, q.unit, name, shown_unit=q.shown_unit))
            unit = "" if q.unit == "1" else f" {shown.display_unit}"
            numbers.append(f"{name.replace('_', ' ')} {shown.shown(float(value)):.5g}{unit}")
    parts = [f"{name}: {getattr(scene, name)!r}" for name in (*PARTS, "speed") if getattr(scene, name) is not None]
    return [", ".join(numbers), *parts]


class Report(NamedTuple):
    """What the files of a report are made of."""

    title: str
    text: list[str]
    tables: dict[str, pd.DataFrame]
    """By their names, the first one first."""
    figures: Callable[[], Iterator[Figure]]
    """Yields the pages after the text."""


def _of_run(view: RunView) -> Report:
    """Return the report of a run."""
    made = tables(view)
    text = summary(view)
    worst = made["worst places"]
    if len(worst):
        text += ["", f"Worst places, {_said(view.quantity('distance'), APART)} apart or more", ""]
        text += worst.to_string(index=False, float_format="{:.2f}".format).splitlines()
    text += ["", "Scene", "", *described(view)]
    return Report("Run over a rail", text, made, functools.partial(_figures, view))


def _of_designs(ds: xr.Dataset, units: Sequence[str] | None) -> Report:
    """Return the report of designs that were compared."""
    figures = lambda: (axes[0].figure for axes in (comparison(ds, units),))
    return Report("Designs compared", verdict(ds, units), {"designs": table_of_designs(ds, units)}, figures)


def _of_environment(ds: xr.Dataset) -> Report:
    """Return the report of a vibration environment, a page for each place."""
    pages = range(ds.sizes["place"])
    figures = lambda: (vibration(ds, place)[0, 0].figure for place in pages)
    return Report("Vibration environment", environment_summary(ds), {"bands": environment_table(ds)}, figures)


def _pdf(made: Report) -> bytes:
    """Return pages: the summary, what happened along the rail, and spectra."""
    from matplotlib.backends.backend_pdf import PdfPages  # here, because importing it takes time

    content = io.BytesIO()
    # fonts are written at the end of the pages
    with styled(), PdfPages(content, metadata={"Title": made.title}) as pages:
        for figure in pages_of(made):
            pages.savefig(figure)
            plt.close(figure)
    return content.getvalue()


def pages_of(made: Report) -> Iterator[Figure]:
    """Yield the pages of a report: its text, then its pictures."""
    wrapped = [part for line in made.text for part in textwrap.wrap(line, WIDTH, subsequent_indent="    ") or [""]]
    for first in range(0, len(wrapped), LINES):
        figure = plt.figure(figsize=PAGE)
        figure.suptitle(made.title, x=0.06, ha="left", fontsize=12)
        text = "\n".join(wrapped[first : first + LINES])
        # names may have dollar signs, which are no formulae
        figure.text(0.06, 0.94, text, va="top", family="monospace", fontsize=7, linespacing=1.4, parse_math=False)
        yield figure
    yield from made.figures()


def _figures(view: RunView) -> Iterator[Figure]:
    """Yield the pictures of a run, of numbers only where there are some."""
    finite = lambda name: name in view.ds and bool(np.isfinite(view.ds[name]).any())
    panels = {name: functools.partial(_draw_envelope, name=name) for name in PEAKS} | {"impacts": _draw_impacts}
    draws = [draw_speed, *(draw for name, draw in panels.items() if finite(name))]
    page = draw_panels(view, draws)[0].figure
    page.set_size_inches(PAGE)
    yield page
    bands = [name for name in ("a_y", "a_z") if finite(f"band_{name}")]
    if bands:
        yield _spectra(view, bands)


def _draw_envelope(ax: Axes, view: RunView, name: str) -> None:
    """Draw some of `PEAKS` along the rail, a line for each of the highest points or slippers, of `BINS` steps."""
    ds = view.ds
    q = view.quantity(name)
    dim = PEAKS[name].dim
    force = q.shown(abs(PEAKS[name].listed(ds[[name]])[name]))
    size = -(-force.sizes["distance"] // BINS)
    edges = view.edges("distance")
    edges = np.append(edges[:-1:size], edges[-1])
    # NaN only where all of a step is
    highest = force.where(np.isfinite(force)).coarsen(distance=size, boundary="pad").max()
    most = highest.max("distance")
    # points that never touch have no line
    ranked = most.where(most > 0, drop=True).sortby(most, ascending=False)[:POINTS]
    for at, color in zip(ranked[dim].values, POINT_COLORS, strict=False):
        label = f"{at}, {ranked.sel({dim: at}):.4g} {q.display_unit}"
        ax.stairs(highest.sel({dim: at}), edges, baseline=None, lw=0.8, color=color, label=label)
    finish_forces(ax, view, name)


def _draw_impacts(ax: Axes, view: RunView) -> None:
    """Draw the touchdowns of all points in each 100 m of rail."""
    table = of_hundreds(of_windows(view))
    # the last one may be shorter
    per_hundred = table["impacts"] * HUNDRED / (table["to"] - table["from"])
    edges = view.places(np.append(table["from"], table["to"].iloc[-1]))
    ax.stairs(per_hundred, edges, fill=True, color=COLORS["grey"])
    ax.set_ylabel("impacts\nper 100 m")
    ax.set_ylim(bottom=0)


def _spectra(view: RunView, names: list[str]) -> Figure:
    """Draw root mean squares in third octaves: of the whole run, and the highest of all stretches."""
    ds = view.ds
    edges = edges_of_bands(ds["band"].values)
    with page(len(names), 1, 2.6 * len(names) + 0.5, sharex=True, squeeze=False) as grid:
        for ax, name in zip(grid[:, 0], names, strict=True):
            q = view.quantity(name)
            values = q.shown(ds[f"band_{name}"])
            mean = np.sqrt((values**2).mean("stretch"))
            ax.stairs(mean, edges, baseline=None, color=line_color(0), label="mean of all stretches")
            ax.stairs(values.max("stretch"), edges, baseline=None, color=line_color(1), label="highest stretch")
            ax.set(xscale="log", yscale="log")
            ax.set_ylabel(with_unit(f"RMS of ${q.symbol}$\nin third octaves", q.display_unit, brackets=True))
            set_log_ticks(ax.xaxis)
            legend_above(ax)
        grid[-1, 0].set_xlabel("frequency [Hz]")
    return grid[0, 0].figure


def _csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False, float_format="%.9g").encode()


def _xlsx(made: Report) -> bytes:
    """Return a workbook: the text, and the tables as sheets."""
    content = io.BytesIO()
    text = pd.DataFrame({"summary": made.text})
    with pd.ExcelWriter(content, engine="openpyxl") as writer:
        for name, table in {"summary": text, **made.tables}.items():
            table.to_excel(writer, sheet_name=name, index=False, freeze_panes=(1, 0))
            sheet = writer.sheets[name]
            # wide enough for the header
            for column in sheet.columns:
                sheet.column_dimensions[column[0].column_letter].width = max(10, len(str(column[0].value)) + 2)
        writer.sheets["summary"].column_dimensions["A"].width = WIDTH
    return content.getvalue()


MAKERS: dict[str, Callable[[Report], bytes]] = {
    ".pdf": _pdf,
    ".csv": lambda made: _csv(next(iter(made.tables.values()))),
    "_100m.csv": lambda made: _csv(made.tables["100 m"]),
    ".xlsx": _xlsx,
}
"""Functions that make the content of a report's files, by what is added to the name without ending."""
