"""The runs that answer the claims, and the report."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.studies.dang2024 import runs, verdicts
from slipperjax.studies.dang2024.claims import CLAIMS, Answer, rows, write_report
from slipperjax.studies.dang2024.runs import QUICK, follow_branches, jump_text, readings, reproduce
from slipperjax.sweeps.follow import Jump

from . import made


def test_report_has_every_answer_with_its_verdict(tmp_path):
    answers = {"N13": Answer("0.2..0.22 m", True), "N2 section": Answer("2 points", False, "because")}
    assert [row["claim"] for row in rows(answers)] == ["N2 section", "N13"]
    markdown, data = write_report(tmp_path, answers, {"speed": 1.25}, [{"reading": "a | b", "N1": "period-3"}])
    text = markdown.read_text()
    assert "1 of 2 reproduced, 1 differ" in text
    assert "| N2 section | Fig. 4b | 1500 m/s: roll section | 1 point | 2 points | differs | because |" in text
    assert "a / b" in text
    content = json.loads(data.read_text())
    assert content["claims"][1]["verdict"] == "reproduced"
    assert content["seconds"] == {"speed": 1.25}


def test_unknown_figures_are_refused_at_once():
    with pytest.raises(ValueError, match=r"`figures` must be one of 4, 7, 12, 5, .*, 13, but is '3'"):
        reproduce(["3"])
    with pytest.raises(ValueError, match="`transient` must be a whole number of 20 or more, but is 3"):
        reproduce(["5"], transient=3)


def test_lists_run_as_one_with_more_steps_for_slow_cases():
    calls = []

    def run(scene, grid, product, transient, steps_per_period):
        calls.append((product, transient))
        data = {"v_y": ("case", grid["speed"]), "steps_per_period": ("case", steps_per_period)}
        return sj.Result(xr.Dataset(data, {name: ("case", values) for name, values in grid.items()}))

    lists = runs.study_cases(QUICK)
    parts = runs.run_lists(run, None, lists, transient=7)
    assert calls == [(False, 7)]
    for name, expected in lists.items():
        for key, values in expected.items():
            np.testing.assert_array_equal(parts[name][key].values, values)
        steps = np.where(expected["speed"] < 500, 200, 100)
        np.testing.assert_array_equal(parts[name]["steps_per_period"].values, steps)
        assert parts[name]["v_y"].dims == ("case" if name == "histories" else name,)


def test_each_figure_is_made_by_one_run_of_what_it_needs(monkeypatch):
    asked = []
    known = {
        "speed": made.speeds_as_claimed,
        "clearance": made.clearances_as_claimed,
        "length": made.lengths_as_claimed,
        "histories": lambda: made.singles()[1],
    }

    def run_lists(run, scene, lists, **options):
        asked.append((run.__name__, list(lists)))
        if run.__name__ == "lyapunov_sweep":
            return {name: made.exponents(name, known[name]()[name].values, True) for name in lists}
        return {name: known[name]() for name in lists}

    def sweep(*arguments, **options):
        return SimpleNamespace(ds=made.singles()[0])

    monkeypatch.setattr(runs, "run_lists", run_lists)
    monkeypatch.setattr(runs, "sweep", sweep)
    monkeypatch.setattr(runs, "find_jump", lambda *a, **k: Jump(False, 0.0, 2500.0, np.nan, Status.NOT_FINITE))
    monkeypatch.setattr(runs, "follow_branches", lambda name, flips, progress: made.speed_branches())
    monkeypatch.setattr(verdicts, "attractors", made.attractors_once)
    done = list(reproduce(["8", "9", "5", "12"], quick=True))
    assert [(d.name, d.figures) for d in done] == [("motions", ("12", "5", "8")), ("exponents", ("9",))]
    assert asked == [("sweep", ["histories", "speed", "clearance"]), ("lyapunov_sweep", ["clearance"])]
    answers = done[0].answers | done[1].answers
    assert set(answers) <= set(CLAIMS)
    assert {key.split()[0] for key in answers} == {f"N{k}" for k in (1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 14, 15)}
    assert len(CLAIMS) == 42
    assert "followed up: search ended at 2500 m/s (not finite" in answers["N4 jump"].why
    branches = {f"{name}_branch_{period}" for name in ("speed", "clearance") for period in (1, 2)}
    assert set(done[0].data) == {"sections", "histories", "speed", "clearance"} | branches


@pytest.mark.parametrize(
    ("jump", "text"),
    [
        (Jump(True, 1791.0, 1790.0, 5.0, Status.FINITE), "1790..1791 m/s"),
        (Jump(False, 2500.0, 2500.0, np.nan, Status.FINITE), "no jump"),
        (Jump(False, 2230.0, 2240.0, np.nan, Status.DERAILED), "search ended at 2240 m/s (derailed"),
    ],
)
def test_the_end_of_a_search_is_told_apart(jump, text):
    assert jump_text(jump).startswith(text)


def test_readings_answer_the_claims_that_differ(monkeypatch):
    asked = []

    def fake(scene, grid, **options):
        play = grid["clearance"][0] / 1e-3
        asked.append((scene.contact.clamp, round(play)))
        if options.get("record") == "history":
            history, _ = made.singles()
            return SimpleNamespace(ds=history.isel(case=[5, 6]))
        slow = grid["speed"] < 1100
        three = slow & (grid["speed"] >= 820)
        wide = grid["clearance"] >= 2.59e-3 * play
        kinds = [
            "chaotic" if is_wide else 3 if is_three else 1 for is_wide, is_three in zip(wide, three, strict=True)
        ]
        levels = {"v_y": np.where(grid["speed"] > 1850, 0.0, 10.0)}
        ds = made.diagram("place", np.arange(slow.size), kinds, {"v_y": np.where(three, 3, 1)}, levels, "case")
        ds["status"][np.flatnonzero(wide)[0]] = 1
        return SimpleNamespace(ds=ds.assign_coords({name: ("case", values) for name, values in grid.items()}))

    monkeypatch.setattr(runs, "sweep", fake)
    monkeypatch.setattr(verdicts, "attractors", made.attractors_once)
    table = readings()
    assert [row["reading"] for row in table][:2] == ["total play, forces clamped", "play per face, forces clamped"]
    assert asked == [(clamp, play) for clamp in (True, False) for play in (1, 1, 2, 2)]
    for row in table:
        assert list(row.values())[1:] == [
            "period-3",
            "820..1060 m/s",
            "1840..1860 m/s",
            "2.65..2.8 mm; 1 of 9 cases flagged",
            "1977 against 4256 N, 8807 against 12824 N, 5447 against 20365 N",
        ]


@pytest.mark.slow
def test_speed_branches_have_the_known_events():
    first, twice = follow_branches("speed", 1)
    at = lambda branch, label: sorted(event.value for event in branch.events_named(label))
    # at 400 steps 1095.9120 and 2234.7236
    assert at(first, "PD") == pytest.approx([1095.9106], abs=2e-4)
    assert at(first, "LP")[-1] == pytest.approx(2234.7235, abs=2e-4)
    assert twice.period == 2
    assert at(twice, "PD")[-1] == pytest.approx(969.694, abs=2e-3)


@pytest.mark.slow
def test_quick_study_answers_every_claim(tmp_path):
    answers = {}
    for done in reproduce(quick=True):
        answers |= done.answers
    assert set(answers) == set(CLAIMS)
    assert not any("flagged" in answer.ours for answer in answers.values())
    # an independent code and MBDyn agree on these; the others are for the report
    for key in ("N2 motion", "N2 section", "N9 narrow", "N10 period-1", "N12 constant", "N16 A_Z top"):
        assert answers[key].good, (key, answers[key])
