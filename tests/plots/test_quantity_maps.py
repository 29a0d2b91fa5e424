"""Any quantity over one parameter or two, also while a store grows."""

import json

import numpy as np
import pytest
import xarray as xr

from slipperjax import plots
from slipperjax.flow.status import Status
from slipperjax.model.parameters import PARAMETERS

from .shown import legend, marked


def swept(dims=("clearance", "speed"), sizes=(3, 4)):
    """Gives peak forces [N] at two points, the second larger; one case is flagged and one is not there yet."""
    values = {"clearance": np.linspace(1e-3, 2e-3, sizes[0]), "speed": np.linspace(1000.0, 1300.0, sizes[-1])}
    force = 1e3 * (1 + np.arange(np.prod(sizes), dtype=float).reshape(sizes))
    status = np.zeros(sizes, int)
    status.flat[1], status.flat[2] = Status.DERAILED, Status.NOT_RUN
    force.flat[2] = np.nan
    both = np.stack([0.5 * force, force], axis=-1)
    coords = {name: (name, values[name], PARAMETERS[name].attributes) for name in dims}
    data = {
        "peak_force": ((*dims, "point"), both),
        "status": (dims, status),
        "kind": (dims, np.full(sizes, "period")),
    }
    return xr.Dataset(data, coords, {"varied": json.dumps(list(dims))})


def test_the_largest_value_is_drawn_in_its_display_unit():
    turned = swept()["peak_force"].transpose("point", "speed", "clearance")
    for ds in (swept(), swept().assign(peak_force=turned)):  # dimensions may come in any order
        ax = plots.quantity_map(ds)
        drawn = ax.collections[0].get_array()
        assert drawn.shape == (3, 4)
        assert drawn[0, 0] == 1.0  # kN, of the second point
        assert drawn.mask.ravel()[:4].tolist() == [False, True, True, False]
        assert ax.get_xlabel() == "speed $V$ [m/s]"
        assert len(legend(ax)) == 2  # the flagged case, grey, and what is not there


def test_one_parameter_is_a_row_of_dots():
    ax = plots.quantity_map(swept(("speed",), (5,)))
    (dots,), (crosses,) = marked(ax, "."), marked(ax, "x")
    assert np.isfinite(dots.get_ydata()).tolist() == [True, False, False, True, True]
    assert dots.get_ydata()[-1] == 5.0
    assert crosses.get_xdata().tolist() == [1075.0]  # the flagged one; what is missing has no mark


def test_what_cannot_be_drawn_is_named():
    for ds, name, words in (
        (swept(), "kind", "with numbers, but kind"),
        (swept(), "penetration", "`penetration`"),
        (swept().expand_dims(mass=[1.0, 2.0]), "peak_force", "over one parameter or two"),
    ):
        with pytest.raises(ValueError, match=words):
            plots.quantity_map(ds, name)
