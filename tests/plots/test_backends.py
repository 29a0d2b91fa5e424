"""Every picture of a notebook is shown, the first one of a session included."""

import pytest

from ..notebooks import executed, pictures

MADE = """
import numpy as np
import xarray as xr

from slipperjax import plots

period = np.linspace(0, 2, 101)
names = ("y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z", "drive_force")
force = ("time", "end", "point"), np.ones((101, 2, 3))
ds = xr.Dataset(
    {name: ("time", np.sin(period)) for name in names} | {"contact_force": force},
    {"period": ("time", period), "end": ["front", "rear"], "point": list("ABC")},
)
"""


@pytest.mark.filterwarnings("default")  # those of the client are not ours
def test_a_notebook_shows_every_picture(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    cells = [
        MADE,
        "plots.overview(ds);",
        "plots.history(ds, 'y');",
        "plots.phase_portrait(ds, 'y', 'v_y');",
        "plots.contact_forces(ds);",
        "plots.highest_forces(ds);",
        "import matplotlib\nprint(matplotlib.get_backend(), matplotlib.is_interactive())",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in cells])
    executed(notebook, tmp_path, timeout=120)
    assert pictures(notebook) == [0, 1, 1, 1, 1, 1, 0]
    assert "inline" in notebook.cells[-1].outputs[0].text
    assert notebook.cells[-1].outputs[0].text.endswith("True\n")
