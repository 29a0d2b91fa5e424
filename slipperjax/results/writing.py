"""Files of results, by their endings."""

import importlib.util
import io
import os
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..tools.checks import require
from ..tools.files import Content, user_path

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from .kinds import Kind

PICTURES = (".png", ".svg", ".pdf")
ENDINGS = (".nc", *PICTURES, ".csv", ".xlsx", ".mat")
"""Endings of the files that results write."""
WIDTH = 105
"""Characters in a line of a page of text."""
LINES = 78
"""Lines on a page of text."""
DPI = 300
"""Least pixels per inch of a PNG file, also where a text spreads it over `TEXT`."""
TEXT = 16 / 2.54
"""Width of a page in a text [inches]."""
PAGE = (7.2, 9.4)
"""Size of a page of text [inches]."""


def check_ending(path: Path, name: str = "paths") -> str:
    """Return the ending of a file that results write.

    **Raises:** `ValueError` for an unknown ending, or one whose package is missing.
    """
    ending = path.suffix.lower()
    require(ending in ENDINGS, name, f"end in one of {', '.join(ENDINGS)}", path.name)
    if ending == ".xlsx" and importlib.util.find_spec("openpyxl") is None:
        raise ValueError(f"A workbook such as {path.name} needs openpyxl: pip install 'slipperjax[report]'.")
    return ending


def contents_of(
    kind: "Kind",
    ds: "xr.Dataset",
    paths: Sequence[str | os.PathLike[str]],
    units: Sequence[str] | None,
    options: Mapping[str, Any],
) -> dict[Path, Callable[[], Content]]:
    """Return functions that make the content of files, by path.

    **Arguments:** `kind`: of the result whose dataset is `ds`; others as for `AbstractResult.write`.
    """
    contents: dict[Path, Callable[[], Content]] = {}
    for given in paths:
        path = user_path(given, "paths")
        ending = check_ending(path)
        if ending == ".csv":
            contents |= csv_files(path, kind.tables(ds, units))
        else:
            contents[path] = partial(_content, kind, ds, ending, units, options)
    return contents


def _content(
    kind: "Kind", ds: "xr.Dataset", ending: str, units: Sequence[str] | None, options: Mapping[str, Any]
) -> Content:
    """Return the content of a file of a result, by its ending; a PDF has all pages of the report, if any."""
    if ending == ".nc":
        # made in memory, because HDF5 ends the whole process where a disk is full
        return ds.to_netcdf(engine="h5netcdf")
    if ending == ".mat":
        return _matlab(ds)
    if ending == ".xlsx":
        return _workbook(kind, ds, units)
    from ..plots.style import content_of, in_units, png

    ds = in_units(ds, units)

    def draw() -> "Figure":
        # all Axes of a picture are in one figure
        first = np.asarray(kind.plot(ds, **options)).flat[0]
        need = "be a function that returns Axes of matplotlib"
        require(hasattr(first, "figure"), "picture", need, shown=f"one of {type(first).__name__}")
        return first.figure

    if ending == ".pdf" and kind.title:
        text = (kind.report or kind.summary)(ds, units)
        return _report(kind.title, text, kind.pages(ds) if kind.pages else [draw()])
    figure = draw()
    if ending == ".png":
        return png(figure, round(DPI * max(1.0, TEXT / figure.get_figwidth())))
    return content_of(figure, ending[1:])


def _matlab(ds: "xr.Dataset") -> Content:
    """Return variables, coordinates and attributes for MATLAB, where names have only letters, digits and _."""
    from scipy.io import savemat

    def named(values: Mapping[Any, Any]) -> dict[str, Any]:
        arrays = {re.sub(r"\W+", "_", str(name)).strip("_"): np.asarray(value) for name, value in values.items()}
        # texts of different lengths are cells
        texts = {name for name, array in arrays.items() if array.dtype.kind in "OUT" and array.ndim}
        return {name: array.astype(object) if name in texts else array for name, array in arrays.items()}

    content = io.BytesIO()
    contents = named(ds.variables) | {"attributes": named(ds.attrs)}
    savemat(content, contents, long_field_names=True, oned_as="column")
    return content.getvalue()


def csv_files(path: Path, tables: "Mapping[str, pd.DataFrame]") -> dict[Path, Callable[[], Content]]:
    """Return functions that make the files of tables: the main table at `path`, others with their names added."""
    contents = {}
    for k, (name, table) in enumerate(tables.items()):
        more = f"_{name.replace(' ', '')}" if k else ""
        make = lambda table=table: table.to_csv(index=False, float_format="%.9g").encode()
        contents[path.with_name(f"{path.stem}{more}.csv")] = make
    return contents


def _workbook(kind: "Kind", ds: "xr.Dataset", units: Sequence[str] | None) -> Content:
    """Return a workbook: the text, and the tables as sheets."""
    import pandas as pd

    content = io.BytesIO()
    words = pd.DataFrame({"summary": kind.summary(ds, units)})
    with pd.ExcelWriter(content, engine="openpyxl") as writer:
        for name, table in {"summary": words, **kind.tables(ds, units)}.items():
            table.to_excel(writer, sheet_name=name, index=False, freeze_panes=(1, 0))
            sheet = writer.sheets[name]
            # wide enough for the header
            for column in sheet.columns:
                sheet.column_dimensions[column[0].column_letter].width = max(10, len(str(column[0].value)) + 2)
        writer.sheets["summary"].column_dimensions["A"].width = WIDTH
    return content.getvalue()


def _report(title: str, text: Sequence[str], pictures: "Iterable[Figure]") -> Content:
    """Return pages: text, then pictures."""
    import matplotlib.pyplot as plt
    from matplotlib.backends.backend_pdf import PdfPages

    from ..plots.style import styled

    content = io.BytesIO()
    # fonts are written at the end of the pages
    with styled(), PdfPages(content, metadata={"Title": title}) as pages:
        for figure in (*_pages_of_words(title, text), *pictures):
            pages.savefig(figure)
            plt.close(figure)
    return content.getvalue()


def _pages_of_words(title: str, text: Sequence[str]) -> "Iterator[Figure]":
    """Yield the pages of a report with text."""
    import matplotlib.pyplot as plt

    wrapped = [part for line in text for part in textwrap.wrap(line, WIDTH, subsequent_indent="    ") or [""]]
    for first in range(0, len(wrapped), LINES):
        figure = plt.figure(figsize=PAGE)
        figure.suptitle(title, x=0.06, ha="left", fontsize=12)
        words = "\n".join(wrapped[first : first + LINES])
        # names may have dollar signs, which do not mean formulae
        figure.text(0.06, 0.94, words, va="top", family="monospace", fontsize=7, linespacing=1.4, parse_math=False)
        yield figure
