"""The text of a scene's file, in TOML: values with units, and as remarks the texts of the fields that hold them."""

import ast
import functools
import inspect
import json
import os
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from ..tools.description import TYPE, arguments_of, describe, known_types, type_name
from ..tools.fields import ShapeChecked, unit_of
from ..tools.files import user_path
from .sled import Sled
from .slipper import Slipper

CLEARANCE = "Total play of slipper and rail [m], half of it at each face."
"""Remark on the clearance, which a file has in place of a play that is the same at all faces."""


@dataclass(frozen=True)
class Table:
    """A table of a scene's file."""

    kind: type
    """The class whose fields give units and remarks."""
    values: Mapping[str, object]
    """By name: values [SI unit], and modules or tables, which become tables within this one."""
    texts: Mapping[str, str] = field(default_factory=dict)
    """Remarks in place of those of the fields."""


def table_of(module: eqx.Module, **texts: str) -> Table:
    """Return the table of a module, with its type where a file needs one; `texts` are remarks by name."""
    kind = type(module)
    values = {name: getattr(module, name) for name in arguments_of(kind)}
    # other classes are alternatives of one base
    alone = kind in (Slipper, Sled) or ShapeChecked in kind.__bases__
    return Table(kind, values if alone else {TYPE: type_name(kind)} | values, texts)


def toml_lines(table: Table, path: str = "", *, remarks: bool = False, folder: Path | None = None) -> list[str]:
    """Return a table as lines of TOML, without its header: its values, then the tables within it.

    Numbers are read back to the last bit.

    **Arguments:** `path`: name of the table, empty for the scene; `remarks`: whether each value has its remark above
    it, and each value that is None a remark alone; of successive tables of one class the first has remarks. Digests
    of files are left out then, so that the files may change. `folder`: of the file, to which paths of other files
    become relative; None leaves them.
    """
    texts = {"clearance": CLEARANCE, **_field_texts(table.kind), **table.texts} if remarks else {}
    lines = []
    inner = []
    for name, value in table.values.items():
        rows = value if isinstance(value, tuple | list) else [value]
        if rows and all(isinstance(row, eqx.Module | Table) for row in rows):
            # tables of a sled's mounts and modes are tables of the file
            within = name if path in ("", "slipper") else f"{path}.{name}"
            header = f"[[{within}]]" if rows is value else f"[{within}]"
            kind = None
            for row in rows:
                own = row if isinstance(row, Table) else table_of(row)
                first = remarks and own.kind is not kind
                kind = own.kind
                about = _remark((kind.__doc__ or "").partition("\n\n")[0]) if first else []
                inner += ["", *about, header, *toml_lines(own, within, remarks=first, folder=folder)]
            continue
        value = describe(value)
        unit = unit_of(table.kind, name)
        if value in (None, ""):
            lines += _remark(f"{name}: {texts[name]}") if name in texts else []
            continue
        if name == "sha256" and remarks:
            continue
        if name == "file" and folder is not None and not (file := user_path(value)).is_absolute():
            value = Path(os.path.relpath(file, folder)).as_posix()
        if name == "play" and np.ndim(value) == 1 and np.ptp(value) == 0:
            name = "clearance"
            value = 2 * value[0]
        lines += [*_remark(texts.get(name, "")), f"{name} = {_written(value, unit)}"]
    return lines + inner


def _written(value: Any, unit: str) -> str:
    """Return a value in TOML: with a unit a number as a text, and an array as an inline table."""
    if unit in ("", "1"):
        return json.dumps(value)
    # short lengths are in mm where this loses no bit
    if unit == "m" and 0 < np.max(np.abs(value)) < 0.1:
        shown = np.round(np.multiply(value, 1e3), 9)
        if np.array_equal(shown * 1e-3, value):
            value, unit = shown.tolist(), "mm"
    if isinstance(value, list):
        listed = json.dumps(value)
        # a matrix has a line for each row
        if isinstance(value[0], list):
            listed = "[\n    " + ",\n    ".join(map(json.dumps, value)) + ",\n]"
        return f"{{ unit = {json.dumps(unit)}, values = {listed} }}"
    short = f"{value:.9g}"
    return json.dumps(f"{short if float(short) == value else repr(value)} {unit}")


def _remark(text: str) -> list[str]:
    """Return a text as lines of remarks."""
    return textwrap.wrap(" ".join(text.split()), 98, initial_indent="# ", subsequent_indent="# ")


@functools.cache
def _field_texts(kind: type) -> dict[str, str]:
    """Return the texts below the fields of a class, inherited fields included, and the alternatives to its type."""
    bases = [base for base in kind.__mro__ if issubclass(base, eqx.Module) and base not in (eqx.Module, ShapeChecked)]
    texts = {}
    for base in reversed(bases):
        try:
            source = textwrap.dedent(inspect.getsource(base))
        except (OSError, TypeError):  # a class that was typed, not read from a file
            continue
        for one, below in pairwise(ast.parse(source).body[0].body):
            if isinstance(one, ast.AnnAssign) and isinstance(below, ast.Expr):
                texts[one.target.id] = ast.literal_eval(below.value)
    others = sorted(name for name in known_types(bases[-1:]) if "." not in name and name != kind.__name__)
    return texts | {TYPE: f"Or {', '.join(others)}."}
