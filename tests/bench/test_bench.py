"""Speed against error: what can be said without measuring much."""

import math

import numpy as np
import pytest

from slipperjax import bench, work_precision
from slipperjax.cli import main
from slipperjax.peers import PEERS, NumpyModel, SciPyPeer

from .common import SCALES, cases


def point(method, error, cost, case="nominal", lanes=241):
    return work_precision.Point(case, method, "n steps", error, {lanes: (cost, 2 * cost)})


def test_cost_at_an_error_is_interpolated_in_logarithms():
    points = [point("a", 1e-2, 10.0), point("a", 1e-4, 40.0), point("a", math.inf, 1.0)]
    assert work_precision.cost_at(points, 1e-3, 241) == pytest.approx(20.0)
    assert work_precision.cost_at(points, 1e-1, 241) == pytest.approx(10.0)
    assert work_precision.cost_at(points, 1e-5, 241) == math.inf
    assert work_precision.cost_at(points, 1e-3, 1) == math.inf


def test_errors_are_those_of_each_case_and_infinite_where_not_finite():
    truth = np.zeros((3, 2, 10))
    states = truth + SCALES * np.array([1e-3, 2e-3, 1.0])[:, None, None]
    states[2, 1, 4] = np.nan
    np.testing.assert_allclose(bench.errors(states, truth), [1e-3, 2e-3, np.inf])


def test_what_is_not_measured_here_is_marked():
    found = work_precision.mbdyn_points(case.name for case in bench.all_cases())
    assert len(found) == 6
    assert all("measured elsewhere" in p.method for p in found)


def test_table_and_picture(tmp_path):
    points = [point(m, e, c) for m in ("a", "b") for e, c in ((1e-2, 10.0), (1e-4, 40.0))]
    text, picture = work_precision.write(points, (241, 1), tmp_path / "deep" / "out")
    assert "| nominal | a | n steps | 1.0e-02 | 10 (20) | - |" in text.read_text()
    assert "| method | nominal, 241 at once | nominal, 1 at once |" in text.read_text()
    assert "| b | 20 | - |" in text.read_text()
    assert picture.stat().st_size > 10_000


def test_cost_adds_up_the_least_and_the_middle_times_of_the_periods():
    seconds = np.array([[1.0, 9.0], [5.0, 3.0], [2.0, 4.0]])  # three repeats of two periods
    best, median = bench.cost_of(seconds, lanes=2)
    assert best == pytest.approx(1e6 * (1 + 3) / 2 / 2)
    assert median == pytest.approx(1e6 * (2 + 4) / 2 / 2)


def test_scenes_and_methods_have_names_of_their_own():
    for rows in (bench.all_cases(), bench.METHODS, PEERS):
        names = [row.name for row in rows]
        assert len(set(names)) == len(names)


def test_costs_are_taken_in_rounds_over_all_points(monkeypatch):
    calls = []

    def states(case, method, setting, speeds, workers):
        calls.append((method.name, setting, len(speeds)))
        return np.full((len(speeds), case.periods, 10), 1 / setting) * SCALES, np.full(case.periods, 1e-3)

    monkeypatch.setattr(bench, "run", states)
    options = dict(batches=(3, 1), repeats=2, reference_steps=800, peers=[], settings=slice(0, 2))
    found = list(bench.measure(bench.all_cases()[0], bench.METHODS[:2], **options))
    assert [(p.method, p.setting) for p in found] == [(n, f"{k} steps") for n in ("RK4", "Tsit5") for k in (25, 50)]
    assert [p.error for p in found] == pytest.approx([1 / 25 - 1 / 800, 1 / 50 - 1 / 800] * 2)
    assert all(p.cost[n] == pytest.approx((1e3 / n,) * 2) for p in found for n in (3, 1))
    a_round = [(n, k, lanes) for n in ("RK4", "Tsit5") for k in (25.0, 50.0) for lanes in (3, 1)]
    assert calls == [("RK4", 800.0, 3), *a_round, *a_round, *a_round]


@pytest.mark.parametrize(
    ("option", "words"), [("--scene", "nominal"), ("--method", "RK4"), ("--batch", "whole number")]
)
def test_wrong_input_is_one_line(option, words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["bench", option, "0"])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_scipy_lands_on_the_reference():
    # half a period of the fastest case, which has its first touchdowns in it, is what is cheap
    (case,) = (c for c in cases("hard_states") if c["name"] == "fast")
    names = ("clearance", "length", "stiffness", "restitution", "amplitude", "roll_amplitude")
    numbers = {name: case[name] for name in names} | dict(wave=8.0, wave2=0.0)
    states = SciPyPeer("DOP853").integrate(case["speed"], numbers, 1, 1e-7)
    assert states is not None
    assert np.max(np.abs(states[0] - case["states"][0]) / SCALES) < 1e-5
    model = NumpyModel(case["speed"], numbers)
    gap = model.contacts(0.0, np.zeros(10))[0]
    assert gap.min() > 0


@pytest.mark.slow
def test_a_small_run_writes_table_and_picture(tmp_path, capsys):
    options = ["--quick", "--scene", "nominal", "--method", "RK4", "--batch", "8"]
    with pytest.raises(SystemExit) as stopped:
        main(["bench", *options, "--out", str(tmp_path / "b")])
    assert stopped.value.code == 0
    assert "50 steps: error" in capsys.readouterr().out
    assert (tmp_path / "b.png").stat().st_size > 10_000
    assert "MBDyn (measured elsewhere)" in (tmp_path / "b.md").read_text()


def test_an_interrupt_keeps_the_rounds_that_were_timed(monkeypatch):
    calls = []

    def run(case, method, setting, speeds, workers):
        calls.append(setting)
        if len(calls) == 5:  # the reference, the errors, and two rounds came before
            raise KeyboardInterrupt
        return np.zeros((len(speeds), 2, 10)), np.array([1.0, 2.0])

    monkeypatch.setattr(bench, "run", run)
    options = dict(batches=(8,), repeats=9, peers=[], settings=slice(0, 1))
    (point,) = bench.measure(bench.all_cases()[0], bench.METHODS[:1], **options)
    assert len(calls) == 5
    assert point.cost[8] == bench.cost_of(np.array([[1.0, 2.0], [1.0, 2.0]]), 8)


def test_what_takes_long_is_repeated_less_often(monkeypatch):
    taken = []

    def run(case, method, setting, speeds, workers):
        taken.append(setting)
        return np.zeros((len(speeds), 2, 10)), np.full(2, setting / 10)  # 5 s and 10 s in all

    monkeypatch.setattr(bench, "run", run)
    options = dict(batches=(8,), repeats=4, peers=[], settings=slice(0, 2))
    points = list(bench.measure(bench.all_cases()[0], bench.METHODS[:1], **options))
    assert taken == [12_800.0, 25.0, 50.0, 25.0, 50.0, 25.0]
    assert [p.cost[8][0] for p in points] == pytest.approx([1e6 * k / 10 / 8 for k in (25, 50)])


def test_methods_that_call_lapack_run_a_sixteenth_of_the_cases(monkeypatch):
    def run(case, method, setting, speeds, workers):
        return np.tile(speeds[:, None, None], (1, 2, 10)) * SCALES, np.full(2, 0.8)

    monkeypatch.setattr(bench, "run", run)
    methods = [m for m in bench.METHODS if m.name in ("RK4", "smooth: diffrax Kvaerno3")]
    options = dict(batches=(241, 1), repeats=1, peers=[], settings=slice(0, 1))
    own, stock = bench.measure(bench.all_cases()[0], methods, **options)
    assert own.error == stock.error == 0  # of the same cases
    assert own.cost[241][0] == pytest.approx(0.8e6 / 241)
    assert stock.cost[241][0] == pytest.approx(0.8e6 / 16)
    assert own.cost[1] == stock.cost[1]
