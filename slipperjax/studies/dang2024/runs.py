"""The study of Dang et al. 2024 as runs: few large batches, from which its figures and answers are made.

`reproduce` runs what the requested figures need. All sweeps of a run are one list of cases, so that few programs are
compiled.
"""

import functools
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ...flow.status import Interrupted, Status, Stop
from ...model.dang2024 import paper_scene
from ...sweeps.attractors import attractors, groups
from ...sweeps.follow import find_jump, follow
from ...sweeps.run import concurrently
from ...sweeps.sweep import lyapunov_sweep, sweep
from ...tools.checks import one_of, whole
from . import branches, verdicts
from .claims import Answer, named, runs, show_ranges, supported


class Effort(NamedTuple):
    """How much of the study is run; by default all of it."""

    speeds: int = 241
    clearances: int = 197
    lengths: int = 161
    transient: int = 600
    """Forcing periods before anything is recorded."""
    follow_transient: int = 20
    """Forcing periods at each value of a sweep with memory."""
    basin: int = 32
    """Starts along each side of the basin picture."""
    judged: int = 400
    """Last periods from which attractors are named."""
    counted: int = 500
    """Periods over which Lyapunov exponents are taken."""
    flips: int = 2
    """How often branches of orbits are left for those of twice the period."""
    observed: bool = True
    """Whether the orbit of the paper's widest case is found and followed."""


FULL = Effort()
QUICK = Effort(
    speeds=49,
    clearances=50,
    lengths=41,
    transient=300,
    follow_transient=10,
    basin=12,
    judged=200,
    counted=100,
    flips=0,
    observed=False,
)

SLOW = 500.0
"""Speed [m/s] below which an impact is so short a part of a period that more steps are needed."""
STEPS, STEPS_SLOW = 100, 200
"""Steps per forcing period from `SLOW` on, with errors of 2e-4 over six periods, and below."""


Data = dict[str, xr.Dataset]
"""Datasets by name, for the figures and for files. A run adds each as soon as it is finished."""
Answers = dict[str, Answer]


def cases(effort: Effort) -> dict[str, dict[str, np.ndarray]]:
    """The study's lists of cases by name, each with its speeds [m/s], clearances [m] and lengths [m]."""
    varied = {
        "speed": np.linspace(100.0, 2500.0, effort.speeds),
        "clearance": np.linspace(0.1e-3, 5e-3, effort.clearances),
        "length": np.linspace(0.1, 0.5, effort.lengths),
    }
    nominal = lambda n: {"speed": np.full(n, 1250.0), "clearance": np.full(n, 1e-3), "length": np.full(n, 0.2)}
    single = nominal(7)
    single["speed"][:3] = 900.0, 1500.0, 2300.0
    single["clearance"][4] = 4e-3
    single["length"][5:] = 0.1, 0.4
    return {"histories": single} | {name: nominal(len(v)) | {name: v} for name, v in varied.items()}


def _joined(run: Callable, effort: Effort, names: list[str], **options: Any) -> dict[str, xr.Dataset]:
    """Runs some of the lists of `cases` as one, and gives the results by name, along what varies in each."""
    lists = [cases(effort)[name] for name in names]
    grid = {key: np.concatenate([part[key] for part in lists]) for key in lists[0]}
    options |= dict(product=False, transient=effort.transient)
    options["steps_per_period"] = np.where(grid["speed"] < SLOW, STEPS_SLOW, STEPS)
    ds = run(paper_scene(), grid, **options)
    ends = np.cumsum([len(part["speed"]) for part in lists])
    parts = {n: ds.isel(case=slice(b - len(p["speed"]), b)) for n, p, b in zip(names, lists, ends, strict=True)}
    return {name: part if name == "histories" else part.swap_dims({"case": name}) for name, part in parts.items()}


def motions(effort: Effort, wanted: set[str], options: dict, data: Data) -> Answers:
    """Figs. 4, 5, 7, 8, 10 and 12: single cases, and diagrams over speed, clearance and length, as one batch.

    Concurrently, on one core, the branches of orbits through the diagrams.
    """
    made = {"histories": {"4", "7", "12"}, "speed": {"5"}, "clearance": {"8"}, "length": {"10"}}
    names = [name for name, figures in made.items() if figures & wanted]

    def follow_all() -> dict[str, branches.Branches]:
        over = [name for name in branches.OVER if name in names]
        return {n: branches.follow_branches(n, effort.flips, effort.observed, data, options) for n in over}

    answers, followed = concurrently(lambda: _diagrams(effort, names, options, data), follow_all)
    for name, of_name in followed.items():
        answers = supported(answers, branches.OVER[name](of_name))
    return answers


def _diagrams(effort: Effort, names: list[str], options: dict, data: Data) -> Answers:
    """The single cases and the diagrams."""
    parts = _joined(sweep, effort, names, **options)
    data |= {"sections" if name == "histories" else name: part for name, part in parts.items()}
    answers: Answers = {}
    if "histories" in parts:
        common = dict(record="history", saves_per_period=50, transient=effort.transient, periods=60)
        grid = cases(effort)["histories"]
        ds = sweep(paper_scene(), grid, product=False, steps_per_period=STEPS, **common, **options)
        data["histories"] = ds
        answers |= verdicts.histories(ds, data["sections"], effort.judged)
    if "speed" in parts:
        speeds = parts["speed"]["speed"].values
        common = dict(transient=effort.follow_transient, steps_per_period=STEPS, **options)
        data["speed_followed"] = follow(paper_scene(), {"speed": speeds[speeds >= SLOW]}, **common)
        path = {"speed": speeds[speeds >= 1500]}
        # The threshold is above the scatter of the means of chaotic motions, and below the height of the branch on
        # which the followed motion leans.
        jump = functools.partial(find_jump, paper_scene(), path, threshold=4.0, steps_per_period=STEPS)
        up, down = concurrently(*(functools.partial(jump, direction=way) for way in ("up", "down")))
        answers |= verdicts.over_speed(parts["speed"], up, down, effort.judged)
    if "clearance" in parts:
        answers |= verdicts.over_clearance(parts["clearance"], effort.judged)
    if "length" in parts:
        answers |= verdicts.over_length(parts["length"], effort.judged)
    return answers


def exponents(effort: Effort, wanted: set[str], options: dict, data: Data) -> Answers:
    """Figs. 6, 9 and 11: largest Lyapunov exponents over speed, clearance and length, with certificates."""
    made = {"speed": "6", "clearance": "9", "length": "11"}
    names = [name for name, figure in made.items() if figure in wanted]
    parts = _joined(lyapunov_sweep, effort, names, periods=effort.counted, **options)
    data |= {f"{name}_exponents": part for name, part in parts.items()}
    answers: Answers = {}
    for name, part in parts.items():
        answers |= verdicts.EXPONENTS[name](part)
    return answers


def dual_frequency(effort: Effort, wanted: set[str], options: dict, data: Data) -> Answers:
    """Fig. 13: spectra under two wavelengths."""
    scene = paper_scene(speed=1500.0, wavelengths=(10.0, 12.0))
    # 180 periods of f1 are 150 of f2, so that both lines and all their combinations fall on a bin of the spectrum.
    common = dict(record="history", saves_per_period=50, steps_per_period=STEPS, periods=180)
    ds = sweep(scene, {"speed": [1500.0]}, transient=effort.transient, **common, **options)
    data["dual"], answers = verdicts.dual_frequency(ds)
    return answers


def basins(effort: Effort, wanted: set[str], options: dict, data: Data) -> Answers:
    """Not in the paper: which attractor each start reaches at 1860 m/s, where this motion differs from its."""
    side = np.linspace(-1.5, 1.5, effort.basin)
    common = dict(transient=150, periods=20, record="strobe", steps_per_period=50)
    ds = sweep(paper_scene(1860.0), {"v_y": side, "v_z": side}, **common, **options)
    data["basins"] = ds.merge(groups(ds))
    return {}


CONVENTIONS = {
    "total play, forces clamped (the default)": (False, True),
    "play per face, forces clamped": (True, True),
    "total play, forces may pull": (False, False),
    "play per face, forces may pull": (True, False),
}
"""Readings of what the paper leaves open: whether C is the play of each face, and whether contacts only push."""


def readings(effort: Effort, options: dict) -> list[dict[str, str]]:
    """The claims that differ, under each of `CONVENTIONS`: rows of a table, without flagged cases.

    Those with other laws need programs of their own, and are made at once with the others.
    """
    rows = lambda names: [_reading(name, effort, options) for name in names]
    names = {
        clamp: [name for name, (_, of_name) in CONVENTIONS.items() if of_name == clamp] for clamp in (True, False)
    }
    pushing, pulling = concurrently(lambda: rows(names[True]), lambda: rows(names[False]))
    return pushing + pulling


def _reading(name: str, effort: Effort, options: dict) -> dict[str, str]:
    """One row of `readings`."""
    per_face, clamp = CONVENTIONS[name]
    slow, fast = np.arange(760.0, 1061.0, 20.0), np.arange(1780.0, 1981.0, 20.0)
    wide = np.arange(2.4e-3, 2.81e-3, 0.05e-3)
    speeds = np.concatenate([slow, fast, np.full(len(wide) + 2, 1250.0)])
    clearances = np.concatenate([np.full(len(slow) + len(fast), 1e-3), wide, [1e-3, 1e-3]])
    lengths = np.concatenate([np.full(len(speeds) - 2, 0.2), [0.1, 0.4]])
    common = dict(product=False, steps_per_period=STEPS, transient=min(effort.transient, 300), **options)
    scene = paper_scene(clamp=clamp)
    grid = dict(speed=speeds, clearance=clearances * (2 if per_face else 1), length=lengths)
    ds = sweep(scene, grid, **common)
    last = {k: v[-2:] for k, v in grid.items()}
    history = sweep(scene, last, record="history", saves_per_period=50, periods=60, **common)
    kinds = attractors(ds)
    parts = np.split(np.arange(len(speeds)), np.cumsum([len(slow), len(fast), len(wide)]))
    good = verdicts.good_cases(ds)
    points = verdicts.case_points(ds.isel(case=parts[0]), "v_y")
    drop = verdicts.greatest_drop(fast, verdicts.case_means(ds.isel(case=parts[1]), "v_y"))
    wild = wide[(kinds.kind[parts[2]] != "period") & good[parts[2]]] * 1e3
    at_900 = int(np.argmin(abs(slow - 900)))
    row = {
        "reading": name,
        "N1 900 m/s": named(kinds, at_900),
        "N4 three points in V_Y (820..980 m/s)": show_ranges(runs(points == 3, slow)),
        "N4 drop (1810 m/s)": "none" if drop is None else f"{drop[0]:.0f}..{drop[1]:.0f}",
        "N11 not periodic from (2.575 mm)": f"{wild[0]:.4g}" if wild.size else "not up to 2.8",
    }
    for k, (length, stated) in enumerate(((0.1, "1977, 8807, 5447"), (0.4, "4256, 12824, 20365"))):
        case = history.isel(case=k)
        peaks = case["peak_force"].sel(end="rear", point=list("ACJ")).values
        text = ", ".join(f"{v:.0f}" for v in peaks) if case["status"] == Status.FINITE else "flagged"
        row[f"N14 L = {length} m ({stated} N)"] = text
    row["cases flagged"] = f"{np.sum(~good)} of {good.size}"
    return row


RUNS: dict[str, tuple[tuple[str, ...], Callable[[Effort, set[str], dict, Data], Answers]]] = {
    "motions": (("4", "7", "12", "5", "8", "10"), motions),
    "exponents": (("6", "9", "11"), exponents),
    "dual frequency": (("13",), dual_frequency),
    "basins": (("basins",), basins),
}
"""The runs by name, with the figures that each makes."""

FIGURES = tuple(f for figures, _ in RUNS.values() for f in figures)
"""All figures."""


class Finished(NamedTuple):
    """A finished run."""

    name: str
    figures: tuple[str, ...]
    """The requested ones."""
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
    """Runs the study, and yields each run when it is done.

    **Arguments:** `figures`: which of `FIGURES`; `quick`: coarser grids and shorter transients; `transient`: forcing
    periods before anything is recorded, for trying whether a verdict depends on it; `progress`: bars.

    After Ctrl-C the datasets that the stopped run had finished are yielded without figures and answers, together with
    "interrupted", the finished cases of the sweep that was stopped. Then the interrupt is raised again.

    **Raises:** `ValueError` for a figure that is not one of them, before anything runs.
    """
    effort = QUICK if quick else FULL
    if transient is not None:
        effort = effort._replace(transient=whole("transient", transient, 20))
    return _runs({one_of("figures", str(f), FIGURES) for f in figures}, effort, progress)


ALONE = "motions"
"""The run before the others, which are made two at a time: while one of them compiles or uses one core, another one
uses the other. This one follows branches by many short calls, which would wait for the long ones of those."""


def _runs(wanted: set[str], effort: Effort, progress: bool | None) -> Iterator[Finished]:
    chosen = [name for name, (made, _) in RUNS.items() if wanted & set(made)]
    data: dict[str, Data] = {name: {} for name in chosen}
    begun: dict[str, float] = {}
    ends: dict[str, Future[tuple[Answers, float]]] = {}
    pool, stop = ThreadPoolExecutor(2), Stop(Stop.here())

    def one(name: str) -> tuple[Answers, float]:
        begun[name] = time.perf_counter()
        answers = RUNS[name][1](effort, wanted, {"progress": progress}, data[name])
        return answers, time.perf_counter() - begun[name]

    def begin(names: list[str]) -> None:
        ends.update({name: stop.submit(pool, one, name) for name in names if name not in ends})

    left = list(chosen)
    try:
        begin([name for name in chosen if name == ALONE] or chosen)
        for name in chosen:
            answers, seconds = ends[name].result()
            begin(chosen)  # goes on while the figures of this one are drawn
            left.remove(name)
            figures = tuple(f for f in RUNS[name][0] if f in wanted)
            yield Finished(name, figures, data[name], answers, seconds)
    except BaseException as end:
        stop.set()
        pool.shutdown(cancel_futures=True)
        if not isinstance(end, KeyboardInterrupt):
            raise
        for name in left:
            future = ends.get(name)
            error = None if future is None or future.cancelled() else future.exception()
            if isinstance(error, Interrupted) and error.result is not None:
                data[name]["interrupted"] = error.result
            if data[name]:
                yield Finished(name, (), data[name], {}, time.perf_counter() - begun[name])
        raise
    pool.shutdown()
