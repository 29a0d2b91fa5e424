"""Branches of periodic orbits behind the paper's diagrams, and what their events say about its claims.

A diagram shows where one start ends up; a branch shows which motions there are. Where a motion disappears from a
diagram, either its branch ends or turns unstable, at an event with a name, or the branch goes on and the start leads
elsewhere.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...analysis.events import MEANINGS
from ...flow.simulate import simulate
from ...flow.status import Status
from ...model.dang2024 import paper_scene
from ...model.layout import coordinates
from ...model.parameters import PARAMETERS
from ...model.quantities import COORDINATE_SCALES, COORDINATES
from ...model.scene import Scene
from ...orbits.branches import BranchEvent, OrbitBranch, continue_orbit
from ...orbits.periodic import PeriodicOrbit, periodic_orbit
from .claims import runs

STEPS = 200
"""Steps per forcing period, with which the places of events agree to five digits with those of 400 steps."""
BOUNDS = {"speed": (900.0, 2300.0), "clearance": (0.1e-3, 5e-3), "length": (0.1, 0.5)}
"""Within which the branches through the paper's nominal case are followed [SI unit of the parameter]."""
NOMINAL = {"speed": 1250.0, "clearance": 1e-3, "length": 0.2}
"""That case [SI units]."""
SLOWEST = 800.0
"""Speed [m/s] to which orbits of twice the period are followed."""
JUMP = 1810.0
"""Speed [m/s] at which the paper sees the motion leave the branch."""
BRIEF, BESIDE = 1.675e-3, 0.1e-3
"""Clearance of the paper's brief bifurcation, and how far from it events are looked for [m]."""
OBSERVED = {"observed": 4e-3, "beyond": 3.8e-3}
"""Clearances [m] at which the motion from Table 2's start is followed as well: that of the paper's Fig. 7, at which
it sees no periodic motion, and one beyond the end of the stable orbits from 1 mm."""
SIMULATED = 100
"""Steps per forcing period of that motion, as in the study's diagrams."""
PATIENCE, BLOCK = 4, 500
"""Most blocks of forcing periods in which a motion at `OBSERVED` may come to rest on an orbit."""
LONGEST = 4
"""Longest period that is tried there [forcing periods]."""
CLOSE = 1e-2
"""Distance of a motion from an orbit at which it has settled there, in units of 1 mm, 10 mrad, 1 m/s, 10 rad/s."""
DIGITS = {"speed": 1, "clearance": 3, "length": 4}
"""Digits after the point with which values of a parameter are written, in its display unit."""
NAMES = {label: text.partition(":")[0] for label, text in MEANINGS.items()} | {"EP": "bound", "MX": "no convergence"}
CRITICAL = ("LP", "PD", "NS", "BP")
"""Events at which a stable orbit turns unstable."""
LIKELY = (*CRITICAL, "GR", "EP", "MX")
"""Events at the edge of a stable part: which of several ends it, the likeliest first."""

Branches = dict[str, OrbitBranch]
"""Branches over one parameter: `branch` through the nominal case, `period_2` and so on, and `observed`."""


# --- computing them -------------------------------------------------------------------------------------------------


def observed_orbit(scene: Scene) -> tuple[PeriodicOrbit, int] | None:
    """The stable orbit on which the motion from Table 2's start comes to rest, and the forcing periods simulated.

    None where it comes to rest on none within `PATIENCE` blocks of `BLOCK` forcing periods.
    """
    run = None
    for block in range(1, PATIENCE + 1):
        run = simulate(scene, BLOCK, start=run, steps_per_period=SIMULATED, saves_per_period=1, loads=False)
        ds = run.to_xarray()
        passed = np.stack([ds[name].values for name in COORDINATES], axis=-1) / COORDINATE_SCALES
        for period in range(1, LONGEST + 1):
            if np.max(np.abs(passed[-1] - passed[-1 - period])) > CLOSE:
                continue  # Newton's method is costly where the motion does not recur
            orbit = periodic_orbit(scene, period, start=run, steps_per_period=SIMULATED)
            # Newton's method may find an orbit elsewhere, on which the motion never comes to rest
            away = np.abs(coordinates(orbit.state) - coordinates(run.end)) / COORDINATE_SCALES
            if orbit.status == Status.FINITE and orbit.stable and np.max(away) < CLOSE:
                return orbit, block * BLOCK
    return None


def follow_branches(name: str, flips: int, observed: bool, data: dict[str, Any], options: dict[str, Any]) -> Branches:
    """The branches over one parameter. Their datasets are added to `data` as soon as each is finished.

    **Arguments:** `flips`: how often the branch is left for one of twice the period; `observed`: whether the motions
    at `OBSERVED` are followed as well, which takes a minute; `options`: `progress`.
    """
    branches: Branches = {}

    def keep(kind: str, branch: OrbitBranch) -> OrbitBranch:
        branches[kind] = branch
        data[f"{name}_{kind}"] = branch.points
        return branch

    branch = keep("branch", continue_orbit(paper_scene(), name, BOUNDS[name], steps_per_period=STEPS, **options))
    at = NOMINAL[name]
    for _ in range(flips if name == "speed" else 0):
        part = stable_part(branch, name, at)
        if part is None or part.low.event is None or part.low.event.label != "PD":
            break
        at = part.low.value
        try:
            branch = branch.switched(part.low.event, bounds=(SLOWEST, BOUNDS[name][1]), **options)
        except ValueError:  # no orbit of twice the period was found beside the flip
            break
        keep(f"period_{branch.period}", branch)
    for kind, value in OBSERVED.items() if observed and name == "clearance" else ():
        settled = observed_orbit(paper_scene(clearance=value))
        if settled is not None:
            orbit, waited = settled
            more = dict(start=orbit.state, period=orbit.period, steps_per_period=STEPS, **options)
            branch = continue_orbit(orbit.scene, name, BOUNDS[name], **more)
            branch.points.attrs["settled_within"] = waited
            keep(kind, branch)
    return branches


# --- what they say --------------------------------------------------------------------------------------------------


class Edge(NamedTuple):
    """Where a stable part of a branch ends."""

    value: float
    """The parameter's value [SI unit]."""
    event: BranchEvent | None
    """Label of the event there; None at the first orbit of a branch that begins at another one's flip."""


class Part(NamedTuple):
    """A stable part of a branch."""

    low: Edge
    high: Edge
    points: np.ndarray
    """Places of its orbits among the branch's points, with rising values of the parameter."""


def stable_part(branch: OrbitBranch, name: str, at: float) -> Part | None:
    """The stable part of a branch over the parameter `name` that holds its orbit nearest to `at` [SI unit].

    None where no orbit is stable.
    """
    ds = branch.points
    values, labels = ds[name].values, ds["label"].values.astype(str)
    stable = ds["stable"].values.astype(bool)
    # an orbit at an event has a multiplier on the circle, and rounding decides on which side
    sure = np.flatnonzero(stable & (labels == ""))
    if not sure.size:
        return None
    middle = int(sure[np.argmin(np.abs(values[sure] - at))])
    ends, edges = [], []
    for way in (-1, 1):
        # to the last orbit that is surely stable, and to the last event beyond it
        last = beyond = middle
        while 0 <= beyond + way < len(labels) and (stable[beyond + way] or labels[beyond + way]):
            beyond += way
            if labels[beyond] in CRITICAL:
                break
            last = last if labels[beyond] else beyond
        events = [event for event in branch.events if min(last, beyond) <= event.point <= max(last, beyond)]
        likeliest = min(events, key=lambda event: LIKELY.index(event.label), default=None)
        edges.append(Edge(float(values[last]) if likeliest is None else likeliest.value, likeliest))
        ends.append(last)
    low, high = sorted(edges, key=lambda edge: edge.value)
    points = np.arange(ends[0], ends[1] + 1)
    return Part(low, high, points[np.argsort(values[points], kind="stable")])


def place(name: str, value: float) -> str:
    """A value of a parameter [SI unit] as text with its unit."""
    q = PARAMETERS[name]
    return f"{q.shown(value):.{DIGITS[name]}f} {q.display_unit}"


def edge_text(name: str, edge: Edge) -> str:
    """An edge in words."""
    if edge.event is None:
        return place(name, edge.value)
    label = edge.event.label
    return f"{place(name, edge.value)} ({NAMES[label]}{'' if label in ('EP', 'MX') else f', {label}'})"


def part_text(name: str, part: Part | None) -> str:
    """A stable part in words."""
    if part is None:
        return "stable nowhere"
    return f"stable from {edge_text(name, part.low)} to {edge_text(name, part.high)}"


def crossed(branch: OrbitBranch, name: str, part: Part, section: str, times: int) -> str:
    """Where the stable orbits cross a section so many times in their period, in words.

    The number changes somewhere between two neighbouring orbits of the branch, which are both named.
    """
    ds = branch.points.isel(point=part.points)
    hits = np.isfinite(ds[section].transpose("point", "crossing").values).sum(axis=1) == times
    values, last = ds[name].values, len(hits) - 1

    def between(a: int, b: int) -> str:
        first, second = (place(name, values[min(max(k, 0), last)]) for k in (a, b))
        return first if first == second else f"{first.partition(' ')[0]}..{second}"

    ranges = [(int(a), int(b)) for a, b in runs(hits, np.arange(len(hits)))]
    return " and ".join(f"from {between(a - 1, a)} to {between(b, b + 1)}" for a, b in ranges) or "nowhere"


def over_speed(branches: Branches) -> dict[str, str]:
    """Answers the claims by the branches over speed, by key."""
    branch, name = branches["branch"], "speed"
    part = stable_part(branch, name, NOMINAL[name])
    answers = {"N4 period-1": f"orbits of period 1: {part_text(name, part)}"}
    if part is None:
        return answers
    if part.high.value > JUMP:
        answers["N4 jump"] = (
            f"the branch does not end there, only the set of starts that lead to it: it is {part_text(name, part)}"
        )
    else:
        answers["N4 jump"] = f"the branch is {part_text(name, part)}"
    answers["N6"] = f"stable orbits without a crossing: {crossed(branch, name, part, 'w_x', 0)}"
    doubled: list[str] = []
    twice = [one for kind, one in branches.items() if kind.startswith("period_")]
    for one in sorted(twice, key=lambda one: one.period):
        period = one.period
        stable = stable_part(one, name, part.low.value)
        doubled.append(f"orbits of period {period}: {part_text(name, stable)}")
        if period == 2 and stable is not None:
            answers["N5"] = (
                f"orbits of period 2 are {part_text(name, stable)}; with two points: "
                f"{crossed(one, name, stable, 'v_z', 2)}"
            )
            doubled[-1] += f", where their points are {_apart(one, stable, 'v_y'):.2g} m/s apart in V_Y"
    if doubled:
        answers["N4 period-1"] += "; " + "; ".join(doubled)
        answers["N4 period-3"] = "; ".join(doubled)
    return answers


def _apart(branch: OrbitBranch, part: Part, section: str) -> float:
    """Greatest distance between the points of a stable orbit on a section [SI unit]."""
    values = branch.points[section].transpose("point", "crossing").values[part.points]
    spans = [np.ptp(row[np.isfinite(row)]) for row in values if np.isfinite(row).any()]
    return float(max(spans, default=np.nan))


def over_clearance(branches: Branches) -> dict[str, str]:
    """Answers the claims by the branches over clearance, by key."""
    branch, name = branches["branch"], "clearance"
    part = stable_part(branch, name, NOMINAL[name])
    first = f"orbits of period 1: {part_text(name, part)}"
    answers = {"N10 period-1": first, "N11": first}
    if part is None:
        return answers
    if not [event for event in branch.events if abs(event.value - BRIEF) < BESIDE]:
        reach = f"{place(name, BRIEF - BESIDE)} to {place(name, BRIEF + BESIDE)}"
        answers["N10 brief"] = f"no event on the branch of period 1 from {reach}"
    answers["N10 pitch"] = f"stable orbits with two crossings: {crossed(branch, name, part, 'w_y', 2)}"
    others = {kind: value for kind, value in OBSERVED.items() if kind in branches}
    for kind, value in others.items():
        text = _other(branches[kind], name, value)
        answers["N11"] += f"; at {place(name, value)} from Table 2's start: {text}"
        if kind == "observed":
            first = "stable" if part.high.value > value else "unstable"
            answers["N9 wide"] = f"{text}; the orbit of the branch from 1 mm is {first} there"
    if "beyond" in others and "N9 wide" in answers:
        other = branches["beyond"]
        text = part_text(name, stable_part(other, name, OBSERVED["beyond"]))
        answers["N9 wide"] += f"; orbits of period {other.period}, met at {place(name, OBSERVED['beyond'])}: {text}"
    return answers


def _other(branch: OrbitBranch, name: str, at: float) -> str:
    """A branch on which a motion settles at a value of the parameter, in words."""
    ds = branch.points
    away = np.where(ds["stable"].values.astype(bool), np.abs(ds[name].values - at), np.inf)
    waited, signature = ds.attrs["settled_within"], ds["signature"].values[np.argmin(away)]
    return (
        f"settled within {waited} forcing periods on orbits of period {branch.period}, "
        f"{part_text(name, stable_part(branch, name, at))}, touchdowns {signature}"
    )


def over_length(branches: Branches) -> dict[str, str]:
    """Answers the claims by the branch over length, by key."""
    branch, name = branches["branch"], "length"
    part = stable_part(branch, name, NOMINAL[name])
    answers = {"N12 chaos": f"orbits of period 1: {part_text(name, part)}"}
    if part is not None:
        answers["N12 constant"] = answers["N12 chaos"]
        answers["N13"] = f"stable orbits with two crossings: {crossed(branch, name, part, 'w_y', 2)}"
    return answers


OVER: dict[str, Callable[[Branches], dict[str, str]]] = {
    "speed": over_speed,
    "clearance": over_clearance,
    "length": over_length,
}
"""Functions from branches to answers, by parameter."""
