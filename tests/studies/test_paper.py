"""The paper's claims as data, and what turns runs into answers."""

import json

import numpy as np
import pytest
import xarray as xr

from slipperjax import paper
from slipperjax.claims import CLAIMS, Answer, rows, runs, section_points, write_report


def test_runs_of_true():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    assert runs([True, True, False, False, True], values) == [(1.0, 2.0), (5.0, 5.0)]
    assert runs([False] * 5, values) == []


def test_section_points_are_counted():
    nan = np.nan
    values = np.array([[1.0, 1.0, 1.001, nan], [1.0, 3.0, 1.0, 3.0], [nan] * 4, [0.0, 1.0, 2.0, 4.0]])
    assert section_points(values).tolist() == [1, 2, 0, 4]


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
    with pytest.raises(
        ValueError, match="`figures` must be one of 4, 7, 12, 5, 8, 10, 6, 9, 11, 13, basins, but is '3'"
    ):
        paper.reproduce(["3"])


def test_lists_run_as_one_with_more_steps_for_slow_cases():
    def run(scene, grid, product, transient, steps_per_period):
        crossings = 2 if steps_per_period == paper.STEPS else 3
        data = {"v_y": (("case", "crossing"), np.repeat(grid["speed"][:, None], crossings, axis=1))}
        coords = {name: ("case", values) for name, values in grid.items()}
        return xr.Dataset(data, coords, {"steps_per_period": steps_per_period})

    parts = paper._joined(run, paper.QUICK, ["histories", "speed", "length"])
    for name, expected in paper.cases(paper.QUICK).items():
        if name != "clearance":
            ds = parts[name]
            for key, values in expected.items():
                np.testing.assert_array_equal(ds[key].values, values)
            np.testing.assert_array_equal(ds["v_y"].values[:, 0], expected["speed"])
            slow = expected["speed"] < 500
            np.testing.assert_array_equal(ds["steps_per_period"].values, np.where(slow, 200, 100))
            assert np.all(np.isnan(ds["v_y"].values[:, 2]) == ~slow)
    assert parts["speed"]["v_y"].dims == ("speed", "crossing")
    assert parts["histories"]["v_y"].dims == ("case", "crossing")


@pytest.mark.slow
def test_quick_study_answers_every_claim(tmp_path):
    answers = {}
    for done in paper.reproduce(quick=True):
        answers |= done.outcome.answers
    assert set(answers) == set(CLAIMS)
    # what an independent code and MBDyn agree on; the rest is for the report
    for key in ("N2 motion", "N2 section", "N9 narrow", "N10 period-1", "N12 constant", "N16 A_Z top"):
        assert answers[key].good, (key, answers[key])
