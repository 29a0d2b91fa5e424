"""Maps over two parameters: predictions from made curves, agreement with made motions, and a coarse computed map."""

import json

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.studies.dang2024 import agreement, figures, maps
from slipperjax.studies.dang2024.figures import write_figures
from slipperjax.studies.dang2024.runs import MAPS, Finished, Outcome

PLANE = "speed-clearance"
SPEEDS, CLEARANCES = np.linspace(800.0, 2300.0, 16), np.linspace(0.3e-3, 5e-3, 12)


def curve(label, speeds, clearances, outside=0, period=1):
    """A straight curve of 20 points."""
    share = np.linspace(0, 1, 20)
    along = lambda ends: ends[0] + share * (ends[1] - ends[0])
    coords = {"speed": ("point", along(speeds)), "clearance": ("point", along(clearances))}
    data = {"outside": ("point", np.broadcast_to(outside, 20))}
    attrs = {"label": label, "orbit_period": period, "varied": json.dumps(["speed", "clearance"])}
    return xr.Dataset(data, coords, attrs)


CURVES = [
    curve("PD", (1050.0, 1050.0), (0.2e-3, 5.1e-3)),
    curve("NS", (700.0, 2400.0), (4.05e-3, 4.05e-3), np.where(np.arange(20) < 10, 1, 0)),
    curve("LP", (1950.0, 1950.0), (0.2e-3, 5.1e-3)),
    curve("PD", (1500.0, 1500.0), (0.2e-3, 5.1e-3), outside=1),
    curve("PD", (1300.0, 1300.0), (0.2e-3, 5.1e-3), period=2),
    curve("GR", (1400.0, 1400.0), (0.2e-3, 5.1e-3)),
]
NOMINAL = np.array([[1250.0, 1e-3]])


def predicted():
    followed = maps.Followed(CURVES, NOMINAL)
    return maps.predict(PLANE, followed, {"speed": SPEEDS, "clearance": CLEARANCES})


def made_map():
    """Motions as predicted, but for some cases."""
    stable, band = predicted()
    dims = ("speed", "clearance")
    period, kept = stable.astype(int), stable.copy()
    tested, status = np.ones_like(stable), np.zeros(stable.shape, int)
    period[4, 2:5] = 0  # another attractor
    period[5, 5], kept[5, 5] = 0, False  # not explained
    period[14, 1] = 1  # another orbit of period 1
    tested[15], status[0, 0], period[0, 0] = False, 1, 1
    kind = np.where(period == 1, "period", "chaotic")
    data = {
        "kind": kind,
        "period": period,
        "status": status,
        "beside_kind": np.where(kept, "period", "torus"),
        "beside_period": kept.astype(int),
        "beside_status": 0 * status,
        "predicted": stable,
        "beside_curve": band,
        "kept": kept,
        "on_orbit": stable & (period == 1),
        "tested": tested,
    }
    grid = {"speed": SPEEDS, "clearance": CLEARANCES}
    return xr.Dataset({name: (dims, a) for name, a in data.items()}, grid, {"seconds_curves": 12.3})


def test_only_curves_that_end_stability_bound_the_prediction():
    stable, band = predicted()
    speed, clearance = np.meshgrid(SPEEDS, CLEARANCES, indexing="ij")
    # left of the middle another multiplier lies outside along the Neimark-Sacker, so that nothing ends there
    inside = (speed > 1050) & (speed < 1950)
    assert stable[inside & (clearance < 4.05e-3)].all()
    assert not stable[~inside].any()
    # what lies above is one region with what lies below, through the open half of the curve
    assert stable[inside & (clearance > 4.05e-3)].all()
    assert band[np.abs(SPEEDS - 1050) < 100].all()
    assert not band[SPEEDS == 1400][0, :8].any()


def test_a_closed_region_is_predicted():
    whole = maps.Followed([curve("NS", (700.0, 2400.0), (4.05e-3, 4.05e-3)), *CURVES[::2]], NOMINAL)
    stable, _ = maps.predict(PLANE, whole, {"speed": SPEEDS, "clearance": CLEARANCES})
    speed, clearance = np.meshgrid(SPEEDS, CLEARANCES, indexing="ij")
    np.testing.assert_array_equal(stable, (speed > 1050) & (speed < 1950) & (clearance < 4.05e-3))


def test_a_curve_that_stops_near_the_edge_goes_on_to_it():
    """Cells are 0.43 mm high; without the last bit of the curve the region would leak through it."""
    closed = [curve("PD", (1050.0, 1050.0), (0.2e-3, 4.7e-3)), curve("LP", (1950.0, 1950.0), (0.2e-3, 5.1e-3))]
    axes = {"speed": SPEEDS, "clearance": CLEARANCES}
    stable, _ = maps.predict(PLANE, maps.Followed(closed, NOMINAL), axes)
    np.testing.assert_array_equal(
        stable, np.broadcast_to((SPEEDS[:, None] > 1050) & (SPEEDS[:, None] < 1950), (16, 12))
    )
    open_ = [curve("PD", (1050.0, 1050.0), (0.2e-3, 4.4e-3)), closed[1]]
    assert maps.predict(PLANE, maps.Followed(open_, NOMINAL), axes)[0][0].all()


def test_agreement_is_counted_two_ways():
    ds = made_map()
    found = agreement.agreements(ds)
    assert (found["beside"].cells, found["beside"].agreeing) == (15 * 12, 15 * 12 - 1)
    assert (found["one start"].cells, found["one start"].agreeing) == (16 * 12 - 1, 16 * 12 - 1 - 5)
    assert agreement.disagreements(ds) == {"another attractor": 3, "another orbit": 1, "not explained": 1}
    rows = {row["quantity"]: row["value"] for row in agreement.agreement_rows(ds)}
    assert rows["run beside the orbit: agreement"] == "99.4 %"
    assert rows["time: curves"] == "12 s"


def test_events_on_a_found_curve_are_known():
    points = maps.points_of(CURVES[0], PLANE)
    assert maps.distance(points, (1050.0, 1.234e-3), PLANE) < 1e-9
    # in shares of 1500 m/s and 4.5 mm
    assert maps.distance(points, (1200.0, 1e-3), PLANE) == pytest.approx(0.1)
    assert maps.distance(points, (1050.0, 5.1e-3 + 0.45e-3), PLANE) == pytest.approx(0.1)


def test_runs_begin_aside():
    rows = np.zeros((2, 30))
    moved = maps.pushed(rows)
    np.testing.assert_allclose(np.abs(moved[0, :10]), [1e-5, 1e-5, 5e-5, 5e-5, 5e-5, 1e-2, 1e-2, 0.1, 0.1, 0.1])
    assert not moved[:, 10:].any()
    assert not rows.any()


def test_maps_are_drawn_with_their_table(tmp_path):
    data = {PLANE: made_map()} | {f"{PLANE}_curve_{k}": one for k, one in enumerate(CURVES)}
    written = write_figures(Finished("map", (PLANE,), Outcome(data, {}), 1.0), tmp_path)
    assert {path.name for path in written} >= {f"{PLANE}.nc", f"{PLANE}.png", f"{PLANE}.md"}
    assert "| run beside the orbit: agreement | 99.4 % |" in (tmp_path / f"{PLANE}.md").read_text()
    figure = figures._DRAW[PLANE](data)
    assert [ax.get_title() for ax in figure.axes] == ["from Table 2's start", figures.BESIDE]
    assert figure.axes[0].get_xlabel() == "speed $V$ [m/s]"
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"PD flip", "NS Neimark-Sacker", "period 1", "chaotic", figures.UNTESTED} <= set(texts)
    plt.close(figure)
    assert set(MAPS) <= set(figures._DRAW)


@pytest.mark.slow
def test_a_coarse_map_agrees_with_its_curves(monkeypatch):
    """Around the flip at 1096 m/s, which the nominal orbits pass between 0.5 and 2 mm."""
    monkeypatch.setattr(maps, "AREA", {"speed": (1000.0, 1300.0), "clearance": (0.5e-3, 2e-3)})
    monkeypatch.setattr(maps, "LINES", {PLANE: ()})
    monkeypatch.setattr(maps, "STEPS", 100)
    effort = maps.COARSE._replace(first=8, second=6)
    data = {}
    ds = maps.map_plane(PLANE, effort, data, {})
    curves = [one for key, one in data.items() if "_curve_" in key]
    assert [one.attrs["label"] for one in curves] == ["PD", "GR"]
    assert not curves[0]["outside"].any()
    speeds = np.interp(ds["clearance"], *(np.sort(curves[0][name].values) for name in ("clearance", "speed")))
    np.testing.assert_array_equal(ds["predicted"], ds["speed"].values[:, None] > speeds)
    found = agreement.agreements(ds)
    assert found["beside"].percent_away >= 95  # measured: 100 %
    at = ds.sel(speed=1250.0, clearance=1e-3, method="nearest")
    assert bool(at["predicted"])
    assert bool(at["kept"])
    # the orbits are those that single searches find
    one = data[f"{PLANE}_orbits"].sel(speed=1250.0, clearance=1e-3, method="nearest")
    scene = sj.paper_scene(float(one["speed"]), float(one["clearance"]))
    alone = sj.periodic_orbit(scene, steps_per_period=maps.SIMULATED)
    np.testing.assert_allclose(one["state"].values[5], float(alone.state.motion.v_y), atol=1e-8)
