"""Verdicts on made data: they agree where the paper's claims hold, and flagged cases never help a claim."""

import math

import numpy as np
import pytest

from slipperjax.flow.status import Status
from slipperjax.studies.dang2024 import verdicts
from slipperjax.sweeps.follow import Jump

from . import made

UP = Jump(True, 1900.0, 1901.0, 5.0, Status.FINITE)
DOWN = Jump(True, 1791.0, 1790.0, 5.0, Status.FINITE)


@pytest.fixture(autouse=True)
def _fast(monkeypatch):
    monkeypatch.setattr(verdicts, "attractors", made.attractors_once)


def good(answers):
    return {key for key, answer in answers.items() if answer.good}


def test_speeds_as_claimed_are_reproduced():
    found = verdicts.over_speed(made.speeds_as_claimed(), UP, DOWN, 200)
    assert good(found) == set(found) == {"N4 period-3", "N4 period-1", "N4 jump", "N5", "N6", "N7"}
    assert found["N4 period-3"].ours == "three points: 820..970 m/s"
    assert found["N4 period-3"].why.startswith("900 m/s is period-3: recurs")
    assert found["N4 period-1"].ours == "980 m/s"
    assert found["N4 jump"].ours == "1810..1820 m/s from Table 2's start"
    assert "upwards: 1900..1901 m/s, downwards: 1790..1791 m/s" in found["N4 jump"].why
    assert found["N5"].ours == "two points: 820..980 m/s"
    assert found["N6"].ours == "1660..1810 m/s"


def test_speeds_that_differ_are_not_reproduced():
    speeds = made.speeds_as_claimed()
    moved = speeds.assign_coords(speed=speeds["speed"] + 50)
    assert good(verdicts.over_speed(moved, UP, DOWN, 200)) == {"N7"}


def test_chaotic_cases_do_not_count_as_one_point():
    ds = made.speeds_as_claimed()
    slow = ds["speed"] < 820  # chaotic, but too slow to spread over more than a point
    ds["v_y"] = ds["v_y"].where(~slow, 1.0)
    fast = ds["speed"] > 1400  # without these the range of slow cases is the longer one
    ds["v_y"] = ds["v_y"].where(~fast, np.nan)
    found = verdicts.over_speed(ds, UP, DOWN, 200)
    assert found["N4 period-1"].ours == "980 m/s"


@pytest.mark.parametrize("status", [1, 2, 3])
def test_a_flagged_speed_is_neither_uncrossed_nor_a_place(status):
    ds = made.speeds_as_claimed()
    # beside the range in which the roll section is not crossed: its NaN must not lengthen the range
    found = verdicts.over_speed(made.flagged(ds, 1650.0, status), UP, DOWN, 200)
    assert found["N6"].ours == "1660..1810 m/s; 1 of 241 cases flagged"
    assert not found["N6"].good  # the range may begin at the flagged case
    assert good(found) == {"N4 period-3", "N4 period-1", "N4 jump", "N5", "N7"}
    assert all("1 of 241 cases flagged" in answer.ours for answer in found.values())
    # far from every place that a claim names
    found = verdicts.over_speed(made.flagged(ds, [300.0, 1740.0], status), UP, DOWN, 200)
    assert good(found) == set(found)
    assert found["N6"].ours == "1660..1730, 1750..1810 m/s; 2 of 241 cases flagged"
    # whatever its numbers are: DERAILED and UNRESOLVED cases have finite ones
    found = verdicts.over_speed(made.flagged(ds, [300.0, 1400.0], status, 1e9), UP, DOWN, 200)
    assert good(found) == set(found)
    # at the jump
    found = verdicts.over_speed(made.flagged(ds, [1810.0, 1820.0], status), UP, DOWN, 200)
    assert not found["N4 jump"].good
    assert not found["N6"].good


def test_all_speeds_flagged_is_an_answer_and_no_error():
    ds = made.speeds_as_claimed()
    found = verdicts.over_speed(made.flagged(ds, ds["speed"].values), UP, DOWN, 200)
    assert good(found) == set()
    assert found["N4 jump"].ours == "no neighbours to compare; 241 of 241 cases flagged"
    assert found["N7"].ours.startswith("nan and nan times")


@pytest.mark.parametrize(
    ("jump", "text"),
    [
        (UP, "1900..1901 m/s"),
        (DOWN, "1790..1791 m/s"),
        (Jump(False, 2500.0, 2500.0, math.nan, Status.FINITE), "no jump"),
        (Jump(False, 2230.0, 2240.0, math.nan, Status.DERAILED), "search ended at 2240 m/s (derailed"),
    ],
)
def test_the_end_of_a_search_is_told_apart(jump, text):
    assert verdicts.jump_text(jump).startswith(text)
    found = verdicts.over_speed(made.speeds_as_claimed(), jump, UP, 200)
    assert f"followed upwards: {text}" in found["N4 jump"].why


def test_clearances_as_claimed_are_reproduced():
    found = verdicts.over_clearance(made.clearances_as_claimed(), 200)
    assert good(found) == set(found) == {"N10 growth", "N10 period-1", "N10 brief", "N10 pitch", "N11"}
    assert found["N10 growth"].ours.startswith("v_y: r = 1.00")
    assert found["N10 period-1"].ours == "99% period-1"
    assert found["N10 brief"].ours == "1.675 mm not period-1"
    assert found["N10 pitch"].ours == "0.6..2.475 mm"
    assert found["N11"].ours == "not periodic: 2.575..5 mm"


def test_flagged_clearances_are_neither_periodic_nor_chaotic():
    ds = made.clearances_as_claimed()
    found = verdicts.over_clearance(made.flagged(ds, [1.5e-3, 2.4e-3]), 200)
    assert found["N11"].ours == "not periodic: 2.575..5 mm; 2 of 197 cases flagged"
    assert found["N10 brief"].ours == "1.675 mm not period-1; 2 of 197 cases flagged"
    assert good(found) == set(found)
    # the chaotic range begins right after flagged cases, which may be chaotic as well
    found = verdicts.over_clearance(made.flagged(ds, [2.525e-3, 2.55e-3]), 200)
    assert not found["N11"].good
    # with too many flagged cases nothing is said of all of them
    small = ds["clearance"].values[ds["clearance"].values < 2.575e-3]
    found = verdicts.over_clearance(made.flagged(ds, small[::2]), 200)
    assert not found["N10 growth"].good
    assert found["N10 growth"].ours.startswith("v_y: r = 1.00")
    assert not found["N10 period-1"].good
    found = verdicts.over_clearance(made.flagged(ds, small), 200)
    assert found["N10 growth"].ours.startswith("v_y: r = nan")
    assert good(found) == set()


def test_lengths_as_claimed_are_reproduced():
    found = verdicts.over_length(made.lengths_as_claimed(), 200)
    assert good(found) == set(found) == {"N12 chaos", "N12 constant", "N13"}
    assert found["N12 chaos"].ours == "last that is not periodic: 0.15 m"
    assert found["N12 constant"].ours == "spread 0.000 and 0.000 m/s"
    assert found["N13"].ours == "0.1975..0.2275 m"


def test_flagged_lengths_are_neither_periodic_nor_constant():
    ds = made.lengths_as_claimed()
    found = verdicts.over_length(made.flagged(ds, 0.18), 200)
    assert found["N12 chaos"].ours == "last that is not periodic: 0.15 m; 1 of 161 cases flagged"
    assert good(found) == set(found)
    found = verdicts.over_length(made.flagged(ds, 0.3, 2, 1e9), 200)
    assert found["N12 constant"].ours == "spread 0.000 and 0.000 m/s; 1 of 161 cases flagged"
    assert good(found) == set(found)
    found = verdicts.over_length(made.flagged(ds, 0.155), 200)
    assert not found["N12 chaos"].good
    found = verdicts.over_length(made.flagged(ds, np.round(np.arange(0.3, 0.36, 0.0025), 6)), 200)
    assert found["N12 constant"].ours == "spread 0.000 and 0.000 m/s; 24 of 161 cases flagged"
    assert not found["N12 constant"].good  # a sixth of the cases is not known
    late = ds["length"].values[ds["length"].values > 0.16]
    found = verdicts.over_length(made.flagged(ds, late), 200)
    assert found["N12 constant"].ours == f"spread nan and nan m/s; {len(late)} of 161 cases flagged"
    assert not found["N12 constant"].good
    assert not found["N13"].good


def test_a_velocity_that_varies_with_length_is_not_constant():
    ds = made.lengths_as_claimed()
    ds["v_z"] = ds["v_z"] + ds["length"]
    found = verdicts.over_length(ds, 200)
    assert not found["N12 constant"].good


def test_exponents_over_speed():
    speeds = np.arange(100.0, 2501.0, 10.0)
    window = (speeds == 480) | (speeds == 490)
    ds = made.exponents("speed", speeds, ((speeds < 850) & ~window) | (speeds > 1810))
    found = verdicts.exponents_over_speed(ds)
    assert good(found) == set(found) == {"N8 window", "N8 low", "N8 high"}
    assert found["N8 window"].ours == "not above zero: 480..490 m/s"
    assert found["N8 low"].ours == "97% of the cases"
    assert found["N8 high"].why == "100% of the cases resolved by their certificates"
    # flagged cases, whose exponents are NaN, are not calm
    lost = verdicts.exponents_over_speed(made.flagged(ds, [300.0, 310.0]))
    assert lost["N8 window"].ours == "not above zero: 480..490 m/s; 2 of 241 cases flagged"
    assert lost["N8 low"].ours == "95% of the cases; 2 of 241 cases flagged"
    assert good(lost) == set(lost)
    # nor are they chaotic where they have numbers
    some = verdicts.exponents_over_speed(made.flagged(ds, [300.0, 310.0], 3, 0.5).assign(stderr=ds["stderr"]))
    assert some["N8 low"].ours == lost["N8 low"].ours
    # at the window's edge they may be calm
    assert "N8 window" not in good(verdicts.exponents_over_speed(made.flagged(ds, [470.0])))
    # and they count against a claim about nearly all cases
    many = verdicts.exponents_over_speed(made.flagged(ds, speeds[:10]))
    assert many["N8 low"].ours.startswith("84% of the cases")
    assert good(many) == {"N8 window", "N8 high"}


def test_an_exponent_that_is_not_finite_is_flagged_whatever_its_status():
    speeds = np.arange(100.0, 2501.0, 10.0)
    ds = made.exponents("speed", speeds, speeds > 0)
    ds["exponent"][3, 0] = np.nan
    ds["stderr"][5, 0] = np.inf
    found = verdicts.exponents_over_speed(ds)
    assert found["N8 window"].ours == "not above zero: nowhere m/s; 2 of 241 cases flagged"


def test_the_rule_of_three_standard_errors_decides():
    speeds = np.arange(100.0, 2501.0, 10.0)
    ds = made.exponents("speed", speeds, speeds > 0)
    ds["stderr"][:, 0] = np.where(speeds == 200, 0.034, np.where(speeds == 210, 0.033, 0.01))
    ds["exponent"][20, 0] = 0.9e-3
    ds["stderr"][20, 0] = 1e-6
    assert verdicts.exponents_over_speed(ds)["N8 window"].ours == "not above zero: 200, 300 m/s"


def test_exponents_over_clearance():
    c = np.round(np.arange(0.1, 5.01, 0.025), 6)
    ds = made.exponents("clearance", c * 1e-3, (np.abs(c - 1.675) < 0.01) | (c >= 2.575))
    found = verdicts.exponents_over_clearance(ds)
    assert good(found) == set(found) == {"N11 LLE brief", "N11 LLE"}
    assert found["N11 LLE brief"].ours == "1.675 mm"
    assert found["N11 LLE"].ours == "2.575..5 mm"
    lost = verdicts.exponents_over_clearance(made.flagged(ds, [1.675e-3, 2.575e-3]))
    assert good(lost) == set()
    assert lost["N11 LLE brief"].ours == "nowhere mm; 2 of 197 cases flagged"
    assert lost["N11 LLE"].ours == "2.6..5 mm; 2 of 197 cases flagged"


def test_exponents_over_length():
    length = np.round(np.arange(0.1, 0.5001, 0.0025), 6)
    ds = made.exponents("length", length, length <= 0.15)
    (found,) = verdicts.exponents_over_length(ds).values()
    assert found == ("last at 0.15 m", True, "100% of the cases resolved by their certificates")
    (lost,) = verdicts.exponents_over_length(made.flagged(ds, 0.1525)).values()
    assert lost.ours == "last at 0.15 m; 1 of 161 cases flagged"
    assert not lost.good
    (lost,) = verdicts.exponents_over_length(made.flagged(ds, 0.18, 3, 0.5).assign(stderr=ds["stderr"])).values()
    assert lost[:2] == ("last at 0.15 m; 1 of 161 cases flagged", True)
    (calm,) = verdicts.exponents_over_length(made.exponents("length", length, length < 0)).values()
    assert calm[:2] == ("nowhere", False)


def test_single_cases_as_claimed_are_reproduced():
    history, sections = made.singles()
    found = verdicts.histories(history, sections, 200)
    assert good(found) == set(found)
    assert len(found) == 16
    assert found["N1 lines"].ours == "f: True, 2f/3: True"
    assert found["N3 line"].ours == "0.4 f"
    assert found["N14 C2 0.4"].ours == "12824 N"
    assert found["N15"].ours == "1977 against 4256 N, 8807 against 12824 N, 5447 against 20365 N"


def test_a_flagged_single_case_takes_its_own_answers_alone():
    history, sections = made.singles()
    history["status"][2] = 1
    history["alpha_x"][2] = np.nan
    sections["status"][5] = 3
    found = verdicts.histories(history, sections, 200)
    lost = {"N3 motion", "N3 line", "N14 A2 0.1", "N14 C2 0.1", "N14 J2 0.1", "N15"}
    assert set(found) - good(found) == lost
    assert found["N3 line"].ours == "1 of 1 cases flagged"
    assert found["N3 line"].why.startswith("not finite")
    assert found["N15"].ours == "1 of 2 cases flagged"
    assert found["N15"].why.startswith("unresolved")


def test_lines_of_two_waves():
    ds, found = verdicts.dual_frequency(made.two_waves())
    assert good(found) == set(found)
    assert found["N16 A_Z top"].ours == "150.0 Hz"
    assert found["N16 alpha_Y"].ours == "13 of 13"
    assert ds["a_z_density"].dims == ("frequency",)
    assert ds["alpha_x_density"].attrs["units"] == "(rad/s^2)^2/Hz"
    lost = made.two_waves()
    lost["status"][0] = 2
    ds, found = verdicts.dual_frequency(lost)
    assert good(found) == set()
    assert found["N16 A_Z"].ours == "1 of 1 cases flagged"
    assert "a_z_density" not in ds
