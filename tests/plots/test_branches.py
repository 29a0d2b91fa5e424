"""Pictures of branches, multipliers and curves of events, from datasets made by hand."""

import json

import numpy as np
import pytest
import xarray as xr

from slipperjax import plots
from slipperjax.plots.branches import crossing_threads, stable_parts

from .shown import bar_of, check_legend_fits, labels, legend, marked

NAN = float("nan")


def branch(
    values=(1e-3, 2e-3, 3e-3, 2e-3, 1e-3),
    stable=(1, 1, 1, 0, 0),
    labels=("", "", "LP", "", ""),
    velocity=None,
    time=None,
    period=1,
    over="clearance",
):
    """Gives a branch over clearance that folds back at 3 mm; one crossing of velocity 10, 11, ..."""
    points = len(values)
    velocity = 10.0 + np.arange(points)[:, None] if velocity is None else np.array(velocity, float)
    time = np.where(np.isfinite(velocity), 0.3, NAN) if time is None else np.array(time, float)
    at = [k for k, label in enumerate(labels) if label]
    start = 1e-3 * np.arange(points)[:, None, None] * np.ones((1, 2))
    data = {name: (("point", "crossing"), velocity) for name in ("v_y", "v_z", "w_x", "w_y", "w_z")}
    data |= {f"{name}_period": (("point", "crossing"), time) for name in list(data)}
    data |= {
        "stable": ("point", np.array(stable, bool)),
        "label": ("point", np.array(labels)),
        "multiplier_real": (("point", "multiplier"), np.tile([0.5, 0.5, 0.1], (points, 1))),
        "multiplier_imag": (("point", "multiplier"), np.tile([0.5, -0.5, 0.0], (points, 1))),
        "slowest_touchdown": ("point", np.arange(points) + 0.5, {"units": "m/s"}),
        "strobe": (("point", "strobe_period", "coordinate"), start),
        "event_label": ("event", np.array([labels[k] for k in at], str)),
        "event_point": ("event", np.array(at, int)),
    }
    coords = {over: ("point", np.array(values)), "coordinate": ["y", "v_y"], "strobe_period": [1]}
    return xr.Dataset(data, coords, {"varied": json.dumps([over]), "orbit_period": period, "length [m]": 0.2})


def simulated(over="clearance"):
    values = np.array([[1.0, 2.0], [3.0, NAN], [4.0, 5.0]])
    data = {name: ((over, "crossing"), values) for name in ("v_y", "v_z")}
    return xr.Dataset(data | {"status": (over, [0, 0, 1])}, {over: [1e-3, 2e-3, 3e-3]})


def lines(ax, style):
    """Gives the unbroken parts of lines of a style, points each."""
    found = []
    for line in ax.lines:
        points = np.asarray(line.get_xydata())
        finite = np.isfinite(points).all(axis=1)
        if line.get_linestyle() == style:
            parts = np.split(np.arange(len(points)), np.flatnonzero(~finite))
            found += [points[part[finite[part]]].tolist() for part in parts if len(part) > 1]
    return found


@pytest.mark.parametrize(
    ("velocity", "time", "period", "threads"),
    [
        # whatever their order
        (
            [[3.0, 9.0], [9.1, 3.1], [3.2, 9.2]],
            [[0.1, 0.6], [0.61, 0.11], [0.12, 0.62]],
            1,
            [(0, [3.0, 3.1, 3.2]), (0, [9.0, 9.1, 9.2])],
        ),
        # one that passes the start of the period
        ([[3.0, 9.0], [9.1, 3.1]], [[0.02, 1.0], [1.02, 1.98]], 2, [(0, [3.0, 3.1]), (0, [9.0, 9.1])]),
        # lines end where crossings do
        (
            [[5.0, NAN], [5.1, 1.0], [5.2, 1.5], [1.7, NAN]],
            [[0.5, NAN], [0.5, 0.8], [0.51, 0.82], [0.83, NAN]],
            1,
            [(0, [5.0, 5.1, 5.2]), (1, [1.0, 1.5, 1.7])],
        ),
        # none crosses a jump
        ([[5.0], [5.1]], [[0.2], [0.4]], 1, [(0, [5.0]), (1, [5.1])]),
        (np.full((3, 2), NAN), np.full((3, 2), NAN), 1, []),
    ],
)
def test_crossings_follow_one_another(velocity, time, period, threads):
    expected = np.full((len(threads), len(velocity)), NAN)
    for line, (first, values) in zip(expected, threads, strict=True):
        line[first : first + len(values)] = values
    np.testing.assert_array_equal(crossing_threads(np.array(velocity), np.array(time), period), expected)


def test_events_take_the_stability_of_what_is_beside_them():
    # 2 and 4 are events, whose own flags are rounding's
    ds = branch(range(1, 7), stable=(1, 1, 0, 0, 1, 1), labels=("", "", "LP", "", "PD", "EP"))
    assert stable_parts(ds).tolist() == [True, True, False, False, True]


def test_a_branch_is_drawn_along_itself_with_its_unstable_part_dashed():
    ax = plots.branches(branch())
    np.testing.assert_allclose(lines(ax, "-"), [[[1, 10], [2, 11], [3, 12]]])
    np.testing.assert_allclose(lines(ax, "--"), [[[3, 12], [2, 13], [1, 14]]])
    assert legend(ax) == ["stable", "unstable", "LP fold"]
    assert labels(ax) == ("clearance $C$ [mm]", "$V_Z$ [m/s]")
    # the state at the start of the period, and other variables
    ax = plots.branches(branch(), "start_y")
    np.testing.assert_allclose(lines(ax, "-"), [[[1, 0], [2, 1], [3, 2]]])
    assert ax.get_ylabel() == "start $y$ [mm]"
    ax = plots.branches(branch(), "slowest_touchdown")
    assert lines(ax, "--")[0][-1] == pytest.approx([1.0, 4.5])
    assert ax.get_ylabel() == "slowest touchdown [m/s]"
    # of one point, or without crossings, no line is drawn
    for none in (branch((1e-3,), (1,), ("",)), branch(velocity=np.full((5, 1), NAN))):
        assert lines(plots.branches(none), "-") == []


def test_events_are_marked_at_each_crossing_and_explained():
    flips = dict(labels=("", "PD", "", "", ""), velocity=[[4.0, 8.0]] * 5, time=[[0.1, 0.6]] * 5)
    ax = plots.branches([branch(), branch(period=2, **flips)])
    (fold,), (flip,) = marked(ax, "D"), marked(ax, "^")
    np.testing.assert_allclose(fold.get_xydata(), [[3, 12]])
    np.testing.assert_allclose(flip.get_xydata(), [[2, 4], [2, 8]])
    of_each = [[f"period {period}, stable", f"period {period}, unstable"] for period in (1, 2)]
    assert legend(ax) == [*of_each[0], "LP fold", *of_each[1], "PD flip"]
    ax = plots.branches(branch(range(1, 8), (1,) * 7, ("EP", "LP", "BP", "PD", "NS", "GR", "MX")))
    meanings = ["LP fold", "BP branch point", "PD flip", "NS Neimark-Sacker", "GR grazing", "MX no convergence"]
    assert legend(ax)[2:] == meanings
    check_legend_fits(ax)


def test_a_crowd_of_events_is_drawn_a_second_time_enlarged():
    values = np.array([0.0, 5.0, 5.1, 5.2, 5.3, 10.0])
    ax = plots.branches(branch(values, (1,) * 6, ("LP", "LP", "PD", "LP", "PD", ""), over="speed"))
    (inset,) = ax.child_axes
    low, high = inset.get_xlim()
    assert 4.5 < low < 5.0 < 5.3 < high < 5.8
    assert not plots.branches(branch()).child_axes


def test_a_branch_lies_over_dots_of_simulations():
    ax = plots.branches(branch(), "v_y", simulated())
    (dots,) = marked(ax, ".")
    np.testing.assert_allclose(dots.get_xydata(), [[1, 1], [1, 2], [2, 3]])
    assert dots.get_zorder() < min(line.get_zorder() for line in ax.lines if line.get_linestyle() == "-")
    assert legend(ax) == ["from simulation", "not trusted", "stable", "unstable", "LP fold"]


def test_multipliers_are_coloured_by_the_parameter():
    ax = plots.multiplier_circle(branch())
    (dots,) = ax.collections
    assert len(dots.get_offsets()) == 15
    np.testing.assert_allclose(dots.get_array()[:4], [1, 1, 1, 2])
    assert bar_of(ax).get_ylabel() == "clearance $C$ [mm]"


def curve(label="LP", outside=(0, 0, 0, 1, 1), varied=("speed", "clearance")):
    values = np.arange(1.0, 6), np.arange(1.0, 6) * 1e-3
    coords = {name: ("point", along) for name, along in zip(varied, values, strict=False)}
    attrs = {"label": label, "varied": json.dumps(varied)}
    return xr.Dataset({"outside": ("point", np.array(outside))}, coords, attrs)


def regimes():
    over, grid = ("clearance", "speed"), {"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]}
    data = {name: ((*over, "count"), np.full((2, 3, 1), 0.1)) for name in ("exponent", "stderr")}
    data |= {"regime": (over, np.full((2, 3), "unresolved")), "status": (over, np.zeros((2, 3), int))}
    return xr.Dataset(data, grid)


def test_curves_are_dashed_where_the_motion_is_unstable_anyway():
    ax = plots.plane([curve(), curve("PD", (0,) * 5)])
    np.testing.assert_allclose(lines(ax, "-")[0], [[1, 1], [2, 2], [3, 3]])
    np.testing.assert_allclose(lines(ax, "--"), [[[3, 3], [4, 4], [5, 5]]])
    assert labels(ax) == ("clearance $C$ [mm]", "speed $V$ [m/s]")
    assert legend(ax) == ["LP fold", "PD flip", "others outside, too"]
    # over a map with its axes and legend
    ax = plots.plane(curve("NS", (0,) * 5), regimes())
    assert labels(ax) == ("speed $V$ [m/s]", "clearance $C$ [mm]")
    np.testing.assert_allclose(lines(ax, "-")[0][:2], [[1, 1], [2, 2]])
    assert ax.axis() == pytest.approx((0.5, 3.5, 0.5, 2.5))
    assert legend(ax)[-1] == "NS Neimark-Sacker"


def test_points_of_several_kinds_at_one_place_have_one_text():
    points = {"event_label": ("event", ["GRPD", "GRLP", "EP"]), "event_point": ("event", [2, 2, 4])}
    ax = plots.plane([curve("GR", (0,) * 5).assign(points), curve("LP", (0,) * 5)])
    assert [text.get_text() for text in ax.texts] == ["GRLP, GRPD"]
    assert ax.texts[0].xy == pytest.approx((3, 3))


OTHER = curve(varied=("speed", "mass"))


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda: plots.branches(simulated()), "with `stable`, but has"),
        (lambda: plots.branches([branch(), branch(over="speed")]), "are over ..clearance., .speed"),
        (lambda: plots.branches(branch(), "foo"), "`quantity` must be one of v_y, .* but is 'foo'"),
        (lambda: plots.branches(branch(), "v_z", simulated("speed")), "`brute` must be swept over clearance"),
        (lambda: plots.branches(branch(), "w_x", simulated()), "`brute` must be .* with `w_x`"),
        (lambda: plots.branches(branch(), "slowest_touchdown", simulated()), "`brute` must be None where"),
        (lambda: plots.multiplier_circle([branch()] * 2), "`ds` must be a dataset of continue_orbit, but is list"),
        (lambda: plots.plane(curve("XY")), "`curves` must be curves of LP, .* but is of XY"),
        (lambda: plots.plane([curve(), OTHER]), "over the same two parameters, but is of LP over speed and"),
        (lambda: plots.plane(OTHER, regimes()), "`attractors` must be swept over speed"),
        (lambda: plots.plane(curve(), simulated()), "lyapunov_sweep, with `regime`"),
    ],
)
def test_what_cannot_be_drawn_is_named(draw, words):
    with pytest.raises(ValueError, match=words):
        draw()
