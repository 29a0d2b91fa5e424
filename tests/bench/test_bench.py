"""Error against cost: the arithmetic on made points, a measurement, and small real runs."""

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
from .measure import bench, errors
from .methods import METHODS, Case, all_cases
from .work_precision import MBDYN, SHOWN, Point, cost_at, draw, mbdyn_points, write


def point(method, error, cost, case="nominal", lanes=241):
    return Point(case, method, "n steps", error, {lanes: (cost, 2 * cost)})


def test_cost_at_an_error_is_interpolated_in_logarithms():
    points = [point("a", 1e-2, 10.0), point("a", 1e-4, 40.0), point("a", math.inf, 1.0)]
    assert cost_at(points, 1e-3, 241) == pytest.approx(20.0)
    assert cost_at(points, 1e-1, 241) == pytest.approx(10.0)
    assert cost_at(points, 1e-5, 241) == math.inf
    assert cost_at(points, 1e-3, 1) == math.inf


def test_wrong_names_and_numbers_are_refused_before_anything_is_measured():
    for options, words in (
        (dict(cases=["0"]), "`cases` must be one of nominal, V = 2300 m/s"),
        (dict(methods=["RK4", "0"]), "`methods` must be one of RK4, ImpulseRK4, Tsit5"),
        (dict(batches=[0]), "`batches` must be a whole number of 1 or more"),
        (dict(repeats=0), "`repeats` must be a whole number of 1 or more"),
    ):
        with pytest.raises(ValueError, match=words):
            list(bench(**options))


def test_scenes_are_panels_with_at_most_eight_curves():
    names = [case.name for case in all_cases()[:5]]
    points = [point(m.name, e, 1 / e, case) for case in names for m in METHODS for e in (1e-2, 1e-3, np.inf)]
    axes = draw(points + [p for case in names for p in mbdyn_points(case)])
    shown = [ax for ax in axes.flat if ax.lines]
    assert [ax.get_title("left") for ax in shown] == names
    assert len({(*ax.get_xlim(), *ax.get_ylim()) for ax in shown}) == 1
    known = {MBDYN, *(method.name for method in METHODS)}
    assert {line.get_label() for line in shown[0].lines} == {label for name, label in SHOWN.items() if name in known}
    plt.close(shown[0].figure)


def test_table_has_every_point_and_what_an_error_of_a_thousandth_costs(tmp_path):
    points = [point(m, e, c) for m in ("a", "b") for e, c in ((1e-2, 10.0), (1e-4, 40.0))]
    text, picture = write([*points, point("C++", 1e-3, 9.0, lanes=1)], tmp_path / "deep" / "out")
    assert [p.name for p in (text, picture)] == ["out.md", "out.png"]
    assert "| nominal | a | n steps | 1.0e-02 | 10 (20) | - |" in text.read_text()
    assert "| method | nominal, 241 at once | nominal, 1 at once |" in text.read_text()
    assert "| b | 20 | - |" in text.read_text()
    assert matplotlib.image.imread(picture).ndim == 3
    assert not plt.get_fignums()


def test_a_measurement_has_errors_from_its_reference_and_costs_of_all_batches(monkeypatch):
    periods = all_cases()[0].periods
    made = lambda k, speeds: (np.full((len(speeds), periods, 10), 1 / k) * SCALES, np.full(periods, 1e-3))
    monkeypatch.setattr(measuring, "run", lambda case, method, setting, speeds: made(setting, speeds))
    options = dict(batches=(3, 1), repeats=2, reference_steps=800, settings=slice(0, 2))
    found = measuring.measure(all_cases()[0], METHODS[:2], **options)
    assert [(p.method, p.setting) for p in found] == [
        (n, f"{k} steps") for n in ("RK4", "ImpulseRK4") for k in (20, 40)
    ]
    assert [p.error for p in found] == pytest.approx([1 / 20 - 1 / 800, 1 / 40 - 1 / 800] * 2)
    assert all(p.cost[n] == pytest.approx((1e3 / n,) * 2) for p in found for n in (3, 1))
    assert np.isinf(errors(np.full((1, 2, 10), np.nan), 0.0))


@pytest.mark.full
def test_a_run_is_the_sweep_of_the_same_speeds():
    case = Case("short", paper_scene(), 2, table_2_start())
    speeds = np.linspace(1200.0, 1300.0, 9)
    states, seconds = measuring.run(case, METHODS[0], 50.0, speeds, 2)
    options = dict(record="strobe", transient=0, periods=2, steps_per_period=50, solver="RK4")
    ds = sweep(paper_scene(), {"speed": speeds}, **options)
    for k in range(len(COORDINATES)):
        np.testing.assert_allclose(states[..., k], ds["strobe"].values[..., k], rtol=0, atol=1e-9 * SCALES[k])
    assert np.all(seconds > 0)


@pytest.mark.slow
def test_adaptive_methods_hold_their_tolerance():
    case = all_cases()[0]
    speeds = measuring.batch_speeds(case, 8)
    truth, _ = measuring.run(case, METHODS[0], 3200.0, speeds)
    (method,) = (method for method in METHODS if method.name == "Tsit5, adaptive")
    found = [np.median(errors(measuring.run(case, method, t, speeds)[0], truth)) for t in (1e-4, 1e-6)]
    assert found[0] < 5e-3  # measured: 1.5e-3
    assert found[1] < 2e-4  # measured: 5e-5
