"""Notebooks run under Jupyter's own backend, as a user sees them."""

import os
from pathlib import Path
from typing import Any

import pytest

PICTURES = ("image/png", "image/gif")


def executed(notebook: Any, folder: Path, timeout: int = 600) -> Any:
    """Runs a notebook in a kernel of its own with `folder` as working directory, in place.

    Skips the test where Jupyter's client or kernel is not installed.
    """
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    resources = {"metadata": {"path": str(folder)}}
    client = nbclient.NotebookClient(notebook, timeout=timeout, kernel_name="python3", resources=resources)
    # a backend chosen for the tests is not that of a notebook
    client.execute(env={name: value for name, value in os.environ.items() if name != "MPLBACKEND"})
    return notebook


def pictures(notebook: Any) -> list[int]:
    """Number of pictures in the output of each code cell."""
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [sum(any(kind in o.get("data", {}) for kind in PICTURES) for o in cell["outputs"]) for cell in cells]
