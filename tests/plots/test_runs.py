"""The page of a run, from a dataset made by hand."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.patches import StepPatch

import slipperjax as sj
from slipperjax import plots
from slipperjax.flow.datasets import run_attributes
from slipperjax.plots.runs import peak_of

from .shown import check_legend_fits, drawn, legend, marked

BEGIN, WINDOWS, ENDS = 100.0, 250, [200.0, 300.0, 350.0]
"""Where the run begins [m], how many windows of 1 m it has, and the ends of its stretches [m]."""


def made(status=0, bands=True, scene=None):
    """Gives a run at 100 m/s, in which the force of point C at the rear is 5 kN at 222.5 m, and others are 1 kN."""
    over = ("distance", "end", "point")
    force, place = np.full((WINDOWS, 2, 3), 1e3), np.full((WINDOWS, 2, 3), 222.0)
    force[122, 1, 2], place[122, 1, 2] = 5e3, 222.5
    ends = BEGIN + 1.0 + np.arange(WINDOWS)
    band = np.full((3, 4), np.nan)
    if bands:
        band[:, 1:3] = [[1.0, 2.0], [3.0, 40.0], [np.nan, 6.0]]
    data = {
        "peak_force": (over, force),
        "peak_distance": (over, place),
        "peak_force_percentile": (("stretch", "percentile"), 1e3 * np.arange(9.0).reshape(3, 3)),
        "impact_rate": (("stretch", "end", "point"), np.arange(18.0).reshape(3, 2, 3)),
        "band_a_z": (("stretch", "band"), band),
        "status": ((), status),
    }
    coords = {"distance": ends, "stretch": ENDS, "band": [31.6, 39.8, 50.1, 63.1], "percentile": [50.0, 90.0, 99.0]}
    coords |= {"end": ["front", "rear"], "point": ["A", "B", "C"], "speed": ("distance", np.full(WINDOWS, 100.0))}
    coords["seconds"] = ("distance", (ends - BEGIN) / 100, {"units": "s"})
    attrs = {} if scene is None else run_attributes(scene, sj.Motion(), {"function": "run"})
    return xr.Dataset(data, coords, attrs | {"window [m]": 1.0, "speed [m/s]": 100.0})


def heights(ax):
    """Gives numbers and edges of each line of steps."""
    return [patch.get_data()[:2] for patch in ax.patches if isinstance(patch, StepPatch)]


def times(ax):
    """Gives the line of time in the panel of speeds."""
    (line,) = next(other for other in ax.figure.axes if other.get_ylabel() == "time [s]").lines
    return drawn(line)


def test_a_run_is_drawn_over_one_distance():
    axes = plots.run_overview(made(), sj.paper_scene())
    lateral, _, speed, force, impacts, spectra = axes
    assert [ax.get_xlim() for ax in axes] == [(100.0, 350.0)] * 6
    assert spectra.get_xlabel() == "distance [m]"
    assert np.ptp(drawn(lateral.lines[0])[:, 1]) == pytest.approx(2.0, rel=1e-3)  # of 1 mm amplitude
    assert drawn(speed.lines[0])[[0, -1]].tolist() == [[100.0, 100.0], [350.0, 100.0]]
    assert legend(speed) == ["speed", "time"]
    assert times(speed)[[0, -1]] == pytest.approx(np.array([[100.0, 0.0], [350.0, 2.5]]))
    (highest, edges), *percentiles = heights(force)
    assert (len(highest), edges[0], edges[-1]) == (WINDOWS, 100.0, 350.0)
    assert (highest[122], np.sum(highest == 1.0)) == (5.0, WINDOWS - 1)
    assert [values.tolist() for values, _ in percentiles] == [[0, 3, 6], [1, 4, 7], [2, 5, 8]]
    assert drawn(marked(force, "o")[0]).tolist() == [[222.5, 5.0]]
    assert legend(force)[-1] == "5 kN: C2, 222.5 m"
    assert [values.tolist() for values, _ in heights(impacts)] == [[3, 21, 39], [12, 30, 48]]
    (mesh,) = spectra.collections
    np.testing.assert_array_equal(mesh.get_array(), np.ma.masked_invalid([[1, 3, np.nan], [2, 40, 6]]))
    assert spectra.get_ylim() == pytest.approx((39.8 / 10**0.05, 50.1 * 10**0.05))
    check_legend_fits(force)


def test_a_run_is_drawn_in_a_user_s_units():
    """Feet are for distances along the rail, and inches for its displacements."""
    units = ["ft", "in", "lbf", "mph", "g"]
    lateral, _, speed, force, _, spectra = plots.run_overview(made(), sj.paper_scene(), units)
    assert lateral.get_xlim() == pytest.approx((100 / 0.3048, 350 / 0.3048))
    assert lateral.get_ylabel() == "lateral\n[in]"
    assert np.ptp(drawn(lateral.lines[0])[:, 1]) == pytest.approx(2.0 / 25.4, rel=1e-3)
    assert drawn(speed.lines[0])[0] == pytest.approx([100 / 0.3048, 100 / 0.44704])
    assert heights(force)[0][0][122] == pytest.approx(5e3 / 4.4482216)
    assert legend(force)[-1] == "1124 lbf: C2, 729.99 ft"
    assert np.nanmax(spectra.collections[0].get_array()) == pytest.approx(40 / 9.80665)


def test_windows_with_a_status_are_shaded_and_lost_ones_are_not_drawn():
    codes = np.zeros(WINDOWS, int)
    codes[50:60], codes[122] = sj.Status.TOO_FEW_STEPS, sj.Status.DERAILED
    codes[200:] = sj.Status.INACCURATE
    force = plots.run_overview(made(6).assign(window_status=("distance", codes)))[1]
    highest, _ = heights(force)[0]
    assert np.isnan(highest).tolist() == ((codes == 3) | (codes == 2)).tolist()
    # the highest force was in a lost window, and stretches with such have no numbers
    assert legend(force)[-2:] == ["1 kN: A1, 222 m", "not trusted"]
    assert np.isnan(heights(force)[1][0]).tolist() == [True, True, False]
    # the title alone tells a status of the whole run, of which nothing is drawn but the speed
    speed, force, impacts, _ = plots.run_overview(made(status=2))
    assert len(drawn(speed.lines[0]))
    assert all(np.isnan(values).all() for ax in (force, impacts) for values, _ in heights(ax))
    assert not marked(force, "o")
    assert "status: derailed" in speed.figure.get_suptitle()


@pytest.mark.parametrize(
    ("part", "stretches", "peak"),
    [(slice(120, 130), [1], "5 kN: C2, 222.5 m"), (slice(90, 110), [0, 1], "1 kN: A1, 222 m")],
)
def test_a_part_of_a_run_shows_its_own_numbers(part, stretches, peak):
    speed, force, impacts, _ = plots.run_overview(made().isel(distance=part))
    assert legend(force)[-1] == peak
    for steps in (heights(force)[1], heights(impacts)[0]):
        assert steps[1].tolist() == [BEGIN + part.start, *(ENDS[k] for k in stretches)]
    assert heights(force)[1][0].tolist() == [3.0 * k for k in stretches]
    assert times(speed)[[0, -1], 1] == pytest.approx([part.start / 100, part.stop / 100])


def test_what_a_run_lacks_is_left_out():
    axes = plots.run_overview(made().drop_vars(["band_a_z", "impact_rate"]))
    assert [ax.get_ylabel() for ax in axes] == ["speed $V$ [m/s]", "highest single\ncontact point [kN]"]
    assert not len(plots.run_overview(made(bands=False))[-1].collections)
    assert peak_of(made().drop_vars("peak_distance"))["peak_distance"] == 223.0
    lost = made().assign(peak_force=np.nan * made()["peak_force"])
    assert not marked(plots.run_overview(lost)[1], "o")
    assert np.isnan(peak_of(lost)["peak_force"])


def climbed(*, rate=50.0, **data):
    """A run that rises from 100 to 200 m/s by the rate [m/s^2], stays there and falls again, in windows of 1 m."""
    change = int((200.0**2 - 100.0**2) / (2 * rate))
    square = np.concatenate([100.0**2 + 2 * rate * (np.arange(change) + 0.5), np.full(40, 200.0**2)])
    speed = np.sqrt(np.concatenate([square, square[change - 1 :: -1]]))
    force = np.stack([np.full(len(speed), 100.0), 10 * speed], axis=-1)[:, None]
    data = {"peak_force": (("distance", "end", "point"), force), "status": ((), 0)} | data
    coords = {"distance": 1.0 + np.arange(len(speed)), "speed": ("distance", speed), "point": ["A", "B"]}
    return xr.Dataset(data, coords, {"window [m]": 1.0, "clearance [m]": 1e-3})


def test_windows_are_drawn_over_their_speed_by_the_way_it_goes():
    ax = plots.passing(climbed())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("speed $V$ [m/s]", "$F_{\\mathrm{max}}$ [kN]")
    assert legend(ax) == ["up, 50 m/s$^{2}$", "down, 50 m/s$^{2}$"]
    for way, sign in zip(map(drawn, ax.lines), (1, -1), strict=True):
        # all windows but those at a constant speed, at the highest force of all points
        assert 300 <= len(way) <= 301
        assert np.all(sign * np.diff(way[:, 0]) >= 0)
        np.testing.assert_allclose(way[:, 1], 1e-2 * way[:, 0])
    ax = plots.passing(climbed(rms_a_z=("distance", np.ones(640), {"units": "m/s^2"})), quantity="rms_a_z")
    assert (ax.get_ylabel(), drawn(ax.lines[0])[0, 1]) == ("rms a z [m/s$^{2}$]", 1.0)
    # windows of a lost run have no numbers
    lost = climbed(status=((), 7), window_status=("distance", np.zeros(640, int)))
    assert np.isnan(drawn(plots.passing(lost).lines[0])[:, 1]).all()


def test_several_runs_pass_over_branches_and_constant_speeds():
    held = {"peak_force": (("direction", "speed", "point"), np.arange(12e3, step=1e3).reshape(2, 3, 2))}
    held |= {"status": (("direction", "speed"), [[0, 0, 2], [0, 0, 0]])}
    held = xr.Dataset(held, {"speed": [100.0, 150.0, 200.0]})
    points = {"peak_force": ("point", [1e3, 2e3, 3e3]), "stable": ("point", [True, True, False])}
    points |= {"label": ("point", ["EP", "LP", "EP"])}
    points = xr.Dataset(points, {"speed": ("point", [100.0, 200.0, 150.0])})
    ax = plots.passing([climbed(), climbed(rate=500.0)], points, held)
    rates = [f"{way}, {rate} m/s$^{{2}}$" for rate in (50, 500) for way in ("up", "down")]
    assert legend(ax) == ["constant speed", *rates, "stable orbit", "unstable orbit"]
    dots, *_, stable, unstable = map(drawn, ax.lines)
    # the highest of both points; a case with a status has none
    assert sorted(map(tuple, dots[np.isfinite(dots[:, 1])])) == [
        *((100.0, 1.0), (100.0, 7.0), (150.0, 3.0), (150.0, 9.0), (200.0, 11.0))
    ]
    assert stable[:2].tolist() == [[100.0, 1.0], [200.0, 2.0]]
    assert unstable[:2].tolist() == [[200.0, 2.0], [150.0, 3.0]]


STRETCHES, BRANCH = climbed(rms_a_z=("stretch", [1.0])), xr.Dataset({"stable": ("point", [True])})


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (
            lambda: plots.run_overview(made().assign(status=("track.seed", [0, 0]))),
            r"`ds` must be of one run, .*, but is over track\.seed",
        ),
        (lambda: plots.run_overview(made().drop_vars("seconds")), "`ds` must be a dataset of one run, such as"),
        (
            lambda: plots.passing([STRETCHES], quantity="rms_a_z"),
            "runs with `rms_a_z` of each window, .* over stretch",
        ),
        (
            lambda: plots.passing([climbed()], quantity="rms_a_z"),
            "`runs` must be a dataset of one run, .* with `rms_",
        ),
        (lambda: plots.passing([climbed()], BRANCH), "`branch` must be .* continue_orbit .* with `peak_force`"),
    ],
)
def test_what_cannot_be_drawn_is_named(draw, words):
    with pytest.raises(ValueError, match=words):
        draw()
