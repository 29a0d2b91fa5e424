"""Commands that show what a result holds and how it was made, and what differs between two results."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from ..flow.datasets import function_of
from ..tools.checks import require
from .files import Outputs, said
from .options import INPUT, app, option

if TYPE_CHECKING:
    import xarray as xr

    from ..results.result import Result

SHOWN = 12
"""Most differences between two scenes that are listed."""
DEFAULTS = ("function", "only")
"""Parts of a call that are no arguments of a user."""
MISSING = "none"


def _result(path: Path) -> "Result":
    """Return the result in a file or a store."""
    from ..results.result import AbstractResult
    from ..sweeps.loading import load

    found = load(path)
    require(isinstance(found, AbstractResult), "FILE", "be a result such as run.nc", str(path))
    return found  # type: ignore[return-value]


@app.command()
@click.argument("file", metavar="FILE", type=INPUT)
@click.option("--units", multiple=True, help="Unit of shown numbers, such as ft, lbf or g; repeat for several.")
def show(file: Path, units: Sequence[str]) -> int:
    """Show what FILE, a result such as run.nc, holds: its question, scene, files with their digests, and numbers.

    To repeat a run with one change: slipperjax run run.nc --set play.vertical="0.1 in".
    """
    result = _result(file)
    ds = result.ds
    said(f"{file}: {function_of(ds)}", *_asked(ds), *_scene_lines(ds), *_files(ds), *_versions(ds), "")
    said(*result.summary(units or None))
    return 0


def _asked(ds: "xr.Dataset") -> Iterator[str]:
    """Yield the arguments of the call that differ from None, and the parameters that vary."""
    call = json.loads(ds.attrs["call"])
    given = {name: value for name, value in call.items() if name not in DEFAULTS and value not in (None, [], ())}
    if given:
        yield "asked: " + ", ".join(f"{name} {_short(value)}" for name, value in given.items())
    for name in json.loads(ds.attrs.get("varied", "[]")):
        values = np.ravel(ds[name].values)
        unit = ds[name].attrs.get("units", "1")
        shown = f"{values.min():g} to {values.max():g}" if values.size > 1 else f"{values[0]:g}"
        yield f"over {name}: {len(np.unique(values))} values, {shown}{'' if unit == '1' else f' {unit}'}"


def _short(value: object) -> str:
    """Return a value of a call as a short text: a class by its name."""
    if isinstance(value, dict):
        return str(value.get("type", "given")).rpartition(".")[2]
    if isinstance(value, list) and len(value) > 4:
        return f"[{len(value)} values]"
    return str(value)


def _scene_lines(ds: "xr.Dataset") -> Iterator[str]:
    """Yield the scene's parameters, and its parts by their kinds."""
    from ..plots.style import case_title

    title = case_title(ds, full=True)
    if title:
        yield f"scene: {title.replace(chr(10), ', ')}"


def _files(ds: "xr.Dataset") -> Iterator[str]:
    """Yield the files that the scene was made from, with their digests."""
    for path, value in flattened(json.loads(ds.attrs.get("scene", "{}"))):
        part, _, name = path.rpartition(".")
        if name == "file" and value:
            digests = dict(flattened(json.loads(ds.attrs["scene"])))
            yield f"{part} from {value}, sha256 {digests.get(f'{part}.sha256', 'unknown')}"
        if name == "source" and value:
            yield f"{part} from {value}"


def _versions(ds: "xr.Dataset") -> Iterator[str]:
    versions = json.loads(ds.attrs.get("versions", "{}"))
    if versions:
        yield "made by " + ", ".join(f"{name} {number}" for name, number in versions.items())


def flattened(value: object, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers and texts of a description of a scene, by their paths."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from flattened(part, f"{path}.{name}" if path else str(name))
    elif isinstance(value, list) and any(isinstance(part, dict | list) for part in value):
        for k, part in enumerate(value):
            yield from flattened(part, f"{path}.{k}")
    else:
        yield path, value


@app.command()
@click.argument("first", metavar="FIRST", type=INPUT)
@click.argument("second", metavar="SECOND", type=INPUT)
@option("--out", Path, "File of the table: .csv or .xlsx.", default=None)
def compare(first: Path, second: Path, out: Path | None) -> int:
    """Compare two results of one kind, such as runs with two plays: what differs in scene and call, and each number.

    Numbers are the greatest magnitudes over the run, of each slipper and axis. With --out also for each window.
    """
    import pandas as pd

    results = [_result(path).ds for path in (first, second)]
    functions = [function_of(ds) for ds in results]
    require(functions[0] == functions[1], "SECOND", f"be of {functions[0]}, as {first}", functions[1])
    lines = list(_differences(*results))
    said(f"{first} and {second}: {functions[0]}", *(lines[:SHOWN] or ["the same scene and call"]))
    if len(lines) > SHOWN:
        said(f"and {len(lines) - SHOWN} further differences")
    table = pd.DataFrame(_greatest(*results), columns=["quantity", "first", "second", "change [%]"])
    said("", *table.to_string(index=False, float_format="{:.4g}".format).splitlines())
    if out is not None:
        _write(Outputs([out]).paths[0], table, *results)
        said(f"wrote {out}")
    return 0


def _differences(a: "xr.Dataset", b: "xr.Dataset") -> Iterator[str]:
    """Yield the parts of scene and call that differ."""
    for name in ("scene", "call"):
        one, other = (dict(flattened(json.loads(ds.attrs.get(name, "{}")))) for ds in (a, b))
        for path in dict.fromkeys([*one, *other]):
            if one.get(path, MISSING) != other.get(path, MISSING):
                yield f"{name} {path}: {_short(one.get(path, MISSING))}, then {_short(other.get(path, MISSING))}"


def _greatest(a: "xr.Dataset", b: "xr.Dataset") -> Iterator[tuple[str, float, float, float]]:
    """Yield the greatest magnitude of each number of both results, of each slipper and axis, in SI units."""
    from ..model.quantities import NET_DIMS

    for name, values in a.data_vars.items():
        if name not in b or values.dtype.kind != "f" or set(values.dims) != set(b[name].dims):
            continue
        kept = [dim for dim in values.dims if dim in ("slipper", *NET_DIMS, "mean", "quantile")]
        over = [dim for dim in values.dims if dim not in kept]
        one, other = (abs(ds[name]).max(over).transpose(*kept) for ds in (a, b))
        if one.shape != other.shape:
            continue
        for at in np.ndindex(one.shape):
            labels = " ".join(str(one[dim].values[k]) for dim, k in zip(kept, at, strict=True))
            x, y = float(one.values[at]), float(other.values[at])
            change = 100 * (y - x) / x if x else np.nan
            unit = values.attrs.get("units", "")
            yield f"{name} {labels}".strip() + (f" [{unit}]" if unit not in ("", "1") else ""), x, y, change


def _write(path: Path, table: Any, a: "xr.Dataset", b: "xr.Dataset") -> None:
    """Write the table, and for two runs of equal windows one with their greatest forces in each window."""
    import pandas as pd

    from ..tools.files import write_whole

    tables = {"greatest": table}
    same = "distance" in a.dims and np.array_equal(a["distance"], b["distance"])
    if same and "peak_slipper_force" in a and "peak_slipper_force" in b:
        columns = {"distance [m]": a["distance"].values}
        for word, ds in (("first", a), ("second", b)):
            force = ds["peak_slipper_force"]
            others = [dim for dim in force.dims if dim != "distance"]
            stacked = force.transpose("distance", *others)
            for at in np.ndindex(stacked.shape[1:]):
                labels = " ".join(str(force[dim].values[k]) for dim, k in zip(others, at, strict=True))
                columns[f"{word} {labels} [N]"] = stacked.values[(slice(None), *at)]
        tables["windows"] = pd.DataFrame(columns)
    from ..results.writing import table_contents

    for each, content in table_contents(path, tables).items():
        write_whole(each, content())
