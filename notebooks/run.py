"""Runs notebooks and keeps their pictures small: `python notebooks/run.py notebooks/01_paper.ipynb ...`.

Needs the extra `notebook`. Times, versions and other traces of the machine are left out of the files.
"""

import base64
import io
import json
import os
import sys
from pathlib import Path

import nbclient
import nbformat
from PIL import Image

COLORS = 256
"""Colours of a picture; line drawings look the same with a few."""


def smaller(png: str) -> str:
    """A picture in base64 with fewer colours."""
    with Image.open(io.BytesIO(base64.b64decode(png))) as picture:
        seen = picture.convert("RGBA")
    white = Image.new("RGBA", seen.size, "white")
    few = Image.alpha_composite(white, seen).convert("RGB").quantize(COLORS, Image.Quantize.MAXCOVERAGE, kmeans=1)
    out = io.BytesIO()
    few.save(out, "png", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


def run(path: Path) -> None:
    """Executes a notebook in place, under Jupyter's own backend."""
    notebook = nbformat.read(path, as_version=4)
    options = {"record_timing": False, "coalesce_streams": True, "kernel_name": "python3", "timeout": 900}
    client = nbclient.NotebookClient(notebook, resources={"metadata": {"path": str(path.parent)}}, **options)
    kept = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    client.execute(env=kept | {"TQDM_DISABLE": "1"})  # no bars in what is kept
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output["data"] = {"image/png": smaller(output["data"]["image/png"])}
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        run(Path(name).resolve())
