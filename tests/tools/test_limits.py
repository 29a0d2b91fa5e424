"""Impossible runs are refused with memory and time, long ones warned of."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.tools.limits import available_memory, refuse_impossible, shown_bytes, shown_time


def test_durations_and_sizes_in_words():
    durations = {
        0.2: "0.2 s",
        100: "100 s",
        125: "2.08 min",
        12_000: "3.33 h",
        3e5: "3.47 days",
        6e8: "19 years",
    }
    assert {seconds: shown_time(seconds) for seconds in durations} == durations
    assert [shown_bytes(x) for x in (999.0, 2.5e9, 8e12, 3e18)] == ["999 B", "2.5 GB", "8 TB", "3e+03 PB"]


def test_memory_and_time_decide(monkeypatch):
    monkeypatch.setattr("slipperjax.tools.limits.available_memory", lambda: 10**9)
    refuse_impossible("Two cases", 1e9, 3600.0)
    with pytest.raises(ValueError, match="Two cases need about 2 GB of memory and 60 min, but 1 GB of memory are"):
        refuse_impossible("Two cases", 2e9, 3600.0)
    with pytest.raises(ValueError, match=r"and 3\.17 years, which is more than a year"):
        refuse_impossible("Two cases", 1e3, 1e8)
    with pytest.warns(sj.ImplausibleWarning, match="Two cases need about 1 kB of memory and 3.47 days"):
        refuse_impossible("Two cases", 1e3, 3e5)
    monkeypatch.setattr("slipperjax.tools.limits.available_memory", lambda: None)
    refuse_impossible("Two cases", 1e30, 3600.0)


def test_runs_are_refused_before_anything_is_allocated():
    assert 1e7 < available_memory() < 1e16
    scene, speed = sj.paper_scene(), {"speed": [1e3]}
    state = sj.initial_state(scene, sj.table_2_start())
    for run in (
        lambda: sj.sweep(scene, dict.fromkeys(("start_v_y", "start_v_z", "start_w_x"), np.linspace(0.5, 1, 10**4))),
        lambda: sj.sweep(scene, speed, periods=10**12),
        lambda: sj.sweep(scene, speed, record="strobe", transient=10**14),  # in time alone
        lambda: sj.follow(scene, speed, transient=10**12),
        lambda: sj.lyapunov_sweep(scene, speed, periods=10**12),
        lambda: sj.simulate(scene, 10**10),
        lambda: sj.period_map(scene, state, periods=10**12),
    ):
        with pytest.raises(ValueError, match=r"need about .*B of memory and .*(are available|more than a year)"):
            run()
