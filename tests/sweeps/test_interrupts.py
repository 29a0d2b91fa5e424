"""Sweeps that Ctrl-C ends: the finished cases are kept, and no others."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.record import History, HistoryValues
from slipperjax.flow.status import ASKED, Status, Stop
from slipperjax.plots.maps import bifurcations
from slipperjax.sweeps import engine as runs
from slipperjax.sweeps.attractors import attractors
from slipperjax.sweeps.engine import run_parts
from slipperjax.sweeps.plan import Chunk
from slipperjax.sweeps.schedule import Schedule


class Found(NamedTuple):
    """Like the result of a chunk."""

    status: np.ndarray
    value: np.ndarray
    count: np.ndarray


@pytest.fixture
def interrupt_after(monkeypatch):
    """Interrupts the next runs when so many of their chunks are finished."""

    until = runs.wait

    def after(finished):
        def wait(futures, timeout, *first):
            if not first:
                return until(futures, timeout)
            while sum(future.done() for future in futures) < finished:
                time.sleep(0.001)
            raise KeyboardInterrupt

        monkeypatch.setattr(runs, "wait", wait)

    return after


def run(work, workers=1):
    chunks = [Chunk(np.arange(3 * k, 3 * k + 3), 3, Schedule.of(0, 10, 50)) for k in range(4)]
    return chunks, run_parts(chunks, workers, work, periods=10, progress=False)


def found_of(chunk):
    return Found(np.zeros(3, int), chunk.index * 1.5, chunk.index + 1)


def test_finished_chunks_are_kept_and_others_are_blank(interrupt_after):
    hold, begun = threading.Event(), []

    def work(chunk, on_progress):
        begun.append(int(chunk.index[0]))
        if chunk.index[0] >= 6:
            hold.wait(5.0)
            on_progress(1)  # raises: the run is over
        return found_of(chunk)

    interrupt_after(2)
    before = time.perf_counter()
    with pytest.warns(sj.ImplausibleWarning, match="has ended, but 1 of its threads will go on"):
        _, done = run(work)
    assert time.perf_counter() - before < 4.0  # whatever lasts longer is not waited for
    hold.set()
    assert (done.finished, done.interrupted) == (6, True)
    status, value, count = done.results
    assert status.tolist() == [0] * 6 + [int(Status.NOT_RUN)] * 6
    np.testing.assert_array_equal(value, [*(1.5 * np.arange(6)), *[np.nan] * 6])
    assert count.tolist() == [1, 2, 3, 4, 5, 6] + [0] * 6
    assert begun == [0, 3, 6]  # none is begun after it


def test_threads_have_ended_when_a_run_has():
    """After an interrupt, and after an error in another thread."""
    calls = []

    def begins(chunk, on_progress):
        ends[0](chunk)
        while True:
            calls.append("begun")
            time.sleep(0.05)
            calls.append("ended")
            on_progress(1)

    def interrupt(chunk):
        Stop.here().set()

    def fail(chunk):
        if chunk.index[0] >= 3:
            raise ValueError("seen")

    ends = [interrupt]
    _, done = run(begins, 2)
    assert done.interrupted
    assert calls.count("begun") == calls.count("ended") > 0
    calls.clear()
    ends = [fail]
    with pytest.raises(ValueError, match="seen"):
        run(begins, 2)
    assert calls.count("begun") == calls.count("ended")


@pytest.mark.parametrize("outer", [False, True])
def test_a_run_can_be_asked_to_end_and_no_other_ends(outer):
    first = Stop()
    stop, others, asked = Stop(first), Stop(), threading.Event()

    def work(chunk, on_progress):
        if chunk.index[0] >= 3:
            (first if outer else stop).set()  # as from a signal's handler whose exception is lost
            asked.set()
            while True:
                time.sleep(0.01)
                on_progress(1)
        return found_of(chunk)

    def goes_on(chunk, on_progress):
        asked.wait(5.0)
        time.sleep(0.3)
        on_progress(1)
        return found_of(chunk)

    with ThreadPoolExecutor(2) as pool:
        ended, other = stop.submit(pool, run, work), others.submit(pool, run, goes_on)
        (_, done), (_, whole) = ended.result(), other.result()
    assert (done.finished, done.interrupted) == (3, True)
    assert (whole.finished, whole.interrupted) == (12, False)
    assert Stop.here() is ASKED


def test_nothing_is_kept_where_nothing_was_finished_and_errors_are_raised(interrupt_after):
    def fails(chunk, on_progress):
        raise ValueError("seen")

    with pytest.raises(ValueError, match="seen"):
        run(fails, 2)
    interrupt_after(0)
    _, done = run(lambda chunk, on_progress: time.sleep(0.05))
    with pytest.raises(sj.Interrupted, match="none of 12 cases were finished") as stop:
        done.checked(lambda: done.results)
    assert stop.value.result is None
    assert isinstance(stop.value, KeyboardInterrupt)  # `except Exception` does not catch it


@pytest.mark.full
def test_an_interrupted_sweep_has_the_finished_cases(interrupt_after):
    # the last two cases are in the last chunk; the program is that of test_sweep
    options = dict(transient=10, periods=10, steps_per_period=[100] * 8 + [50] * 2, chunk=8, workers=1)
    run = lambda: sj.sweep(sj.paper_scene(), {"speed": np.linspace(800, 1700, 10)}, **options)
    whole = run()
    interrupt_after(1)
    with pytest.raises(sj.Interrupted, match="8 of 10 cases were finished") as stop:
        run()
    found = stop.value.result
    assert (stop.value.finished, stop.value.of) == (8, 10)
    assert found["status"].values.tolist() == [0] * 8 + [7] * 2
    assert "7: not run" in found["status"].attrs["meaning"]
    assert set(found) == set(whole)
    for name in whole:
        done = found[name].values[:8]
        exact = whole[name].values[:8]
        np.testing.assert_array_equal(done, exact[..., : done.shape[-1]] if done.ndim > 1 else exact, err_msg=name)
        if found[name].dtype.kind == "f":
            assert np.all(np.isnan(found[name].values[8:])), name
    assert attractors(found, 20).kind[9] == "unresolved"
    axes = bifurcations(found)
    assert len(axes[0].lines[0].get_xdata()) > 0
    plt.close(axes[0].figure)


def test_a_history_keeps_its_times():
    """Those of cases that were not run are not there."""
    period = np.array([[np.nan] * 4, [0.25, 0.5, 0.75, 1.0], [np.nan] * 4])
    states, acceleration, force = np.ones((3, 4, 10)), np.ones((3, 4, 5)), np.ones((3, 4, 2, 10))
    found = HistoryValues(states, period, acceleration, force, force, np.ones((3, 4)))
    _, coords = History(4).label(sj.paper_scene(), ("speed",), found)
    assert coords["period"][1].tolist() == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.full
def test_a_followed_motion_is_kept_as_far_as_it_came(interrupt_after):
    interrupt_after(2)
    path = {"speed": [1240.0, 1250.0, 1260.0, 1270.0]}
    with pytest.raises(sj.Interrupted) as stop:
        sj.follow(sj.paper_scene(), path, record="strobe", transient=0, periods=10)
    status = stop.value.result["status"]
    assert set(status.sel(speed=[1240.0, 1250.0], direction="up").values) == {0}
    assert set(status.sel(speed=[1260.0, 1270.0], direction="down").values) == {0}
    assert int(status.sel(speed=1270.0, direction="up")) == 7
