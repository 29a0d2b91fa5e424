"""The notebooks are kept with their pictures, and run from top to bottom under Jupyter's own backend."""

import json
import re
from pathlib import Path

import pytest

from .notebooks import executed, pictures

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
LARGEST = 400e3
"""Bytes of a notebook with its pictures."""
DRAWS = re.compile(r"\bplots\.(?!styled)[a-z_]+\(|\bplt\.(subplots|figure|plot)\(")
"""Functions that make a picture."""
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def code_cells(notebook):
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def faults(notebook):
    """Lists faults of a kept notebook, a line each."""
    found, code = [], code_cells(notebook)
    if [cell["execution_count"] for cell in code] != list(range(1, len(code) + 1)):
        found.append("cells were not executed in order")
    for k, (cell, shown) in enumerate(zip(code, pictures(notebook), strict=True)):
        outputs = cell["outputs"]
        if any(o["output_type"] == "error" or o.get("name") == "stderr" for o in outputs):
            found.append(f"cell {k} has an error or a warning")
        if DRAWS.search("".join(cell["source"])) and not shown:
            found.append(f"cell {k} draws, but shows no picture")
        if cell["metadata"]:
            found.append(f"cell {k} has metadata")
    if re.search(r"/(home|tmp|work|root|usr|Users|opt)/", json.dumps([cell["outputs"] for cell in code])):
        found.append("an output names a path of a machine")
    return found


@each
def test_notebooks_are_kept_as_they_ran(path):
    notebook = json.loads(path.read_text())
    assert faults(notebook) == []
    assert sum(pictures(notebook)) >= 3
    assert path.stat().st_size < LARGEST


@each
def test_notebooks_read_as_a_story(path):
    """Text before and after each cell that shows a picture."""
    kinds = [(cell["cell_type"], cell.get("outputs")) for cell in json.loads(path.read_text())["cells"]]
    for k, (_, outputs) in enumerate(kinds):
        if any("image/png" in output.get("data", {}) for output in outputs or []):
            assert [kinds[k - 1][0], kinds[k + 1][0]] == ["markdown", "markdown"], k


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # those of the client are not ours
@each
def test_notebooks_run(path, tmp_path):
    nbformat = pytest.importorskip("nbformat")
    kept = json.loads(path.read_text())
    again = executed(nbformat.read(path, as_version=4), tmp_path)
    assert pictures(again) == pictures(kept)
    assert faults({"cells": [cell | {"metadata": {}} for cell in again.cells]}) == []
