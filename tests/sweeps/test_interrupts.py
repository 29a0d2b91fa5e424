"""Sweeps that Ctrl-C ends: the finished cases are kept, and no others."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.record import History, HistoryValues, RecordSet
from slipperjax.flow.status import ASKED, Status, Stop
from slipperjax.sweeps import engine
from slipperjax.sweeps.call import Call, make_plan
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.plan import Part
from slipperjax.tools.checks import warn


class Found(NamedTuple):
    """Like the result of a part."""

    status: np.ndarray
    value: np.ndarray
    count: np.ndarray


@pytest.fixture
def interrupt_after(monkeypatch):
    """Interrupts the next runs when so many of their parts are finished."""
    until = engine.wait

    def after(finished, when=lambda: True):
        def wait(futures, timeout, *first):
            if not first:
                return until(futures, timeout)
            while sum(future.done() for future in futures) < finished or not when():
                time.sleep(0.001)
            raise KeyboardInterrupt

        monkeypatch.setattr(engine, "wait", wait)

    return after


def run(work, workers=1):
    """Runs four parts of three cases each."""
    grid = Grid(sj.paper_scene(), {"speed": np.linspace(1000.0, 1500.0, 12)})
    plan = make_plan(grid, sj.table_2_start(), Call(0, 10, steps_per_period=50), RecordSet())
    lanes = np.arange(12).reshape(4, 3)
    parts = [Part(plan, index, index, 3, plan.schedules[0]) for index in lanes]
    return engine.run_parts(parts, workers, work, periods=10, progress=False)


def found_of(part):
    return Found(np.zeros(3, int), part.row * 1.5, part.row + 1)


def test_finished_chunks_are_kept_and_others_are_blank(interrupt_after):
    hold, begun = threading.Event(), []

    def work(part):
        begun.append(int(part.row[0]))
        if part.row[0] >= 6:
            hold.wait(5.0)
            part.on_progress(1)  # raises: the run is over
        return found_of(part)

    interrupt_after(2, lambda: len(begun) == 3)
    before = time.perf_counter()
    with pytest.warns(sj.ImplausibleWarning, match="has ended, but 1 of its threads will go on"):
        done = run(work)
    assert time.perf_counter() - before < 4.0  # whatever lasts longer is not waited for
    hold.set()
    assert (done.finished, done.interrupted) == (6, True)
    status, value, count = done.results
    assert status.tolist() == [0] * 6 + [int(Status.NOT_RUN)] * 6
    np.testing.assert_array_equal(value, [*(1.5 * np.arange(6)), *[np.nan] * 6])
    assert count.tolist() == [1, 2, 3, 4, 5, 6] + [0] * 6
    assert begun == [0, 3, 6]  # none is begun after it


@pytest.mark.parametrize("fails", [False, True])
def test_threads_have_ended_when_a_run_has(fails):
    """After an interrupt, and after an error in another thread."""
    calls = []

    def begins(part):
        if not fails:
            Stop.here().set()
        elif part.row[0] >= 3:
            raise ValueError("seen")
        while True:
            calls.append("begun")
            time.sleep(0.05)
            calls.append("ended")
            part.on_progress(1)

    if fails:
        with pytest.raises(ValueError, match="seen"):
            run(begins, 2)
    else:
        assert run(begins, 2).interrupted
    assert calls.count("begun") == calls.count("ended") > 0


@pytest.mark.parametrize("outer", [False, True])
def test_a_run_can_be_asked_to_end_and_no_other_ends(outer):
    first = Stop()
    stop, others, asked = Stop(first), Stop(), threading.Event()

    def work(part):
        if part.row[0] >= 3:
            (first if outer else stop).set()  # as from a signal's handler whose exception is lost
            asked.set()
            while True:
                time.sleep(0.01)
                part.on_progress(1)
        return found_of(part)

    def goes_on(part):
        asked.wait(5.0)
        time.sleep(0.3)
        part.on_progress(1)
        return found_of(part)

    with ThreadPoolExecutor(2) as pool:
        ended, other = stop.submit(pool, run, work), others.submit(pool, run, goes_on)
        done, whole = ended.result(), other.result()
    assert (done.finished, done.interrupted) == (3, True)
    assert (whole.finished, whole.interrupted) == (12, False)
    assert Stop.here() is ASKED


def test_nothing_is_kept_where_nothing_was_finished(interrupt_after):
    interrupt_after(0)
    done = run(lambda part: time.sleep(0.05))
    with pytest.raises(sj.Interrupted, match="none of 12 cases were finished") as stop:
        done.checked(lambda: done.results)
    assert stop.value.result is None
    assert isinstance(stop.value, KeyboardInterrupt)  # `except Exception` does not catch it


def test_each_kind_of_warning_is_given_once_in_a_run():
    def work(part):
        warn(f"{part.row[0]} of 12 starts lie outside.")
        return found_of(part)

    for _ in range(2):
        with pytest.warns(sj.ImplausibleWarning) as given:
            run(work, 2)
        assert len(given) == 1


@pytest.mark.full
def test_an_interrupted_sweep_has_the_finished_cases(interrupt_after):
    # the last two cases are in the last chunk; the program is that of test_sweep
    options = dict(transient=10, periods=10, steps_per_period=[100] * 8 + [50] * 2, chunk=8, workers=1)
    swept = lambda: sj.sweep(sj.paper_scene(), {"speed": np.linspace(800, 1700, 10)}, **options)
    whole = swept()
    interrupt_after(1)
    with pytest.raises(sj.Interrupted, match="8 of 10 cases were finished") as stop:
        swept()
    found = stop.value.result
    assert (stop.value.finished, stop.value.of) == (8, 10)
    assert found["status"].values.tolist() == [0] * 8 + [7] * 2
    assert "7: not run" in found["status"].attrs["meaning"]
    assert set(found) == set(whole)
    for name in whole:
        done, exact = found[name].values, whole[name].values[:8]
        np.testing.assert_array_equal(
            done[:8], exact[..., : done.shape[-1]] if done.ndim > 1 else exact, err_msg=name
        )
        assert done.dtype.kind != "f" or np.all(np.isnan(done[8:])), name
    assert sj.sweeps.attractors(found, 20).kind[9] == "unresolved"


def test_a_history_has_no_times_of_cases_that_were_not_run():
    period = np.array([[np.nan] * 4, [0.25, 0.5, 0.75, 1.0], [np.nan] * 4])
    force = np.ones((3, 4, 2, 10))
    found = HistoryValues(np.ones((3, 4, 10)), period, np.ones((3, 4, 5)), force, force, np.ones((3, 4)))
    _, coords = History(4).label(sj.paper_scene(), ("speed",), found)
    assert coords["period"][1].tolist() == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.full
def test_a_followed_motion_is_kept_as_far_as_it_came(interrupt_after):
    interrupt_after(2)
    path = {"speed": [1240.0, 1250.0, 1260.0, 1270.0]}
    with pytest.raises(sj.Interrupted) as stop:
        sj.follow(sj.paper_scene(), path, record="strobe", transient=0, periods=10)
    assert stop.value.result["status"].values.tolist() == [[0, 0, 7, 7], [7, 7, 0, 0]]
