"""Maps of attractors: names, colours and legends, alone and beneath curves."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex, to_rgb

from slipperjax import plots
from slipperjax.flow.status import Status
from slipperjax.plots.maps import motions_of
from slipperjax.plots.style import COLORS, MOTION_COLORS

from .shown import check_legend_fits, labels, legend


def attractor_map():
    kind = np.array([["period", "period", "torus", "chaotic"], ["period", "unresolved", "period", "period"]])
    period = np.array([[1, 2, 0, 0], [12, 0, 1, 3]])
    status = np.zeros((2, 4), int)
    status[1, 2] = 3
    dims = ("clearance", "speed")
    grid = {"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0, 4.0]}
    return xr.Dataset({"kind": (dims, kind), "period": (dims, period), "status": (dims, status)}, grid)


def curve(period=1):
    coords = {"speed": ("point", np.arange(1.0, 6)), "clearance": ("point", np.linspace(1e-3, 2e-3, 5))}
    attrs = {"label": "PD", "varied": json.dumps(["speed", "clearance"]), "orbit_period": period}
    return xr.Dataset({"outside": ("point", np.zeros(5, int))}, coords, attrs)


def measured():
    """Gives a dataset as of `lyapunov_sweep`: the exponents tell more than the recurrence."""
    ds = attractor_map()
    regime = np.array(
        [["periodic", "periodic", "regular", "chaotic"], ["transient chaos", "chaotic", "periodic", "regular"]]
    )
    ds["kind"][1] = np.array(["unresolved", "unresolved", "period", "unresolved"])
    ds["regime"] = ds["kind"].dims, regime
    ds["exponent"] = (*ds["kind"].dims, "count"), np.where(regime == "chaotic", 0.3, -0.1)[..., None]
    return ds


def test_cases_have_names_and_a_legend_of_the_kinds_that_occur():
    names = motions_of(attractor_map(), "clearance", "speed")
    assert names.tolist() == [
        ["period 1", "period 2", "quasi-periodic", "chaotic"],
        ["other periods", "unresolved", "not trusted", "period 3"],
    ]
    # cases that a store lacks are white
    ds = attractor_map()
    ds["status"][0, 0] = Status.NOT_RUN
    ax = plots.attractor_map(ds)
    assert set(legend(ax)) == {*np.unique(names), "not computed yet"} - {"period 1"}
    assert labels(ax) == ("speed $V$ [m/s]", "clearance $C$ [mm]")
    assert ax.collections[1].get_array().mask.ravel().tolist() == [False] + [True] * 7
    check_legend_fits(plots.attractor_map(attractor_map()))


def test_a_map_of_attractors_agrees_with_the_map_of_exponents():
    ds = measured()
    assert motions_of(ds, "clearance", "speed").tolist() == [
        ["period 1", "period 2", "quasi-periodic", "chaotic"],
        ["transient chaos", "chaotic", "not trusted", "regular"],
    ]
    kinds, exponents = plots.attractor_map(ds), plots.regime_map(ds)
    for ax, color in ((kinds, MOTION_COLORS["not trusted"]), (exponents, COLORS["grey"])):
        mesh = ax.collections[0]
        mesh.update_scalarmappable()
        assert to_hex(mesh.get_facecolors()[6]) == color


def test_curves_lie_over_a_map_of_attractors_and_are_named():
    ax = plots.event_curves([curve(), curve(2)], attractor_map())
    assert legend(ax)[-2:] == ["PD flip", "PD flip of period 2"]
    assert ax.axis() == pytest.approx((0.5, 4.5, 0.5, 2.5))


def test_basins_are_named_by_their_motion_and_share():
    basin = np.array([[0, 0, 1], [0, -1, 2]])
    dims, grid = ("start_v_y", "start_v_z"), {"start_v_y": [0.0, 1.0], "start_v_z": [0.0, 1.0, 2.0]}
    of_each = {"basin_period": ("attractor", [1, 2, 0]), "share": ("attractor", [0.5, 1 / 6, 1 / 6])}
    data = {"basin": (dims, basin), "status": (dims, np.where(basin < 0, 2, 0)), **of_each}
    ax = plots.basin_map(xr.Dataset(data, grid))
    assert legend(ax) == ["period 1: 50%", "period 2: 17%", "no period: 17%", "not trusted"]
    assert labels(ax) == ("start $V_Y$ [m/s]", "start $V_Z$ [m/s]")
    many = {"basin_period": ("attractor", np.ones(9, int)), "share": ("attractor", np.full(9, 0.1))}
    nine = xr.Dataset({"basin": (dims, [[0, 1, 2], [6, 7, 8]]), **many}, grid)
    assert legend(plots.basin_map(nine))[-1] == "3 others: 30%"


# Machado et al. 2009, doi:10.1109/TVCG.2009.113: full deuteranopia and protanopia, on linear RGB
BLIND = {
    "neither": np.eye(3),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}


@pytest.mark.parametrize("blind", BLIND)
def test_colours_of_motions_differ_for_everybody(blind):
    # "periodic" stands for single periods, and white for what is not computed yet
    srgb = np.array([to_rgb(color) for color in dict.fromkeys([*MOTION_COLORS.values(), "#ffffff"])])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = np.clip(linear @ BLIND[blind].T, 0, 1) @ to_xyz.T / [0.9505, 1.0, 1.089]
    x, y, z = np.cbrt(np.maximum(xyz, 1e-9)).T
    lab = np.stack([116 * y, 500 * (x - y), 200 * (y - z)], axis=1)
    away = np.linalg.norm(lab[:, None] - lab[None], axis=-1)[np.triu_indices(len(lab), 1)]
    assert away.min() > 25
