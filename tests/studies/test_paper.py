"""The claims as data, and the runs that answer them."""

import json

import numpy as np
import pytest
import xarray as xr

from slipperjax.flow.status import Status
from slipperjax.studies.dang2024 import runs
from slipperjax.studies.dang2024.claims import CLAIMS, Answer, near, rows, section_points, write_report
from slipperjax.studies.dang2024.claims import runs as runs_of
from slipperjax.studies.dang2024.runs import FIGURES, QUICK, readings, reproduce
from slipperjax.sweeps.follow import Jump

from . import made


def test_runs_points_and_places():
    values, nan = np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.nan
    assert runs_of([True, True, False, False, True], values) == [(1.0, 2.0), (5.0, 5.0)]
    assert runs_of([False] * 5, values) == []
    values = np.array([[1.0, 1.0, 1.001, nan], [1.0, 3.0, 1.0, 3.0], [nan] * 4, [0.0, 1.0, 2.0, 4.0]])
    assert section_points(values).tolist() == [1, 2, 0, 4]
    assert section_points(np.full((2, 3), nan)).tolist() == [0, 0]
    assert [near(value, 820, 10.0) for value in (830.0, 831.0, None, nan)] == [True, False, False, False]


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
    with pytest.raises(ValueError, match=r"`figures` must be one of 4, 7, 12, 5, .*, 13, basins, but is '3'"):
        reproduce(["3"])
    with pytest.raises(ValueError, match="`transient` must be a whole number of 20 or more, but is 3"):
        reproduce(["5"], transient=3)


def test_lists_run_as_one_with_more_steps_for_slow_cases():
    calls = []

    def run(scene, grid, product, transient, steps_per_period):
        calls.append((product, transient))
        data = {
            "v_y": (("case", "crossing"), np.repeat(grid["speed"][:, None], 3, axis=1)),
            "steps_per_period": ("case", steps_per_period),
        }
        return xr.Dataset(data, {name: ("case", values) for name, values in grid.items()})

    parts = runs._joined(run, QUICK, ["histories", "speed", "length"])
    assert calls == [(False, QUICK.transient)]
    for name, expected in runs.cases(QUICK).items():
        if name != "clearance":
            ds = parts[name]
            for key, values in expected.items():
                np.testing.assert_array_equal(ds[key].values, values)
            np.testing.assert_array_equal(ds["v_y"].values[:, 0], expected["speed"])
            slow = expected["speed"] < 500
            np.testing.assert_array_equal(ds["steps_per_period"].values, np.where(slow, 200, 100))
    assert parts["speed"]["v_y"].dims == ("speed", "crossing")
    assert parts["histories"]["v_y"].dims == ("case", "crossing")


def test_each_figure_is_made_by_one_run_of_what_it_needs(monkeypatch):
    asked = []

    def joined(run, effort, names, **options):
        asked.append((run.__name__, names))
        known = {"speed": made.speeds_as_claimed, "clearance": made.clearances_as_claimed}
        known |= {"length": made.lengths_as_claimed, "histories": lambda: made.singles()[1]}
        if run.__name__ == "lyapunov_sweep":
            return {name: made.exponents(name, known[name]()[name].values, True) for name in names}
        return {name: known[name]() for name in names}

    monkeypatch.setattr(runs, "_joined", joined)

    def sweep(*arguments, **options):
        return made.singles()[0]

    monkeypatch.setattr(runs, "sweep", sweep)
    monkeypatch.setattr(runs, "follow", lambda *a, **k: made.speeds_as_claimed())
    monkeypatch.setattr(runs, "find_jump", lambda *a, **k: Jump(False, 0.0, 2500.0, np.nan, Status.NOT_FINITE))
    monkeypatch.setattr(runs.verdicts, "attractors", made.attractors_once)
    known = {"speed": made.speed_branches, "clearance": made.clearance_branches}

    def follow_branches(name, flips, observed, data, options):
        asked.append((name, flips, observed))
        found = known[name]()
        data |= {f"{name}_{kind}": branch.points for kind, branch in found.items()}
        return found

    monkeypatch.setattr(runs.branches, "follow_branches", follow_branches)
    done = list(reproduce(["8", "9", "5", "12"], quick=True))
    assert [(d.name, d.figures) for d in done] == [("motions", ("12", "5", "8")), ("exponents", ("9",))]
    batches = [("sweep", ["histories", "speed", "clearance"]), ("lyapunov_sweep", ["clearance"])]
    assert sorted(call for call in asked if len(call) == 2) == sorted(batches)  # runs are made at once
    assert [call for call in asked if len(call) == 3] == [("speed", 0, False), ("clearance", 0, False)]
    answers = done[0].answers | done[1].answers
    assert set(answers) <= set(CLAIMS)
    assert {key.split()[0] for key in answers} == {f"N{k}" for k in (1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 14, 15)}
    assert "followed upwards: search ended at 2500 m/s (not finite" in answers["N4 jump"].why
    assert "; the branch does not end there, only the set of starts that lead to it" in answers["N4 jump"].why
    assert answers["N9 wide"].why.count("; settled within 500 forcing periods on orbits of period 1") == 1
    assert answers["N11"].why.startswith("by recurrence")
    assert "(Neimark-Sacker, NS)" in answers["N11"].why
    diagrams = {"speed", "speed_followed", "clearance"}
    followed = {"speed_branch", "speed_period_2", "clearance_branch", "clearance_observed"}
    assert set(done[0].data) == {"sections", "histories"} | diagrams | followed
    assert all(any(f in figures for figures, _ in runs.RUNS.values()) for f in FIGURES)


def test_readings_leave_out_flagged_cases(monkeypatch):
    asked = []

    def fake(scene, grid, **options):
        asked.append((scene.contact.clamp, options["steps_per_period"], grid["clearance"][0]))
        if options.get("record") == "history":
            history, _ = made.singles()
            return history.isel(case=[5, 6]).assign(status=("case", [0, 2]))
        at = np.arange(len(grid["speed"]))
        slow, fast = grid["speed"] < 1100, grid["speed"] > 1500
        kinds = np.where(slow & (grid["speed"] >= 820), 3, 1).astype(object)
        wide = grid["clearance"] >= 2.59e-3 * (grid["clearance"][0] / 1e-3)
        kinds[wide] = "chaotic"
        points = {"v_y": np.where(slow & (grid["speed"] >= 820), 3, 1)}
        ds = made.diagram(
            "place", at, kinds, points, {"v_y": np.where(fast & (grid["speed"] > 1850), 0.0, 10.0)}, "case"
        )
        ds["status"][np.flatnonzero(wide)[0]] = 1
        ds["status"][np.flatnonzero(grid["speed"] == 1000)[0]] = 1
        return ds

    monkeypatch.setattr(runs, "sweep", fake)
    monkeypatch.setattr(runs, "attractors", made.attractors_once)
    table = readings(QUICK, {})
    assert [row["reading"] for row in table] == list(runs.CONVENTIONS)
    first = table[0]
    assert first["N1 900 m/s"] == "period-3"
    assert first["N4 three points in V_Y (820..980 m/s)"] == "820..980, 1020..1060"
    assert first["N4 drop (1810 m/s)"] == "1840..1860"
    assert first["N11 not periodic from (2.575 mm)"] == "2.65"
    assert first["N14 L = 0.1 m (1977, 8807, 5447 N)"] == "1977, 8807, 5447"
    assert first["N14 L = 0.4 m (4256, 12824, 20365 N)"] == "flagged"
    assert first["cases flagged"] == "2 of 38"
    # two readings at once, each with a sweep and a history
    assert sorted((clamp, steps, round(c * 1e3)) for clamp, steps, c in asked) == sorted(
        2 * [(True, 100, 1), (True, 100, 2), (False, 100, 1), (False, 100, 2)]
    )


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
