"""Maps of attractors, basins and any quantity, also beneath curves and while a store grows."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex, to_rgb
from PIL import Image

import slipperjax as sj
from slipperjax import plots
from slipperjax.flow.status import Status
from slipperjax.model.parameters import PARAMETERS
from slipperjax.plots import style
from slipperjax.plots.maps import motions_of
from slipperjax.plots.style import COLORS, MOTION_COLORS, UNITS

from .shown import bar_of, check_legend_fits, labels, legend, marked

OVER = ("clearance", "speed")


def attractor_map():
    kind = np.array([["period", "period", "torus", "chaotic"], ["period", "unresolved", "period", "period"]])
    period = np.array([[1, 2, 0, 0], [12, 0, 1, 3]])
    status = np.zeros((2, 4), int)
    status[1, 2] = 3
    grid = {"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0, 4.0]}
    return xr.Dataset({"kind": (OVER, kind), "period": (OVER, period), "status": (OVER, status)}, grid)


def curve(period=1):
    coords = {"speed": ("point", np.arange(1.0, 6)), "clearance": ("point", np.linspace(1e-3, 2e-3, 5))}
    attrs = {"label": "PD", "varied": json.dumps(["speed", "clearance"]), "orbit_period": period}
    return xr.Dataset({"outside": ("point", np.zeros(5, int))}, coords, attrs)


def test_cases_have_names_and_a_legend_of_the_kinds_that_occur():
    names = motions_of(attractor_map(), *OVER)
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


def test_exponents_tell_more_than_recurrence_and_colours_of_flagged_cases_agree():
    ds = attractor_map()
    regime = [["periodic", "periodic", "regular", "chaotic"], ["transient chaos", "chaotic", "periodic", "regular"]]
    ds["kind"][1] = np.array(["unresolved", "unresolved", "period", "unresolved"])
    ds = ds.assign(regime=(OVER, regime), exponent=((*OVER, "count"), np.full((2, 4, 1), 0.3)))
    assert motions_of(ds, *OVER).tolist() == [
        ["period 1", "period 2", "quasi-periodic", "chaotic"],
        ["transient chaos", "chaotic", "not trusted", "regular"],
    ]
    for ax, color in (
        (plots.attractor_map(ds), MOTION_COLORS["not trusted"]),
        (plots.regime_map(ds), COLORS["grey"]),
    ):
        mesh = ax.collections[0]
        mesh.update_scalarmappable()
        assert to_hex(mesh.get_facecolors()[6]) == color


def test_curves_lie_over_a_map_of_attractors_and_are_named():
    ax = plots.plane([curve(), curve(2)], attractor_map())
    assert legend(ax)[-2:] == ["PD flip", "PD flip of period 2"]
    assert ax.axis() == pytest.approx((0.5, 4.5, 0.5, 2.5))


def test_basins_are_named_by_their_motion_and_share():
    basin = np.array([[0, 0, 1], [0, -1, 2]])
    dims, grid = ("start_v_y", "start_v_z"), {"start_v_y": [0.0, 1.0], "start_v_z": [0.0, 1.0, 2.0]}
    of_each = {"basin_period": ("attractor", [1, 2, 0]), "share": ("attractor", [0.5, 1 / 6, 1 / 6])}
    data = {"basin": (dims, basin), "status": (dims, np.where(basin < 0, 2, 0)), **of_each}
    ax = plots.basin_map(xr.Dataset(data, grid))
    assert legend(ax) == ["0: period 1, 50%", "1: period 2, 17%", "2: no period, 17%", "not trusted"]
    assert labels(ax) == ("start $V_Y$ [m/s]", "start $V_Z$ [m/s]")
    many = {"basin_period": ("attractor", np.ones(9, int)), "share": ("attractor", np.full(9, 0.1))}
    nine = xr.Dataset({"basin": (dims, [[0, 1, 2], [6, 7, 8]]), **many}, grid)
    assert legend(plots.basin_map(nine))[-1] == "3 others: 30%"


def swept(dims=OVER, sizes=(3, 4)):
    """Gives peak forces [N] at two points, the second larger; one case is flagged and one is not there yet."""
    values = {"clearance": np.linspace(1e-3, 2e-3, sizes[0]), "speed": np.linspace(1000.0, 1300.0, sizes[-1])}
    force = 1e3 * (1 + np.arange(np.prod(sizes), dtype=float).reshape(sizes))
    status = np.zeros(sizes, int)
    status.flat[1], status.flat[2] = Status.DERAILED, Status.NOT_RUN
    force.flat[2] = np.nan
    both = np.stack([0.5 * force, force], axis=-1)
    coords = {name: (name, values[name], PARAMETERS[name].attributes) for name in dims}
    data = {"peak_force": ((*dims, "point"), both), "status": (dims, status)}
    return xr.Dataset(data | {"kind": (dims, np.full(sizes, "period"))}, coords, {"varied": json.dumps(list(dims))})


def test_the_largest_value_is_drawn_in_its_display_unit():
    turned = swept()["peak_force"].transpose("point", "speed", "clearance")
    for ds in (swept(), swept().assign(peak_force=turned)):  # dimensions may come in any order
        ax = plots.quantity_map(ds)
        drawn = ax.collections[0].get_array()
        assert drawn.shape == (3, 4)
        assert drawn[0, 0] == 1.0  # kN, of the second point
        assert drawn.mask.ravel()[:4].tolist() == [False, True, True, False]
        assert ax.get_xlabel() == "speed $V$ [m/s]"
        assert bar_of(ax).get_ylabel() == r"peak force $F_{\mathrm{max}}$ [kN]"
        assert len(legend(ax)) == 2  # the flagged case, grey, and what is not there


def test_a_sweep_is_drawn_and_written_in_units_of_one_s_choice(tmp_path, monkeypatch):
    ds = swept(("speed",), (5,)).assign_attrs(call='{"function": "sweep"}')
    result = sj.Result(ds)
    ax = result.plot(units=["ft", "lbf"])
    assert labels(ax) == ("speed $V$ [ft/s]", r"$F_{\mathrm{max}}$ [lbf]")
    (dots,) = marked(ax, ".")
    # 1 kN is 224.8089 lbf, 1 ft is 0.3048 m
    np.testing.assert_allclose(
        dots.get_xydata()[[0, 4]], [[1000 / 0.3048, 224.8089], [1300 / 0.3048, 1124.045]], rtol=1e-6
    )
    # without a choice the units are those of the scene's file, and otherwise those of the quantities
    of_file = sj.Result(ds.assign_attrs({UNITS: '["ft"]'}))
    assert labels(of_file.plot()) == ("speed $V$ [ft/s]", r"$F_{\mathrm{max}}$ [kN]")
    assert labels(of_file.plot(units=[])) == ("speed $V$ [m/s]", r"$F_{\mathrm{max}}$ [kN]")
    written = []
    keep = style.png
    monkeypatch.setattr(style, "png", lambda figure, dpi: written.append(labels(figure.axes[0])) or keep(figure, dpi))
    result.write(tmp_path / "sweep.png", units=["ft", "lbf"])
    assert written == [labels(ax)]
    # 300 dpi where a text spreads it over 16 cm, of which its own width, 3.5 inches, is a part
    with Image.open(tmp_path / "sweep.png") as image:
        assert image.width == 1890
        assert image.width / image.info["dpi"][0] == pytest.approx(3.5, rel=1e-3)
    with pytest.raises(ValueError, match="`units` must be units of"):
        result.write(tmp_path / "sweep.png", units=["furlong per"])


def test_one_parameter_is_a_row_of_dots():
    ax = plots.quantity_map(swept(("speed",), (5,)))
    (dots,), (crosses,) = marked(ax, "."), marked(ax, "x")
    np.testing.assert_array_equal(dots.get_ydata(), [1.0, np.nan, np.nan, 4.0, 5.0])
    assert crosses.get_xdata().tolist() == [1075.0]  # the flagged one; what is missing has no mark


@pytest.mark.parametrize(
    ("ds", "name", "words"),
    [
        (swept(), "kind", "with numbers, but kind"),
        (swept(), "penetration", "`penetration`"),
        (swept().expand_dims(mass=[1.0, 2.0]), "peak_force", "over one parameter or two"),
    ],
)
def test_what_cannot_be_drawn_is_named(ds, name, words):
    with pytest.raises(ValueError, match=words):
        plots.quantity_map(ds, name)


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
