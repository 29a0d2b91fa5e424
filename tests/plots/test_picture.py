"""The picture that fits a result, and datasets that draw themselves."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from slipperjax import plots
from slipperjax.model.quantities import SECTIONS
from slipperjax.plots import picture

from .test_plots import trajectory


@pytest.fixture
def drawn(monkeypatch):
    """Replaces each picture by its name; gives what was asked of them."""
    asked = []
    named = [(names, count, draw.__name__) for names, count, draw in picture.PICTURES]
    note = lambda name: lambda ds, **options: np.array(asked.append((name, options)))
    monkeypatch.setattr(picture, "PICTURES", tuple((names, count, note(name)) for names, count, name in named))
    monkeypatch.setattr(picture, "quantity_map", note("quantity_map"))
    return asked


def over(*dims, **variables):
    """A dataset over some parameters, with variables over these and further dimensions."""
    sizes = [2] * len(dims)
    data = {name: ((*dims, *more), np.zeros([*sizes, *[2] * len(more)])) for name, more in variables.items()}
    return xr.Dataset(data | {"status": (dims, np.zeros(sizes, int))})


@pytest.mark.parametrize(
    ("ds", "name"),
    [
        (over(peak_force=["distance"], seconds=["distance"], state=["stretch"]), "run_overview"),
        (over("speed", trial_design=["trial"]), "design_overview"),
        (over("speed", stable=[], event_point=["event"]), "branches"),
        (over(contact_force=["time"]), "overview"),
        (over("speed", "length", regime=[], exponent=[], kind=[], period=[]), "regime_map"),
        (over("speed", regime=[], exponent=[]), "exponents"),
        (over("speed", "length", kind=[], period=[]), "attractor_map"),
        (over("speed", **{name: ["crossing"] for name in SECTIONS}, strobe=["strobe_period"]), "bifurcations"),
        (over("speed", strobe=["strobe_period"], peak_force=["end", "point"]), "quantity_map"),
    ],
)
def test_each_result_has_its_picture(ds, name, drawn):
    ds.plot()
    assert drawn == [(name, {"name": "peak_force"} if name == "quantity_map" else {})]


def test_the_dimension_of_slippers_is_not_hidden_by_the_pictures():
    ds = over("slipper", mass=[]).assign_coords(slipper=["front", "rear"])
    assert ds.slipper.values.tolist() == np.asarray(ds.slipper).tolist() == ["front", "rear"]
    assert (len(ds.slipper), ds.slipper.dims, str(ds.slipper[1].values)) == (2, ("slipper",), "rear")
    with pytest.raises(AttributeError):
        over("speed").slipper.values  # noqa: B018


def test_pictures_of_a_trajectory_take_it_as_it_is():
    run = SimpleNamespace(to_xarray=trajectory)
    for draw in (plots.overview, plots.plot, plots.contact_forces):
        draw(run)
    assert len(trajectory().slipper.contact_forces(most=2).get_lines()) >= 2


@pytest.mark.full
def test_datasets_draw_themselves_as_soon_as_there_are_any_and_say_where_no_picture_fits():
    code = "import xarray, slipperjax, sys; xarray.Dataset().slipper; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    for ds in (over("speed", "length", "mass", kind=[]), xr.Dataset()):
        with pytest.raises(ValueError, match=r"`result` must have a picture that fits, but is over .*\.isel"):
            ds.plot()
