"""Evidence from branches of orbits, on made branches with known events and on computed ones."""

import numpy as np
import pytest

from slipperjax import load_branch
from slipperjax.studies.dang2024 import branches
from slipperjax.studies.dang2024.claims import CLAIMS, Answer, supported

from . import made


def labels(part):
    return [edge.event.label if edge.event else None for edge in (part.low, part.high)]


def test_a_stable_part_ends_at_events():
    first = made.speed_branches()["branch"]
    part = branches.stable_part(first, "speed", 1250.0)
    assert [part.low.value, part.high.value] == [1100.0, 2200.0]
    assert labels(part) == ["PD", "LP"]
    assert first.points["speed"].values[part.points].tolist() == [1200.0, 1600.0, 1700.0, 2000.0]
    assert branches.part_text("speed", part) == "stable from 1100.0 m/s (flip, PD) to 2200.0 m/s (fold, LP)"


@pytest.mark.parametrize("turned", [False, True])
def test_grazings_do_not_end_a_stable_part_that_goes_on(turned):
    values, stable = np.arange(6.0), np.array([1, 1, 1, 1, 0, 0])
    events = [("EP", 0), ("GR", 2), ("NS", 4)]
    if turned:
        values, stable, events = values[::-1], stable[::-1], [(label, 5 - k) for label, k in events]
    part = branches.stable_part(made.branch("length", values, stable, events), "length", 1.2)
    assert [part.low.value, part.high.value] == [0.0, 4.0]
    assert labels(part) == ["EP", "NS"]
    assert branches.part_text("length", part) == "stable from 0.0000 m (bound) to 4.0000 m (Neimark-Sacker, NS)"


def test_of_several_stable_parts_the_nearest_is_taken():
    ds = made.branch("length", [0.1, 0.2, 0.3, 0.4, 0.5], [1, 0, 0, 1, 1], [("PD", 1), ("NS", 2)])
    at = lambda value: branches.stable_part(ds, "length", value)
    assert [edge.value for edge in (at(0.11).low, at(0.11).high)] == [0.1, 0.2]
    assert [edge.value for edge in (at(0.38).low, at(0.38).high)] == [0.3, 0.5]
    assert at(0.38).high.event is None
    assert branches.stable_part(made.branch("length", [1.0, 2.0], [0, 0]), "length", 1.0) is None


def test_stability_that_only_a_grazing_ends():
    ds = made.branch("speed", [1.0, 2.0, 3.0, 4.0], [1, 1, 1, 0], [("GR", 2)])
    assert labels(branches.stable_part(ds, "speed", 1.0)) == [None, "GR"]


def test_speeds_are_explained():
    found = branches.over_speed(made.speed_branches())
    assert set(found) <= set(CLAIMS)
    assert found["N4 jump"] == (
        "the branch does not end there, only the set of starts that lead to it: "
        "it is stable from 1100.0 m/s (flip, PD) to 2200.0 m/s (fold, LP)"
    )
    assert "orbits of period 2: stable from 970.0 m/s (flip, PD) to 1080.0 m/s" in found["N4 period-3"]
    assert "points are 0.5 m/s apart in V_Y" in found["N4 period-3"]
    assert found["N5"].endswith("with two points: from 1000.0 m/s to 1080.0 m/s")
    assert found["N6"] == "stable orbits without a crossing: from 1600.0..1700.0 m/s to 2000.0 m/s"


def test_a_branch_that_ends_before_the_jump_is_said_to():
    early = made.branch("speed", [1200.0, 1300.0, 1500.0], [1, 1, 0], [("LP", 2)])
    found = branches.over_speed({"branch": early})
    assert found["N4 jump"] == "the branch is stable from 1200.0 m/s to 1500.0 m/s (fold, LP)"
    assert "N5" not in found
    nowhere = made.branch("speed", [1200.0, 1300.0], [0, 0])
    assert branches.over_speed({"branch": nowhere}) == {"N4 period-1": "orbits of period 1: stable nowhere"}


def test_clearances_are_explained():
    both = made.clearance_branches()
    first = both["branch"]
    found = branches.over_clearance({"branch": first})
    assert found["N10 brief"] == "no event on the branch of period 1 from 1.575 mm to 1.775 mm"
    assert found["N10 pitch"] == "stable orbits with two crossings: from 0.600..0.800 mm to 1.000..2.000 mm"
    assert found["N11"] == "orbits of period 1: stable from 0.100 mm (bound) to 3.200 mm (Neimark-Sacker, NS)"
    assert "N9 wide" not in found
    found = branches.over_clearance(both)
    text = (
        "settled within 500 forcing periods on orbits of period 1, "
        "stable from 3.100 mm (flip, PD) to 4.500 mm (Neimark-Sacker, NS), touchdowns A1 B2"
    )
    assert found["N11"].endswith(f"; at 4.000 mm from Table 2's start: {text}")
    assert found["N9 wide"] == f"{text}; the orbit of the branch from 1 mm is unstable there"
    found = branches.over_clearance(both | {"beyond": both["observed"]})
    assert found["N9 wide"].endswith(
        "; orbits of period 1, met at 3.800 mm: stable from 3.100 mm (flip, PD) to 4.500 mm (Neimark-Sacker, NS)"
    )
    near = made.branch("clearance", [1e-3, 1.7e-3, 2e-3], [1, 1, 1], [("GR", 1)])
    assert "N10 brief" not in branches.over_clearance({"branch": near})


def test_lengths_are_explained():
    pitch = {"w_y": [1, 1, 2, 1, 1]}
    ds = made.branch("length", [0.1, 0.15, 0.2, 0.3, 0.5], [0, 1, 1, 1, 1], [("NS", 0), ("EP", 4)], sections=pitch)
    found = branches.over_length({"branch": ds})
    assert found["N12 chaos"].endswith("stable from 0.1000 m (Neimark-Sacker, NS) to 0.5000 m (bound)")
    assert found["N13"] == "stable orbits with two crossings: from 0.1500..0.2000 m to 0.2000..0.3000 m"


def test_evidence_is_added_and_changes_no_verdict():
    answers = {"N13": Answer("here", False, "why"), "N5": Answer("there", True)}
    found = supported(answers, {"N13": "more", "N5": "new", "N6": "nobody asked"})
    assert found == {"N13": Answer("here", False, "why; more"), "N5": Answer("there", True, "new")}


@pytest.mark.slow
def test_speed_branches_have_the_known_events():
    data = {}
    found = branches.follow_branches("speed", 1, False, data, {})
    assert set(data) == {"speed_branch", "speed_period_2"}
    part = branches.stable_part(found["branch"], "speed", 1250.0)
    assert labels(part) == ["PD", "LP"]
    # at 400 steps 1095.9120 and 2234.7236
    assert [part.low.value, part.high.value] == pytest.approx([1095.9106, 2234.7235], abs=2e-4)
    twice = branches.stable_part(load_branch(data["speed_period_2"]), "speed", 1090.0)
    assert labels(twice)[0] == "PD"
    assert twice.low.value == pytest.approx(969.694, abs=2e-3)


@pytest.mark.slow
def test_wide_slippers_settle_on_other_branches():
    data = {}
    found = branches.follow_branches("clearance", 0, True, data, {})
    first = branches.stable_part(found["branch"], "clearance", 1e-3)
    assert labels(first) == ["EP", "NS"]
    assert first.high.value == pytest.approx(3.196205e-3, abs=1e-8)  # at 400 steps 3.196255e-3
    # which of two orbits is met at 4 mm is decided by a long transient, and so by rounding
    assert found["observed"].period in (1, 3)
    beyond = branches.stable_part(found["beyond"], "clearance", 3.8e-3)
    assert found["beyond"].period == 1
    assert labels(beyond) == ["PD", "NS"]
    assert [beyond.low.value, beyond.high.value] == pytest.approx([3.195053e-3, 4.471672e-3], abs=1e-8)
