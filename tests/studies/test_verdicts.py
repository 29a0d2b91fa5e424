"""Verdicts on made data: they agree where the paper's claims hold, and flagged cases never help a claim."""

import functools
import math

import numpy as np
import pytest

from slipperjax.studies.dang2024 import verdicts
from slipperjax.studies.dang2024.claims import answers
from slipperjax.studies.dang2024.verdicts import Diagram, Singles, section_points, unbroken_ranges

from . import made

SPEEDS = np.arange(100.0, 2501.0, 10.0)
CLEARANCES = np.round(np.arange(0.1, 5.01, 0.025), 6)
LENGTHS = np.round(np.arange(0.1, 0.5001, 0.0025), 6)
CALM = (SPEEDS == 480) | (SPEEDS == 490)
WILD = (np.abs(CLEARANCES - 1.675) < 0.01) | (CLEARANCES >= 2.575)
RUNS = {
    "speed": made.speeds_as_claimed,
    "clearance": made.clearances_as_claimed,
    "length": made.lengths_as_claimed,
    "speed_exponents": lambda: made.exponents("speed", SPEEDS, (SPEEDS < 850) & ~CALM | (SPEEDS > 1810)),
    "clearance_exponents": lambda: made.exponents("clearance", CLEARANCES * 1e-3, WILD),
    "length_exponents": lambda: made.exponents("length", LENGTHS, LENGTHS <= 0.15),
}
"""How each run's data are made as the paper has them."""


@pytest.fixture(autouse=True)
def _fast(monkeypatch):
    monkeypatch.setattr(verdicts, "attractors", made.attractors_once)


@functools.cache
def data_of(run):
    return RUNS[run]()


def answered(run, ds):
    return answers(run, Diagram(ds, run.removesuffix("_exponents"), 200))


def good(answers):
    return {key for key, answer in answers.items() if answer.good}


def check(found, lost, texts):
    """All claims but the lost ones are reproduced, and answers are or begin with the texts."""
    assert set(found) - good(found) == set(lost)
    for key, text in texts.items():
        assert found[key].ours == text or (text.endswith("...") and found[key].ours.startswith(text[:-3])), found[key]


AS_CLAIMED = {
    "speed": {
        "N4 period-3": "820..970 m/s",
        "N4 period-1": "980..1810 m/s",
        "N4 jump": "1810..1820 m/s",
        "N5": "820..980 m/s",
        "N6": "1660..1810 m/s",
        "N7": "...",
    },
    "clearance": {
        "N10 growth": "v_y: r = 1.00...",
        "N10 period-1": "99% of the cases",
        "N10 brief": "1.675 mm",
        "N10 pitch": "0.6..2.475 mm",
        "N11": "2.575..5 mm",
    },
    "length": {
        "N12 chaos": "0.1..0.15 m",
        "N12 constant": "spread 0.000 and 0.000 m/s",
        "N13": "0.1975..0.2275 m",
    },
    "speed_exponents": {"N8 window": "480..490...", "N8 low": "97% of the cases", "N8 high": "..."},
    "clearance_exponents": {"N11 LLE brief": "1.675 mm", "N11 LLE": "2.575..5 mm"},
    "length_exponents": {"N12 LLE": "0.1..0.15 m"},
}


@pytest.mark.parametrize("run", AS_CLAIMED)
def test_speeds_as_claimed_and_others_are_reproduced(run):
    found = answered(run, data_of(run))
    assert set(found) == set(AS_CLAIMED[run])
    check(found, (), AS_CLAIMED[run])
    evidence = "100% of the cases resolved by their certificates" if "exponents" in run else ""
    assert {answer.why for answer in found.values()} == {evidence}


NAN = math.nan
SMALL = CLEARANCES[CLEARANCES < 2.575] * 1e-3


@pytest.mark.parametrize(
    ("run", "at", "status", "number", "lost", "texts"),
    [
        # beside the range in which the roll section is not crossed, which may begin at the flagged case
        ("speed", 1650.0, 2, NAN, {"N6"}, {"N6": "1660..1810 m/s"}),
        # far from every place that a claim names
        ("speed", [300.0, 1740.0], 3, NAN, (), {"N6": "1660..1730, 1750..1810 m/s"}),
        # whatever its numbers are: DERAILED and TOO_FEW_STEPS cases have finite ones
        ("speed", [300.0, 1400.0], 2, 1e9, (), {}),
        (
            *("speed", SPEEDS, 1, NAN, {"N4 period-3", "N4 period-1", "N4 jump", "N5", "N6", "N7"}),
            {"N4 jump": "no neighbours to compare", "N7": "nan and nan times..."},
        ),
        (
            *("clearance", [1.5e-3, 2.4e-3], 1, NAN, ()),
            {"N11": "2.575..5 mm", "N10 brief": "1.675 mm"},
        ),
        # the chaotic range begins right after flagged cases, which may be chaotic as well
        ("clearance", [2.525e-3, 2.55e-3], 1, NAN, {"N11"}, {}),
        # with too many flagged cases nothing is said of all of them
        (
            *("clearance", SMALL[::2], 1, NAN, {"N10 growth", "N10 period-1", "N10 pitch", "N11"}),
            {"N10 growth": "v_y: r = 1.00..."},
        ),
        ("length", 0.3, 2, 1e9, (), {"N12 constant": "spread 0.000 and 0.000 m/s"}),
        # a sixth of the cases is not known
        ("length", LENGTHS[80:104], 1, NAN, {"N12 constant"}, {"N12 constant": "spread 0.000 and 0.000 m/s"}),
        # exponents that are NaN are not calm, nor chaotic where they are numbers
        (
            *("speed_exponents", [300.0, 310.0], 1, NAN, ()),
            {"N8 window": "480..490...", "N8 low": "95% of the cases"},
        ),
        ("speed_exponents", [300.0, 310.0], 3, 0.5, (), {"N8 low": "95% of the cases"}),
        # at the window's edge they may be calm, and many count against a claim about nearly all
        ("speed_exponents", 470.0, 1, NAN, {"N8 window"}, {}),
        ("speed_exponents", SPEEDS[:10], 1, NAN, {"N8 low"}, {"N8 low": "84% of the cases..."}),
        (
            *("clearance_exponents", [1.675e-3, 2.575e-3], 1, NAN, {"N11 LLE brief", "N11 LLE"}),
            {"N11 LLE brief": "nowhere", "N11 LLE": "2.6..5 mm"},
        ),
        ("length_exponents", 0.1525, 1, NAN, {"N12 LLE"}, {"N12 LLE": "0.1..0.15 m"}),
    ],
)
def test_a_flagged_speed_or_another_case_supports_no_claim(run, at, status, number, lost, texts):
    ds = data_of(run)
    found = answered(run, made.flagged(ds, at, status, number))
    marked = f"; {np.size(at)} of {ds['status'].size} cases flagged"
    assert all(answer.ours.endswith(marked) for answer in found.values())
    check(found, lost, {key: text if text.endswith("...") else text + marked for key, text in texts.items()})


def test_data_that_differ_are_not_reproduced():
    speeds, lengths = made.speeds_as_claimed(), made.lengths_as_claimed()
    assert good(answered("speed", speeds.assign_coords(speed=speeds["speed"] + 50))) == {"N7"}
    lengths["v_z"] = lengths["v_z"] + lengths["length"]
    check(answered("length", lengths), {"N12 constant"}, {})
    calm = made.exponents("length", LENGTHS, LENGTHS < 0)
    check(answered("length_exponents", calm), {"N12 LLE"}, {"N12 LLE": "nowhere"})


def test_exponents_that_are_not_finite_or_not_certain_are_not_positive():
    ds = made.exponents("speed", SPEEDS, SPEEDS > 0)
    ds["exponent"][3, 0], ds["stderr"][5, 0] = np.nan, np.inf
    assert answered("speed_exponents", ds)["N8 window"].ours == "nowhere; 2 of 241 cases flagged"
    ds = made.exponents("speed", SPEEDS, SPEEDS > 0)  # three standard errors decide
    ds["stderr"][:, 0] = np.where(SPEEDS == 200, 0.034, np.where(SPEEDS == 210, 0.033, 0.01))
    ds["exponent"][20, 0], ds["stderr"][20, 0] = 0.9e-3, 1e-6
    assert answered("speed_exponents", ds)["N8 window"].ours == "200, 300 m/s"


def test_single_cases_take_their_own_answers_alone():
    history, sections = made.singles()
    forcing = sections["speed"].values / 8
    found = answers("histories", Singles(history, forcing, sections, 200))
    assert len(found) == 16
    texts = {
        "N1 lines": "2 of 2",
        "N2 motion": "period-1, lines: 2 of 2",
        "N3 line": "0.4 f",
        "N14 C2 0.4": "12824 N",
    }
    texts["N15"] = "1977 against 4256 N, 8807 against 12824 N, 5447 against 20365 N"
    check(found, (), texts)
    history["status"][2], sections["status"][5] = 1, 3
    history["alpha_x"][2] = np.nan
    found = answers("histories", Singles(history, forcing, sections, 200))
    lost = {"N3 motion", "N3 line", "N14 A2 0.1", "N14 C2 0.1", "N14 J2 0.1", "N15"}
    check(found, lost, {"N3 line": "1 of 1 cases flagged", "N15": "1 of 2 cases flagged"})
    assert found["N3 line"].why.startswith("not finite")
    assert found["N15"].why.startswith("too few steps")


def test_lines_of_two_waves():
    found = answers("dual", Singles(made.two_waves(), [150.0]))
    check(found, (), {"N16 A_Z top": "1 f", "N16 alpha_Y": "13 of 13"})
    lost = made.two_waves()
    lost["status"][0] = 2
    found = answers("dual", Singles(lost, [150.0]))
    check(found, set(found), {"N16 A_Z": "1 of 1 cases flagged"})


def test_ranges_and_points():
    assert unbroken_ranges(np.array([True, True, False, False, True]), np.arange(1.0, 6.0)) == [
        (1.0, 2.0),
        (5.0, 5.0),
    ]
    assert unbroken_ranges(np.zeros(5, bool), np.arange(5.0)) == []
    nan = np.nan
    values = np.array([[1.0, 1.0, 1.001, nan], [1.0, 3.0, 1.0, 3.0], [nan] * 4, [0.0, 1.0, 2.0, 4.0]])
    assert section_points(values).tolist() == [1, 2, 0, 4]
    assert section_points(np.full((2, 3), nan)).tolist() == [0, 0]
