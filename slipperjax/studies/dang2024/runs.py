"""The runs of the study of Dang et al. 2024, from which its figures and answers are made.

`reproduce` does the runs that the requested figures need. All cases of a run are one list of a sweep, so that few
programs are compiled.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from ...flow.status import Status
from ...model.dang2024 import paper_scene
from ...model.scene import Scene
from ...orbits.branches import OrbitBranch, continue_orbit
from ...results.result import Result
from ...sweeps.follow import Jump, find_jump
from ...sweeps.sweep import lyapunov_sweep, sweep
from ...tools.checks import one_of, whole
from ...tools.types import Numbers
from .claims import CLAIMS, answers
from .verdicts import Answer, Diagram, Singles, named


class Effort(NamedTuple):
    """Extent of the study; by default the extent of the paper's figures."""

    speeds: int = 241
    clearances: int = 197
    lengths: int = 161
    transient: int = 600
    """Forcing periods before the recorded periods."""
    judged: int = 400
    """Number of the last periods that classify attractors."""
    counted: int = 500
    """Periods over which Lyapunov exponents are measured."""
    flips: int = 2
    """Number of flips at which branches of orbits are followed to orbits of twice the period."""
    progress: bool | None = None


QUICK = Effort(
    speeds=49,
    clearances=50,
    lengths=41,
    transient=300,
    judged=200,
    counted=100,
    flips=0,
)

STEPS = 100
"""Steps per forcing period, for errors of 2e-4 over six periods; at low speeds there are more, see `run_lists`."""

Data = dict[str, xr.Dataset]
"""Datasets by name, for figures and files. A run adds each dataset when it is finished."""
Answers = dict[str, Answer]
CaseList = dict[str, np.ndarray]
"""Speed [m/s], clearance [m] and length [m] of each case of a list."""


def cases(**varied: Numbers) -> CaseList:
    """Return a list of cases from values of some parameters; others are those of the paper's nominal case."""
    count = len(next(iter(varied.values())))
    nominal = {"speed": 1250.0, "clearance": 1e-3, "length": 0.2}
    return {name: np.asarray(varied.get(name, np.full(count, value))) for name, value in nominal.items()}


def study_cases(effort: Effort) -> dict[str, CaseList]:
    """Return the study's lists of cases by name: seven single cases, and three diagrams."""
    return {
        # three cases of Fig. 4, two of Fig. 7 and two of Fig. 12; claims refer to them by their numbers
        "histories": cases(
            speed=[900.0, 1500.0, 2300.0, 1250.0, 1250.0, 1250.0, 1250.0],
            clearance=[1e-3, 1e-3, 1e-3, 1e-3, 4e-3, 1e-3, 1e-3],
            length=[0.2, 0.2, 0.2, 0.2, 0.2, 0.1, 0.4],
        ),
        "speed": cases(speed=np.linspace(100.0, 2500.0, effort.speeds)),
        "clearance": cases(clearance=np.linspace(0.1e-3, 5e-3, effort.clearances)),
        "length": cases(length=np.linspace(0.1, 0.5, effort.lengths)),
    }


def run_lists(
    run: Callable[..., Result], scene: Scene, lists: dict[str, CaseList], **options: object
) -> dict[str, xr.Dataset]:
    """Run lists of cases as one sweep, and return the results by name; a list named as a parameter is along it."""
    grid = {name: np.concatenate([part[name] for part in lists.values()]) for name in cases(speed=[])}
    # the slower the sled, the longer a period, and the shorter the part of it that an impact takes
    steps = np.where(grid["speed"] < 500.0, 2 * STEPS, STEPS)
    ds = run(scene, grid, product=False, steps_per_period=steps, **options).ds
    # cut the result into the lists again
    parts = {}
    first = 0
    for name, part in lists.items():
        last = first + len(part["speed"])
        parts[name] = ds.isel(case=slice(first, last))
        # single cases differ in several parameters, so that they stay along `case`
        if name in grid:
            parts[name] = parts[name].swap_dims(case=name)
        first = last
    return parts


def motions(effort: Effort, wanted: set[str], data: Data) -> Answers:
    """Answer Figs. 4, 5, 7, 8, 10 and 12: single cases, and diagrams over a parameter with branches of orbits."""
    made = {"histories": {"4", "7", "12"}, "speed": {"5"}, "clearance": {"8"}, "length": {"10"}}
    lists = {name: part for name, part in study_cases(effort).items() if made[name] & wanted}
    data |= run_lists(sweep, paper_scene(), lists, transient=effort.transient, progress=effort.progress)
    found: Answers = {}
    for name, part in lists.items():
        # only single cases need histories, for which they are run again
        if name == "histories":
            data["sections"] = data[name]
            data[name] = _histories(paper_scene(), part, effort.transient, effort.progress)
            # the forcing frequency follows from the wavelength of 8 m
            found |= answers(name, Singles(data[name], part["speed"] / 8, data["sections"], effort.judged))
            continue
        evidence = _jumps(part["speed"]) if name == "speed" else ""
        found |= answers(name, Diagram(data[name], name, effort.judged, evidence))
        for branch in follow_branches(name, effort.flips, progress=effort.progress):
            data[f"{name}_branch_{branch.period}"] = branch.ds
    return found


def follow_branches(name: str, flips: int, **options: bool | None) -> Iterator[OrbitBranch]:
    """Yield the branch over a parameter through the paper's nominal case; over speed also those of twice the period.

    A diagram shows the motion to which one start leads, a branch shows a motion wherever it exists. Where a motion
    disappears from a diagram, there are two possibilities. Its branch ends or becomes unstable at an event; or the
    branch continues, and the start leads to another motion.

    **Arguments:** `flips`: number of flips at which to follow a branch of twice the period; `options`: `progress`.
    """
    bounds = {"speed": (900.0, 2300.0), "clearance": (0.1e-3, 5e-3), "length": (0.1, 0.5)}[name]
    # the places of events agree to five digits with those of 400 steps
    branch = continue_orbit(paper_scene(), name, bounds, steps_per_period=200, **options)
    yield branch
    for _ in range(flips if name == "speed" else 0):
        # the flip at which the stable orbits of a branch end towards low speeds
        flip = max(branch.events_named("PD"), key=lambda event: event.value, default=None)
        if flip is None:
            return
        try:
            branch = branch.switched(flip, bounds=(800.0, 2300.0), **options)
        except ValueError:  # no orbit of twice the period was found near the flip
            return
        yield branch


def _histories(scene: Scene, part: CaseList, transient: int, progress: bool | None) -> xr.Dataset:
    """Return histories of single cases."""
    options = dict(record="history", saves_per_period=50, periods=60, transient=transient, progress=progress)
    return sweep(scene, part, product=False, steps_per_period=STEPS, **options).ds


def _jumps(speeds: np.ndarray) -> str:
    """Follow the motion over speed up and down, and return a text that says where it jumps."""
    path = {"speed": speeds[speeds >= 1500.0]}
    texts = []
    for direction in ("up", "down"):
        # above the scatter of the mean states of chaotic motions, and below the change of the mean state in the jump
        jump = find_jump(paper_scene(), path, direction=direction, threshold=4.0, steps_per_period=STEPS)
        texts.append(f"followed {direction}: {jump_text(jump)}")
    return f"attractors coexist, so the start decides where the motion jumps; {', '.join(texts)}"


def jump_text(jump: Jump) -> str:
    """Return where a followed motion jumped [m/s], or the reason why no jump was found."""
    if jump.found:
        return f"{min(jump.before, jump.after):.0f}..{max(jump.before, jump.after):.0f} m/s"
    if jump.status != Status.FINITE:
        return f"search ended at {jump.after:.0f} m/s ({jump.status.meaning})"
    return "no jump"


def exponents(effort: Effort, wanted: set[str], data: Data) -> Answers:
    """Answer Figs. 6, 9 and 11: largest Lyapunov exponents over speed, clearance and length, with certificates."""
    made = {"speed": "6", "clearance": "9", "length": "11"}
    lists = {name: part for name, part in study_cases(effort).items() if made.get(name) in wanted}
    options = dict(transient=effort.transient, periods=effort.counted, progress=effort.progress)
    found: Answers = {}
    for name, ds in run_lists(lyapunov_sweep, paper_scene(), lists, **options).items():
        data[f"{name}_exponents"] = ds
        found |= answers(f"{name}_exponents", Diagram(ds, name))
    return found


def dual_frequency(effort: Effort, wanted: set[str], data: Data) -> Answers:
    """Answer Fig. 13: spectra under two wavelengths."""
    scene = paper_scene(speed=1500.0, wavelengths=(10.0, 12.0))
    # 180 periods of f1 are 150 of f2, so that both lines and all their combinations are at bins of the spectrum
    common = dict(record="history", saves_per_period=50, steps_per_period=STEPS, periods=180)
    how = dict(transient=effort.transient, progress=effort.progress)
    data["dual"] = sweep(scene, {"speed": [1500.0]}, **common, **how).ds
    return answers("dual", Singles(data["dual"], [150.0]))


def readings(progress: bool | None = None) -> list[dict[str, str]]:
    """Return the answers to some claims under all readings of what the paper leaves open, as rows of a table.

    The paper does not say whether C is the total play or the play of each face, nor whether contacts may pull.
    """
    rows = []
    for clamp, forces in ((True, "forces clamped"), (False, "forces may pull")):
        for plays, play in ((1, "total play"), (2, "play per face")):
            rows.append({"reading": f"{play}, {forces}"} | _reading(plays, clamp, progress))
    return rows


def _reading(plays: int, clamp: bool, progress: bool | None) -> dict[str, str]:
    """Return one row of `readings`."""
    lists = {
        "slow": cases(speed=np.arange(760.0, 1061.0, 20.0)),
        "fast": cases(speed=np.arange(1780.0, 1981.0, 20.0)),
        "wide": cases(clearance=np.arange(2.4e-3, 2.81e-3, 0.05e-3)),
        "lengths": cases(length=[0.1, 0.4]),
    }
    for part in lists.values():
        # the scene takes the total play
        part["clearance"] = part["clearance"] * plays
    scene = paper_scene(clamp=clamp)
    options = dict(transient=300, progress=progress)
    parts = run_lists(sweep, scene, lists, **options)
    slow = Diagram(parts["slow"], "speed", 200)
    fast = Diagram(parts["fast"], "speed", 200)
    # back to the paper's C, for the claims
    wide = parts["wide"].assign_coords(clearance=parts["wide"]["clearance"] / plays)
    # both cases are forced at 156.25 Hz: 1250 m/s over 8 m
    history = Singles(_histories(scene, lists["lengths"], **options), [156.25, 156.25])
    # the nearest of the speeds
    at_900 = int(np.argmin(abs(slow.values - 900)))
    return {
        "N1 at 900 m/s (period-3)": named(slow.kinds, at_900),
        "N4 three points in V_Y from (820 m/s)": CLAIMS["N4 period-3"].answer(slow).ours,
        "N4 drop (1810 m/s)": CLAIMS["N4 jump"].answer(fast).ours,
        "N11 not periodic from (2.575 mm)": CLAIMS["N11"].answer(Diagram(wide, "clearance", 200)).ours,
        "N14, N15 at A2, C2 and J2": CLAIMS["N15"]._replace(cases=(0, 1)).answer(history).ours,
    }


RUNS: dict[str, tuple[tuple[str, ...], Callable[[Effort, set[str], Data], Answers]]] = {
    "motions": (("4", "7", "12", "5", "8", "10"), motions),
    "exponents": (("6", "9", "11"), exponents),
    "dual frequency": (("13",), dual_frequency),
}
"""The runs by name, with the figures that each makes."""

FIGURES = tuple(figure for figures, _ in RUNS.values() for figure in figures)
"""All figures."""


class Finished(NamedTuple):
    """A finished run."""

    name: str
    figures: tuple[str, ...]
    """Requested figures that it makes."""
    data: Data
    answers: Answers
    seconds: float


def reproduce(
    figures: Iterable[str] = FIGURES,
    *,
    quick: bool = False,
    transient: int | None = None,
    progress: bool | None = None,
) -> Iterator[Finished]:
    """Run the study, and yield each run when it is finished.

    **Arguments:** `figures`: which of `FIGURES`; `quick`: coarser grids and shorter transients; `transient`: forcing
    periods before the recorded periods, to test whether a verdict depends on it; `progress`: whether bars are shown.

    **Raises:** `ValueError` for a figure that is not one of them, before anything runs.
    """
    effort = (QUICK if quick else Effort())._replace(progress=progress)
    if transient is not None:
        effort = effort._replace(transient=whole("transient", transient, 20))
    wanted = {one_of("figures", str(figure), FIGURES) for figure in figures}
    # a separate generator, so that wrong arguments raise at the call, not at the first `next`
    return _finished_runs(wanted, effort)


def _finished_runs(wanted: set[str], effort: Effort) -> Iterator[Finished]:
    for name, (made, run) in RUNS.items():
        figures = tuple(figure for figure in made if figure in wanted)
        if figures:
            data: Data = {}
            begun = time.perf_counter()
            found = run(effort, wanted, data)
            yield Finished(name, figures, data, found, time.perf_counter() - begun)
