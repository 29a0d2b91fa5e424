"""Pictures of branches, multipliers and curves of events, from datasets made by hand."""

import json

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

from slipperjax import plots
from slipperjax.plots.branches import crossing_threads, joined, stable_parts
from slipperjax.plots.style import COLORS

from .shown import bar_of, check_legend_fits, labels, legend, marked

NAN = float("nan")


def branch(
    values=(1e-3, 2e-3, 3e-3, 2e-3, 1e-3),
    stable=(1, 1, 1, 0, 0),
    labels=("", "", "LP", "", ""),
    velocity=None,
    time=None,
    period=1,
    multipliers=None,
    over="clearance",
):
    """Gives a branch over clearance that folds back at 3 mm; one crossing of velocity 10, 11, ..."""
    points = len(values)
    velocity = 10.0 + np.arange(points)[:, None] if velocity is None else np.array(velocity, float)
    time = np.where(np.isfinite(velocity), 0.3, NAN) if time is None else np.array(time, float)
    if multipliers is None:
        multipliers = np.tile([0.5 + 0.5j, 0.5 - 0.5j, 0.1], (points, 1))
    at = [k for k, label in enumerate(labels) if label]
    data = {name: (("point", "crossing"), velocity) for name in ("v_y", "v_z", "w_x", "w_y", "w_z")}
    data |= {f"{name}_period": (("point", "crossing"), time) for name in list(data)}
    data |= {
        "stable": ("point", np.array(stable, bool)),
        "label": ("point", np.array(labels)),
        "multiplier_real": (("point", "multiplier"), np.real(multipliers)),
        "multiplier_imag": (("point", "multiplier"), np.imag(multipliers)),
        "slowest_touchdown": ("point", np.arange(points) + 0.5, {"units": "m/s"}),
        "strobe": (
            ("point", "strobe_period", "coordinate"),
            1e-3 * np.arange(points)[:, None, None] * np.ones((1, 2)),
        ),
        "event_label": ("event", np.array([labels[k] for k in at], str)),
        "event_point": ("event", np.array(at, int)),
    }
    coords = {over: ("point", np.array(values)), "coordinate": ["y", "v_y"], "strobe_period": [1]}
    attrs = {"varied": json.dumps([over]), "orbit_period": period, "length [m]": 0.2}
    return xr.Dataset(data, coords, attrs)


def simulated(over="clearance"):
    values = np.array([[1.0, 2.0], [3.0, NAN], [4.0, 5.0]])
    data = {name: ((over, "crossing"), values) for name in ("v_y", "v_z")}
    data |= {"status": (over, [0, 0, 1])}
    return xr.Dataset(data, {over: [1e-3, 2e-3, 3e-3]})


def lines(ax, style):
    """Gives the parts of lines of a style, points each."""
    return [part for line in ax.lines if line.get_linestyle() == style for part in _parts(line.get_xydata())]


def _parts(points):
    finite = np.isfinite(np.asarray(points)).all(axis=1)
    cuts = np.flatnonzero(~finite)
    return [part[np.isfinite(part).all(axis=1)].tolist() for part in np.split(points, cuts) if len(part) > 1]


def markers(ax, marker):
    return [line.get_xydata().tolist() for line in marked(ax, marker)]


# lines through points


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


def test_lines_break_where_values_are_not_finite_or_parts_are_left_out():
    values = np.array([[1.0, 2.0, NAN, 4.0, 5.0, 6.0]])
    x, y = joined(np.arange(6.0), values, np.array([True, True, True, True, False]))
    np.testing.assert_array_equal(x, [0, 1, NAN, 3, 4, NAN])
    np.testing.assert_array_equal(y, [1, 2, NAN, 4, 5, NAN])


def test_events_take_the_stability_of_what_is_beside_them():
    # 2 and 4 are events, whose own flags are rounding's
    ds = branch(range(1, 7), stable=(1, 1, 0, 0, 1, 1), labels=("", "", "LP", "", "PD", "EP"))
    assert stable_parts(ds).tolist() == [True, True, False, False, True]


# branches


def test_a_branch_is_drawn_along_itself_with_its_unstable_part_dashed():
    ax = plots.branches(branch())
    np.testing.assert_allclose(lines(ax, "-"), [[[1, 10], [2, 11], [3, 12]]])
    np.testing.assert_allclose(lines(ax, "--"), [[[3, 12], [2, 13], [1, 14]]])
    assert legend(ax) == ["stable", "unstable", "LP fold"]
    assert labels(ax) == ("clearance $C$ [mm]", "$V_Z$ [m/s]")
    assert ax.figure.get_suptitle() == "$L$ = 0.2 m"
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
    one, two = (
        branch(),
        branch(period=2, velocity=[[4.0, 8.0]] * 5, time=[[0.1, 0.6]] * 5, labels=("", "PD", "", "", "")),
    )
    ax = plots.branches([one, two])
    np.testing.assert_allclose(markers(ax, "D"), [[[3, 12]]])
    np.testing.assert_allclose(markers(ax, "^"), [[[2, 4], [2, 8]]])
    assert {line.get_color() for line in ax.lines if line.get_linestyle() == "-"} == {COLORS["blue"], COLORS["red"]}
    assert legend(ax)[:3] == ["period 1, stable", "period 1, unstable", "LP fold"]
    assert legend(ax)[3:] == ["period 2, stable", "period 2, unstable", "PD flip"]
    ax = plots.branches(branch(range(1, 8), (1,) * 7, ("EP", "LP", "BP", "PD", "NS", "GR", "MX")))
    meanings = ["LP fold", "BP branch point", "PD flip", "NS Neimark-Sacker", "GR grazing", "MX no convergence"]
    assert legend(ax)[2:] == meanings
    check_legend_fits(ax)


def test_a_branch_lies_over_dots_of_simulations():
    ax = plots.branches(branch(), "v_y", simulated())
    (dots,) = marked(ax, ".")
    np.testing.assert_allclose(dots.get_xydata(), [[1, 1], [1, 2], [2, 3]])
    assert dots.get_zorder() < min(line.get_zorder() for line in ax.lines if line.get_linestyle() == "-")
    assert legend(ax) == ["from simulation", "status not 0", "stable", "unstable", "LP fold"]
    check_legend_fits(plots.branches([branch(), branch(period=2)], "v_y", simulated()))


# multipliers


def test_multipliers_are_coloured_by_the_parameter():
    own = plt.subplots()[1]
    ax = plots.multiplier_circle(branch(), ax=own)
    assert ax is own
    (dots,) = ax.collections
    assert len(dots.get_offsets()) == 15
    np.testing.assert_allclose(dots.get_array()[:4], [1, 1, 1, 2])
    assert ax.patches[0].get_radius() == 1
    assert bar_of(ax).get_ylabel() == "clearance $C$ [mm]"
    far = branch(multipliers=np.tile([-30.0 + 0j, 3j, 0.5], (5, 1)))
    assert 2.0 < plots.multiplier_circle(far).get_xlim()[1] < 2.5


# curves of events


def curve(label="LP", outside=(0, 0, 0, 1, 1), varied=("speed", "clearance")):
    values = np.arange(1.0, 6), np.arange(1.0, 6) * 1e-3
    coords = {name: ("point", along) for name, along in zip(varied, values, strict=False)}
    attrs = {"label": label, "varied": json.dumps(varied)}
    return xr.Dataset({"outside": ("point", np.array(outside))}, coords, attrs)


def regimes(over=("clearance", "speed")):
    grid = {"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]}
    shape = tuple(len(grid[name]) for name in over)
    exponent = np.array([-0.2, 0.0, 0.3, 0.1, 0.2, -0.1]).reshape(*shape, 1)
    data = {
        "exponent": ((*over, "count"), exponent),
        "stderr": ((*over, "count"), 0.01 + 0 * exponent),
        "regime": (over, np.full(shape, "unresolved")),
        "status": (over, np.zeros(shape, int)),
    }
    return xr.Dataset(data, {name: grid[name] for name in over})


def test_curves_are_dashed_where_the_motion_is_unstable_anyway():
    ax = plots.event_curves([curve(), curve("PD", (0,) * 5)])
    np.testing.assert_allclose(lines(ax, "-")[0], [[1, 1], [2, 2], [3, 3]])
    np.testing.assert_allclose(lines(ax, "--"), [[[3, 3], [4, 4], [5, 5]]])
    assert labels(ax) == ("clearance $C$ [mm]", "speed $V$ [m/s]")
    assert legend(ax) == ["LP fold", "PD flip", "others outside, too"]
    assert len({to_hex(line.get_color()) for line in ax.lines}) == 2


def test_curves_lie_over_a_regime_map_with_its_axes_and_legend():
    ax = plots.event_curves(curve("NS", (0,) * 5), regimes())
    assert labels(ax) == ("speed $V$ [m/s]", "clearance $C$ [mm]")
    np.testing.assert_allclose(lines(ax, "-")[0][:2], [[1, 1], [2, 2]])
    assert ax.axis() == pytest.approx((0.5, 3.5, 0.5, 2.5))
    assert legend(ax) == ["unresolved: estimates\ndisagree or are not sure", "NS Neimark-Sacker"]
    check_legend_fits(ax)


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
        (lambda: plots.event_curves(curve("XY")), "`ds` must be curves of LP, .* but is of XY"),
        (
            lambda: plots.event_curves([curve(), curve(varied=("speed", "mass"))]),
            "over the same two parameters, but is of LP over speed and mass",
        ),
        (
            lambda: plots.event_curves(curve(varied=("speed", "mass")), regimes()),
            "`regimes` must be swept over speed",
        ),
        (lambda: plots.event_curves(curve(), simulated()), "lyapunov_sweep, with `regime`"),
    ],
)
def test_what_cannot_be_drawn_is_named(draw, words):
    with pytest.raises(ValueError, match=words):
        draw()
