"""Commands that show what a result holds and how it was made, and what differs between two results."""

import inspect
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from ..flow.datasets import flattened, function_of, named_parameters, sources_of
from ..model.parameters import PARAMETERS
from ..model.quantities import NET_DIMS
from ..tools.checks import require
from ..tools.files import listed, write_each
from .files import Outputs, said
from .options import INPUT, app, of_module, option, result

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from ..results.result import AbstractResult

SHOWN = 12
"""Most differences between two results that are listed."""
LONG = 4
"""Most values of a list that are shown."""
OWN = ("function", "only", "record")
"""Parts of a call that are no differences between two results of one function."""
PARTS = ("slipper", *NET_DIMS, "mean", "quantile")
"""Dimensions whose values are compared apart."""


def _result(path: Path) -> "AbstractResult":
    """Return the result in a file or a store."""
    from ..results.result import AbstractResult
    from ..sweeps.loading import load

    found = load(path)
    if not isinstance(found, AbstractResult):
        raise ValueError(f"Argument `FILE` must be a result such as run.nc, but is {path}.")
    return found


@app.command()
@click.argument("file", metavar="FILE", type=INPUT)
@option("--units", str, "Unit of shown numbers, such as ft, lbf or g; repeat for several.", multiple=True, default=())
@option("--picture", str, "Picture for --out: a function of slipperjax.plots, or one of yours, my_module.histogram.")
@option("--variable", str, "Variable for --picture, such as peak_force; repeat for several.", multiple=True)
@result(None)
def show(
    file: Path, units: tuple[str, ...], picture: str | None, variable: tuple[str, ...], out: Sequence[Path]
) -> int:
    """Show what FILE, a result such as run.nc, holds: its question, scene, files with their digests, and numbers.

    With --out its tables or pictures are written. To repeat a run with one change: slipperjax run run.nc --set
    play.vertical="0.1 in".
    """
    from ..plots.style import shown_units

    found = _result(file)
    ds = found.ds
    require(out or not picture, "--picture", "come with --out", picture)
    draw = None if picture is None else _drawing(picture, variable)
    if out:
        said(Outputs(out).write(found, units=units or None, picture=draw))
    scene = ", ".join(named_parameters(ds.attrs, shown_units(ds, units or None)).values())
    versions = listed([f"{name} {number}" for name, number in json.loads(ds.attrs.get("versions", "{}")).items()])
    said(f"{file}: {function_of(ds)}", *_asked(ds), f"scene: {scene}", *sources_of(ds), f"made by {versions}", "")
    said(*found.summary(units or None))
    return 0


def _drawing(picture: str, variables: Sequence[str]) -> "Callable[[xr.Dataset], object]":
    """Return the function that draws variables of a dataset as a picture, by the name of its function."""
    draw = of_module("--picture", picture if "." in picture else f"slipperjax.plots.{picture}")
    try:
        inspect.signature(draw).bind(None, *variables)
    except TypeError as error:
        raise ValueError(f"Option --picture must be a function of a result and each --variable: {error}.") from None
    return lambda ds: draw(ds, *variables)


def _asked(ds: "xr.Dataset") -> Iterator[str]:
    """Yield the arguments of the call, and the parameters that vary."""
    call = json.loads(ds.attrs["call"])
    given = {name: _short(value) for name, value in call.items() if name not in OWN and value not in (None, [])}
    if given:
        yield "asked: " + ", ".join(f"{name} {value}" for name, value in given.items())
    for name in json.loads(ds.attrs.get("varied", "[]")):
        values = np.unique(ds[name].values)
        unit = ds[name].attrs.get("units", "1")
        yield f"over {name}: {len(values)} values, {values[0]:g} to {values[-1]:g}{'' if unit == '1' else f' {unit}'}"


def _short(value: object) -> str:
    """Return a value as a short text: a class by its name, a long list by its length."""
    if isinstance(value, dict):
        return str(value.get("type", "given")).rpartition(".")[2]
    if isinstance(value, list) and len(value) > LONG:
        return f"[{len(value)} values]"
    return str(value)


@app.command()
@click.argument("first", metavar="FIRST", type=INPUT)
@click.argument("second", metavar="SECOND", type=INPUT)
@option("--out", Path, "CSV file of the table; for runs a further file has each window.", default=None)
def compare(first: Path, second: Path, out: Path | None) -> int:
    """Compare two results of one kind, such as runs with two plays: what differs in scene and call, and each number.

    Numbers are the greatest magnitudes over the run, of each slipper and axis.
    """
    import pandas as pd

    a, b = _result(first).ds, _result(second).ds
    require(function_of(a) == function_of(b), "SECOND", f"be of {function_of(a)}, as {first}", function_of(b))
    lines = list(_differences(a, b))
    said(f"{first} and {second}: {function_of(a)}", *(lines[:SHOWN] or ["the same scene and call"]))
    if len(lines) > SHOWN:
        said(f"and {len(lines) - SHOWN} further differences")
    table = pd.DataFrame(_greatest(a, b), columns=["quantity", "first", "second", "change [%]"])
    said("", *table.to_string(index=False, float_format="{:.4g}".format).splitlines())
    if out is not None:
        from ..results.writing import csv_files

        (path,) = Outputs([out]).paths
        require(path.suffix.lower() == ".csv", "--out", "end in .csv", path.name)
        said(write_each(csv_files(path, {"greatest": table, **_windows(a, b)})))
    return 0


def _differences(a: "xr.Dataset", b: "xr.Dataset") -> Iterator[str]:
    """Yield the parameters, and the parts of scene and call, that differ."""
    from ..plots.style import shown_units

    units = shown_units(a)
    one, other = (named_parameters(ds.attrs, units) for ds in (a, b))
    for name in dict.fromkeys([*one, *other]):
        if one.get(name) != other.get(name):
            yield f"{one.get(name, f'no {name}')}, then {other.get(name, f'no {name}')}"
    for attribute in ("scene", "call"):
        one, other = (dict(flattened(json.loads(ds.attrs.get(attribute, "{}")))) for ds in (a, b))
        for path in dict.fromkeys([*one, *other]):
            x, y = one.get(path), other.get(path)
            # numbers with a name are above, and long lists say nothing
            named = any(p.path == path for p in PARAMETERS.values()) or path.startswith(OWN)
            if x != y and not named:
                yield f"{attribute} {path}: {_short(x)}, then {_short(y)}"


def _greatest(a: "xr.Dataset", b: "xr.Dataset") -> Iterator[tuple[str, float, float, float]]:
    """Yield the greatest magnitude of each number of both results, of each slipper and axis, in a user's units."""
    from ..plots.style import quantity_of

    for name, values in a.data_vars.items():
        # places are no magnitudes
        is_number = values.dtype.kind == "f" and "units" in values.attrs and not str(name).endswith("distance")
        if name not in b or not is_number or set(values.dims) != set(b[name].dims):
            continue
        kept = [dim for dim in values.dims if dim in PARTS]
        over = [dim for dim in values.dims if dim not in kept]
        one, other = (abs(ds[name]).max(over).transpose(*kept) for ds in (a, b))
        if one.shape != other.shape:
            continue
        q = quantity_of(str(name), a)
        unit = "" if q.display_unit == "1" else f" [{q.display_unit}]"
        for at in np.ndindex(one.shape):
            labels = "".join(f" {one[dim].values[k]}" for dim, k in zip(kept, at, strict=True))
            x, y = (float(q.shown(part.values[at])) for part in (one, other))
            yield f"{name}{labels}{unit}", x, y, 100 * (y - x) / x if x else np.nan


def _windows(a: "xr.Dataset", b: "xr.Dataset") -> "dict[str, pd.DataFrame]":
    """Return a table of the net forces of two runs in each window; none where the windows differ."""
    import pandas as pd

    name = "peak_slipper_force"
    has = all(name in ds and "distance" in ds[name].dims for ds in (a, b))
    if not has or not np.array_equal(a["distance"], b["distance"]):
        return {}
    columns = {"distance [m]": a["distance"].values}
    for word, ds in (("first", a), ("second", b)):
        force = ds[name].transpose("distance", ...)
        for at in np.ndindex(force.shape[1:]):
            labels = "".join(f" {force[dim].values[k]}" for dim, k in zip(force.dims[1:], at, strict=True))
            columns[f"{word}{labels} [N]"] = force.values[(slice(None), *at)]
    return {"windows": pd.DataFrame(columns)}
