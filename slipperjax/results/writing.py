"""Files of results, by their endings."""

import functools
import importlib.util
import io
import os
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..tools.checks import require
from ..tools.files import Content, user_path

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from .kind import Kind

PICTURES = (".png", ".svg", ".pdf")
ENDINGS = (".nc", *PICTURES, ".csv", ".xlsx", ".mat")
"""Endings of the files that results write."""
WIDTH = 105
"""Characters in a line of a page of text."""
LINES = 78
"""Lines on a page of text."""
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
        if ending in PICTURES:
            contents[path] = functools.partial(_picture, kind, ds, ending, units, options)
        elif ending == ".csv":
            contents |= _tables(path, kind.tables(ds, units))
        elif ending == ".xlsx":
            contents[path] = functools.partial(_workbook, kind, ds, units)
        else:
            contents[path] = functools.partial(_NUMBERS[ending], ds)
    return contents


def _netcdf(ds: "xr.Dataset") -> Content:
    # made in memory, because HDF5 ends the whole process where a disk is full
    return ds.to_netcdf(engine="h5netcdf")


def _matlab(ds: "xr.Dataset") -> Content:
    """Return variables, coordinates and attributes for MATLAB, where names have only letters, digits and _."""
    from scipy.io import savemat

    named = {_matlab_name(str(name)): _matlab_value(ds[name].values) for name in ds.variables}
    named["attributes"] = {_matlab_name(str(name)): _matlab_value(value) for name, value in ds.attrs.items()}
    content = io.BytesIO()
    savemat(content, named, long_field_names=True, oned_as="column")
    return content.getvalue()


def _matlab_name(name: str) -> str:
    return re.sub(r"\W+", "_", name).strip("_")


def _matlab_value(value: Any) -> Any:
    array = np.asarray(value)
    # texts of different lengths are cells
    return array.astype(object) if array.dtype.kind in "OUT" and array.ndim else value


_NUMBERS: "dict[str, Callable[[xr.Dataset], Content]]" = {".nc": _netcdf, ".mat": _matlab}


def _tables(path: Path, tables: "Mapping[str, pd.DataFrame]") -> dict[Path, Callable[[], Content]]:
    """Return functions that make the files of tables: the main table at `path`, others with their names added."""
    contents = {}
    for k, (name, table) in enumerate(tables.items()):
        more = f"_{name.replace(' ', '')}" if k else ""
        contents[path.with_name(f"{path.stem}{more}.csv")] = functools.partial(_csv, table)
    return contents


def _csv(table: "pd.DataFrame") -> Content:
    return table.to_csv(index=False, float_format="%.9g").encode()


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


def _picture(
    kind: "Kind", ds: "xr.Dataset", ending: str, units: Sequence[str] | None, options: Mapping[str, Any]
) -> Content:
    """Return the picture of a result as the content of a file; a PDF has all pages of the report, if any."""
    from ..plots.style import FILES

    if ending == ".pdf" and kind.reports:
        return _report(kind.title, kind.report(ds, units), kind.pages(ds, units))
    own = {"units": units} if kind.reports and units is not None else {}
    # all Axes of a picture are in one figure
    return FILES[ending](np.asarray(kind.plot(ds, **own, **options)).flat[0].figure)


def _report(title: str, text: Sequence[str], pictures: "Iterator[Figure]") -> Content:
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
