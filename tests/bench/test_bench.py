"""Error against cost: the arithmetic on made points, the rounds of a measurement, and small real runs."""

import math

import matplotlib.image
import matplotlib.pyplot as plt
import numpy as np
import pytest

from slipperjax import paper_scene, table_2_start
from slipperjax.model.quantities import COORDINATES
from slipperjax.sweeps.sweep import sweep

from ..common import SCALES
from . import measure as measuring
from .measure import bench, cost_of, errors
from .methods import METHODS, Case, all_cases
from .work_precision import SHOWN, Point, cost_at, draw, mbdyn_points, write


def point(method, error, cost, case="nominal", lanes=241):
    return Point(case, method, "n steps", error, {lanes: (cost, 2 * cost)})


def method_named(name):
    return next(m for m in METHODS if m.name == name)


def test_cost_at_an_error_is_interpolated_in_logarithms():
    points = [point("a", 1e-2, 10.0), point("a", 1e-4, 40.0), point("a", math.inf, 1.0)]
    assert cost_at(points, 1e-3, 241) == pytest.approx(20.0)
    assert cost_at(points, 1e-1, 241) == pytest.approx(10.0)
    assert cost_at(points, 1e-5, 241) == math.inf
    assert cost_at(points, 1e-3, 1) == math.inf


def test_errors_are_those_of_each_case_and_infinite_where_not_finite():
    truth = np.zeros((3, 2, 10))
    states = truth + SCALES * np.array([1e-3, 2e-3, 1.0])[:, None, None]
    states[2, 1, 4] = np.nan
    np.testing.assert_allclose(errors(states, truth), [1e-3, 2e-3, np.inf])


def test_cost_adds_up_the_least_and_the_middle_times_of_the_periods():
    seconds = np.array([[1.0, 9.0], [5.0, 3.0], [2.0, 4.0]])  # three repeats of two periods
    best, median = cost_of(seconds, lanes=2)
    assert best == pytest.approx(1e6 * (1 + 3) / 2 / 2)
    assert median == pytest.approx(1e6 * (2 + 4) / 2 / 2)


def test_wrong_names_and_numbers_are_refused_before_anything_is_measured():
    for options, words in (
        (dict(cases=["0"]), "`cases` must be one of nominal, V = 2300 m/s"),
        (dict(methods=["RK4", "0"]), "`methods` must be one of RK4, ImpulseRK4, Tsit5"),
        (dict(batches=[0]), "`batches` must be a whole number of 1 or more"),
        (dict(repeats=0), "`repeats` must be a whole number of 1 or more"),
    ):
        with pytest.raises(ValueError, match=words):
            list(bench(**options))


# table and pictures


def made_points(cases=("nominal",)):
    """Points as a real run gives them: all methods, other codes, and one error that is not finite."""
    points = []
    for factor, case in enumerate(cases, 1):
        for k, method in enumerate(METHODS):
            for setting in range(3):
                error, cost = factor * 1e-2 / 8**setting, (10 + 20 * k) * 2.0**setting
                costs = {241: (cost, 2 * cost), 1: (30 * cost, 40 * cost)}
                points.append(Point(case, method.name, f"{setting} steps", error, costs))
        points.append(point("RK4", math.inf, 1.0, case))
        for name, cost in (("C++ scalar, RK4, event latch", 70.0), ("SciPy DOP853 with events", 3e5)):
            points += [point(name, e, c, case, 1) for e, c in ((3e-3, cost), (5e-4, 2 * cost))]
        points += mbdyn_points(case)
    return points


def test_table_has_every_point_and_what_an_error_of_a_thousandth_costs(tmp_path):
    points = [point(m, e, c) for m in ("a", "b") for e, c in ((1e-2, 10.0), (1e-4, 40.0))]
    text, picture = write([*points, point("C++", 1e-3, 9.0, lanes=1)], tmp_path / "deep" / "out")
    assert [p.name for p in (text, picture)] == ["out.md", "out.png"]
    assert "| nominal | a | n steps | 1.0e-02 | 10 (20) | - |" in text.read_text()
    assert "| method | nominal, 241 at once | nominal, 1 at once |" in text.read_text()
    assert "| b | 20 | - |" in text.read_text()
    assert matplotlib.image.imread(picture).ndim == 3
    assert not plt.get_fignums()


def labels(axes):
    (legend,) = axes[0, 0].figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_scenes_are_panels_with_eight_curves_on_the_same_axes():
    names = [case.name for case in all_cases()[:5]]
    axes = draw(made_points(names))
    shown = [ax for ax in axes.flat if ax.lines]
    assert [ax.get_title("left") for ax in shown] == names
    assert len({(*ax.get_xlim(), *ax.get_ylim()) for ax in shown}) == 1
    assert labels(axes) == list(SHOWN.values())
    lines = {line.get_label(): line for line in shown[0].lines}
    assert len({line.get_color() for line in lines.values()}) == 8
    own, other = lines[SHOWN["RK4"]], lines[SHOWN["SciPy DOP853 with events"]]
    np.testing.assert_allclose(own.get_xdata(), [10, 20, 40])  # of the largest batch, without the infinite error
    np.testing.assert_allclose(own.get_ydata(), [1e-2, 1e-2 / 8, 1e-2 / 64])
    np.testing.assert_allclose(other.get_xdata(), [3e5, 6e5])  # one by one
    plt.close(shown[0].figure)


# a measurement


@pytest.fixture
def runs(monkeypatch):
    """Replaces the run of a measurement by `made(setting, speeds)`; the calls that it gets come back."""

    def replace(made):
        calls = []

        def run(case, method, setting, speeds):
            calls.append((method.name, setting, len(speeds)))
            return made(setting, speeds)

        monkeypatch.setattr(measuring, "run", run)
        return calls

    return replace


def test_costs_are_taken_in_rounds_over_all_points(runs):
    periods = all_cases()[0].periods
    calls = runs(lambda k, speeds: (np.full((len(speeds), periods, 10), 1 / k) * SCALES, np.full(periods, 1e-3)))
    options = dict(batches=(3, 1), repeats=2, reference_steps=800, settings=slice(0, 2))
    found = measuring.measure(all_cases()[0], METHODS[:2], **options)
    assert [(p.method, p.setting) for p in found] == [
        (n, f"{k} steps") for n in ("RK4", "ImpulseRK4") for k in (20, 40)
    ]
    assert [p.error for p in found] == pytest.approx([1 / 20 - 1 / 800, 1 / 40 - 1 / 800] * 2)
    assert all(p.cost[n] == pytest.approx((1e3 / n,) * 2) for p in found for n in (3, 1))
    a_round = [(n, k, lanes) for n in ("RK4", "ImpulseRK4") for k in (20.0, 40.0) for lanes in (3, 1)]
    assert calls == [("RK4", 800.0, 3), *a_round, *a_round, *a_round]


def test_slow_points_are_repeated_less_often(runs):
    calls = runs(lambda k, speeds: (np.zeros((len(speeds), 2, 10)), np.full(2, k / 10)))  # 4 s and 8 s in all
    options = dict(batches=(8,), repeats=4, settings=slice(0, 2))
    points = measuring.measure(all_cases()[0], METHODS[:1], **options)
    assert [k for _, k, _ in calls] == [12_800.0, 20.0, 40.0, 20.0, 40.0, 20.0, 40.0, 20.0]
    assert [p.cost[8][0] for p in points] == pytest.approx([1e6 * k / 10 / 8 for k in (20, 40)])


@pytest.mark.full
def test_a_run_is_the_sweep_of_the_same_speeds():
    case = Case("short", paper_scene(), 2, table_2_start())
    speeds = np.linspace(1200.0, 1300.0, 9)
    states, seconds = measuring.run(case, method_named("RK4"), 50.0, speeds, 2)
    options = dict(record="strobe", transient=0, periods=2, steps_per_period=50, solver="RK4")
    ds = sweep(paper_scene(), {"speed": speeds}, **options)
    for k in range(len(COORDINATES)):
        np.testing.assert_allclose(states[..., k], ds["strobe"].values[..., k], atol=1e-9 * SCALES[k])
    assert np.all(seconds > 0)


@pytest.mark.slow
def test_adaptive_methods_hold_their_tolerance():
    case = all_cases()[0]
    speeds = measuring.batch_speeds(case, 8)
    truth, _ = measuring.run(case, METHODS[0], 3200.0, speeds)
    method = method_named("Tsit5, adaptive")
    found = [np.median(errors(measuring.run(case, method, t, speeds)[0], truth)) for t in (1e-4, 1e-6)]
    assert found[0] < 5e-3  # measured: 1.5e-3
    assert found[1] < 2e-4  # measured: 5e-5


@pytest.mark.slow
def test_a_small_run_gives_its_points():
    (points,) = bench(quick=True, cases=["nominal"], methods=["RK4"], batches=[8])
    own = [p for p in points if p.method == "RK4"]
    assert [p.setting for p in own] == ["20 steps", "40 steps", "80 steps", "160 steps"]
    assert 1e-3 < own[1].error < 1e-2  # measured: 5.2e-3
    assert own[3].error < 1e-4  # measured: 6.8e-5
    assert any("MBDyn" in p.method for p in points)
