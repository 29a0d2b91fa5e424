"""The study of Dang et al. 2024, figure by figure and claim by claim: what it reports, and the runs that answer it.

`reproduce` runs figures, and gives for each claim the paper's value, ours, and a verdict. The claims' numbers (N) and
the figures' (Fig.) are those of the report; "section" is the velocity at upward zero crossings of a coordinate.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from .analysis.spectrum import find_line, power_spectral_density
from .branches import attractors, find_jump, groups
from .checks import one_of, whole
from .claims import Answer, named, near, runs, section_points, show_ranges
from .scene import paper_scene
from .spectra import lyapunov_sweep
from .sweep import follow, sweep


class Effort(NamedTuple):
    """How much of the study is run."""

    speeds: int
    clearances: int
    lengths: int
    transient: int
    """Forcing periods before anything is recorded."""
    follow_transient: int
    """Forcing periods at each value of a sweep with memory."""
    basin: int
    """Starts along each side of the basin picture."""
    judged: int
    """Last periods from which attractors are named."""
    counted: int
    """Periods over which Lyapunov exponents are taken."""


FULL = Effort(
    speeds=241, clearances=197, lengths=161, transient=600, follow_transient=20, basin=32, judged=400, counted=500
)
QUICK = Effort(
    speeds=49, clearances=50, lengths=41, transient=300, follow_transient=10, basin=12, judged=200, counted=100
)

STEPS = 100
"""Steps per forcing period at 500 m/s and more: errors of 2e-4 over six periods."""
STEPS_SLOW = 200
"""The same for sweeps that begin at 100 m/s."""


class Outcome(NamedTuple):
    """What one figure's run gave."""

    data: dict[str, xr.Dataset]
    """Datasets by name, for the figure and for a file."""
    answers: dict[str, Answer]


def histories(effort: Effort, options: dict) -> Outcome:
    """Figs. 4, 7 and 12: seven single cases as one batch, and what they settle to."""
    speeds = [900.0, 1500.0, 2300.0, 1250.0, 1250.0, 1250.0, 1250.0]
    clearances = [1e-3, 1e-3, 1e-3, 1e-3, 4e-3, 1e-3, 1e-3]
    lengths = [0.2, 0.2, 0.2, 0.2, 0.2, 0.1, 0.4]
    grid = dict(speed=speeds, clearance=clearances, length=lengths)
    common = dict(product=False, steps_per_period=STEPS, **options)
    passed = effort.transient
    ds = sweep(paper_scene(), grid, record="history", saves_per_period=50, transient=passed, periods=60, **common)
    long = sweep(paper_scene(), grid, transient=passed, periods=60, **common)
    kinds = attractors(long, effort.judged)
    roll = section_points(long["w_x"].values)
    lines = []
    for k in range(3):
        f = speeds[k] / 8
        spectrum = power_spectral_density(ds["alpha_x"].values[k], 50 * f)
        at = spectrum.frequency > 0.05 * f
        lines.append((spectrum, float(spectrum.frequency[at][np.argmax(spectrum.density[at])] / f)))
    present = lambda k, ratio: find_line(lines[k][0], ratio * speeds[k] / 8).present
    peak = ds["contact_force"].max("time")
    peaks = {(p, k): float(peak.sel(case=k, end="rear", point=p)) for p in "ACJ" for k in (5, 6)}
    stated = {"A": (1977, 4256), "C": (8807, 12824), "J": (5447, 20365)}
    two_thirds, two, three = present(0, 2 / 3), present(1, 2), present(1, 3)
    answers = {
        "N1 motion": Answer(named(kinds, 0), kinds.period[0] == 3, str(kinds.evidence[0])),
        "N1 lines": Answer(f"f: {present(0, 1)}, 2f/3: {two_thirds}", present(0, 1) and two_thirds),
        "N1 section": Answer(f"{roll[0]} points", roll[0] == 2),
        "N2 motion": Answer(f"{named(kinds, 1)}, 2f: {two}, 3f: {three}", kinds.period[1] == 1 and two and three),
        "N2 section": Answer(f"{roll[1]} points", roll[1] == 1),
        "N3 motion": Answer(named(kinds, 2), kinds.kind[2] == "chaotic", str(kinds.evidence[2])),
        "N3 line": Answer(f"{lines[2][1]:.3g} f", abs(lines[2][1] - 0.4) < 0.05),
        "N9 narrow": Answer(named(kinds, 3), kinds.period[3] == 1),
        "N9 wide": Answer(named(kinds, 4), kinds.kind[4] != "period", str(kinds.evidence[4])),
    }
    for point, values in stated.items():
        for paper, length, k in zip(values, (0.1, 0.4), (5, 6), strict=True):
            ours = peaks[point, k]
            answers[f"N14 {point}2 {length}"] = Answer(f"{ours:.0f} N", abs(ours / paper - 1) < 0.05)
    softer = [(peaks[p, 5], peaks[p, 6]) for p in "ACJ"]
    text = ", ".join(f"{a:.0f} against {b:.0f} N" for a, b in softer)
    answers["N15"] = Answer(text, all(a < b for a, b in softer))
    return Outcome({"histories": ds, "sections": long}, answers)


def over_speed(effort: Effort, options: dict) -> Outcome:
    """Fig. 5: five bifurcation diagrams over speed, from Table 2's start and with memory; where the motion jumps."""
    speeds = np.linspace(100.0, 2500.0, effort.speeds)
    step = max(speeds[1] - speeds[0], 10.0)
    ds = sweep(paper_scene(), {"speed": speeds}, transient=effort.transient, steps_per_period=STEPS_SLOW, **options)
    path = {"speed": speeds[speeds >= 500]}
    branch = follow(paper_scene(), path, transient=effort.follow_transient, steps_per_period=STEPS, **options)
    points = {name: section_points(ds[name].values) for name in ("v_y", "v_z", "w_x", "w_y")}
    kinds = attractors(ds, effort.judged)
    three, one = runs(points["v_y"] == 3, speeds), runs((points["v_y"] == 1) & (speeds < 1850), speeds)
    longest = max(one, key=lambda r: r[1] - r[0], default=(np.nan, np.nan))
    mean = np.array([np.nanmean(v) if np.isfinite(v).any() else np.nan for v in ds["v_y"].values])
    high = np.flatnonzero((speeds[1:] > 1500) & (speeds[1:] < 2200))
    drop = high[np.nanargmin(np.diff(mean)[high])]
    around = {"speed": speeds[(speeds >= 1500) & (speeds <= 2200)]}
    jump, back = (find_jump(paper_scene(), around, direction=d, steps_per_period=STEPS) for d in ("up", "down"))
    leaning = [r for r in runs(points["w_x"] == 0, speeds) if r[1] > 1500]
    two = [r for r in runs(points["v_z"] == 2, speeds) if 700 < r[0] < 1100]
    rate = lambda name, where: np.nanmax(np.abs(ds[name].values[where]))
    ratio = [rate(n, speeds > 1950) / rate(n, (speeds > 1000) & (speeds < 1800)) for n in ("w_y", "w_z")]
    place = f"{speeds[drop]:.0f}..{speeds[drop + 1]:.0f} m/s from Table 2's start"
    up = "no jump" if jump is None else f"{jump.before:.0f}..{jump.after:.0f} m/s"
    down = "no jump" if back is None else f"{back.after:.0f}..{back.before:.0f} m/s"
    nine = int(np.argmin(abs(speeds - 900)))
    answers = {
        "N4 period-3": Answer(
            f"three points: {show_ranges(three)} m/s",
            any(near(r[0], 820, step) for r in three),
            f"{speeds[nine]:.0f} m/s is {named(kinds, nine)}: {kinds.evidence[nine]}",
        ),
        "N4 period-1": Answer(f"{longest[0]:.0f} m/s", near(longest[0], 980, step)),
        "N4 jump": Answer(
            place,
            near(speeds[drop], 1810, step),
            f"attractors coexist, so the start decides; followed upwards: {up}, downwards: {down}",
        ),
        "N5": Answer(
            f"two points: {show_ranges(two)} m/s",
            bool(two) and near(two[0][0], 820, step) and near(two[-1][1], 980, step),
        ),
        "N6": Answer(
            f"{show_ranges(leaning)} m/s",
            bool(leaning) and near(leaning[0][0], 1660, step) and near(leaning[-1][1], 1810, step),
            "ends where the motion jumps, which the start decides: see N4",
        ),
        "N7": Answer(f"{ratio[0]:.1f} and {ratio[1]:.1f} times those of 1000..1800 m/s", min(ratio) > 2),
    }
    return Outcome({"speed": ds, "speed_followed": branch}, answers)


def _clearances_then_lengths(clearances, lengths):
    """One list of cases: along the clearance at the nominal length, then along the length at the nominal one."""
    n, m = len(clearances), len(lengths)
    grid = {
        "clearance": np.concatenate([clearances, np.full(m, 1e-3)]),
        "length": np.concatenate([np.full(n, 0.2), lengths]),
    }
    return grid, n


def _cut(ds: xr.Dataset, part: slice, name: str) -> xr.Dataset:
    """A part of a list of cases, along the parameter that varies there."""
    return ds.isel(case=part).swap_dims(case=name)


def over_clearance_and_length(effort: Effort, options: dict) -> Outcome:
    """Figs. 8 and 10: bifurcation diagrams over clearance and over length, as one batch."""
    clearances = np.linspace(0.1e-3, 5e-3, effort.clearances)
    lengths = np.linspace(0.1, 0.5, effort.lengths)
    grid, n = _clearances_then_lengths(clearances, lengths)
    both = sweep(paper_scene(), grid, product=False, transient=effort.transient, steps_per_period=STEPS, **options)
    by_c, by_l = _cut(both, slice(0, n), "clearance"), _cut(both, slice(n, None), "length")
    c, length = clearances * 1e3, lengths
    c_step, l_step = max(c[1] - c[0], 0.025), max(length[1] - length[0], 0.0025)
    kinds_c, kinds_l = attractors(by_c, effort.judged), attractors(by_l, effort.judged)
    small = c < 2.575
    level = lambda name: np.nanmean(np.abs(by_c[name].values[small]), axis=-1)
    grows = {name: np.corrcoef(c[small], level(name))[0, 1] for name in ("v_y", "v_z", "w_x", "w_y", "w_z")}
    one = np.mean(kinds_c.period[small] == 1)
    pitch = runs(section_points(by_c["w_y"].values) == 2, c)
    wild = runs(kinds_c.kind != "period", c)
    brief = [r for r in runs(kinds_c.period != 1, c) if 1.4 < r[0] < 2.0]
    unsettled = np.flatnonzero((kinds_l.kind != "period") & (length < 0.2))
    last = float(length[unsettled[-1]]) if unsettled.size else None
    late = length > 0.16
    spread = [np.nanstd(np.nanmean(by_l[name].values[late], axis=-1)) for name in ("v_y", "v_z")]
    two = [r for r in runs(section_points(by_l["w_y"].values) == 2, length) if 0.18 < r[0] < 0.25]
    growth = ", ".join(f"{k}: r = {v:.2f}" for k, v in grows.items())
    test = "by recurrence, its decay and the 0-1 test: a slow transient is not called chaos"
    answers = {
        "N10 growth": Answer(growth, min(grows.values()) > 0.8),
        "N10 period-1": Answer(f"{one:.0%} period-1", one > 0.5),
        "N10 brief": Answer(
            f"{show_ranges(brief)} mm not period-1", any(r[0] - c_step <= 1.675 <= r[1] + c_step for r in brief)
        ),
        "N10 pitch": Answer(f"{show_ranges(pitch[:1])} mm", bool(pitch) and near(pitch[0][0], 0.6, c_step)),
        "N11": Answer(f"not periodic: {show_ranges(wild)} mm", any(near(r[0], 2.575, c_step) for r in wild), test),
        "N12 chaos": Answer(
            "periodic everywhere" if last is None else f"last that is not periodic: {last:.4g} m",
            near(last, 0.15, 2 * l_step),
            test,
        ),
        "N12 constant": Answer(f"spread {spread[0]:.3f} and {spread[1]:.3f} m/s", max(spread) < 0.05),
        "N13": Answer(
            f"{show_ranges(two)} m",
            bool(two) and near(two[0][0], 0.1975, l_step) and near(two[-1][1], 0.2275, l_step),
        ),
    }
    return Outcome({"clearance": by_c, "length": by_l}, answers)


DUAL_LINES = {
    "f1": (1, 0), "f2": (0, 1), "2f1": (2, 0), "3f2": (0, 3), "4f2": (0, 4), "2f2-f1": (-1, 2), "2f1-f2": (2, -1),
    "f1+f2": (1, 1), "3f1-f2": (3, -1), "4f2-f1": (-1, 4), "f1+2f2": (1, 2), "2f1+f2": (2, 1), "4f1-f2": (4, -1),
}  # fmt: skip
"""Lines that the paper names in its Fig. 13, as m and n of m f1 + n f2."""


def dual_frequency(effort: Effort, options: dict) -> Outcome:
    """Fig. 13: spectra under two wavelengths."""
    f1, f2 = 150.0, 125.0
    scene = paper_scene(speed=1500.0, wavelengths=(10.0, 12.0))
    # 180 periods of f1 are 150 of f2: both lines, and all their combinations, fall on a bin of the spectrum
    ds = sweep(
        scene,
        {"speed": [1500.0]},
        record="history",
        saves_per_period=50,
        steps_per_period=STEPS,
        transient=effort.transient,
        periods=180,
        **options,
    )
    answers = {}
    for name, label in (("a_z", "A_Z"), ("alpha_x", "alpha_X"), ("alpha_y", "alpha_Y")):
        spectrum = power_spectral_density(ds[name].values[0], 50 * f1)
        ds[f"{name}_density"] = (("frequency",), spectrum.density, {"units": f"({ds[name].attrs['units']})^2/Hz"})
        ds["frequency"] = ("frequency", spectrum.frequency, {"units": "Hz", "long_name": "frequency"})
        top = float(spectrum.frequency[np.argmax(spectrum.density)])
        answers[f"N16 {label} top"] = Answer(f"{top:.1f} Hz", abs(top - f1) < 1)
        found = {k: find_line(spectrum, m * f1 + n * f2).present for k, (m, n) in DUAL_LINES.items()}
        missing = [k for k, there in found.items() if not there]
        text = f"{sum(found.values())} of {len(found)}" + (f", not {', '.join(missing)}" if missing else "")
        answers[f"N16 {label}"] = Answer(text, not missing)
    return Outcome({"dual": ds}, answers)


def exponents(effort: Effort, options: dict) -> Outcome:
    """Figs. 6, 9 and 11: largest Lyapunov exponents, with certificates."""
    speeds = np.linspace(100.0, 2500.0, effort.speeds)
    clearances = np.linspace(0.1e-3, 5e-3, effort.clearances)
    lengths = np.linspace(0.1, 0.5, effort.lengths)
    common = dict(transient=effort.transient, periods=effort.counted, **options)
    by_v = lyapunov_sweep(paper_scene(), {"speed": speeds}, steps_per_period=STEPS_SLOW, **common)
    grid, n = _clearances_then_lengths(clearances, lengths)
    both = lyapunov_sweep(paper_scene(), grid, product=False, steps_per_period=STEPS, **common)
    by_c, by_l = _cut(both, slice(0, n), "clearance"), _cut(both, slice(n, None), "length")

    def positive(ds):
        exponent, error = ds["exponent"].values[:, 0], ds["stderr"].values[:, 0]
        return exponent > np.maximum(3 * error, 1e-3)

    v, c, length = positive(by_v), positive(by_c), positive(by_l)
    low, high, step = speeds < 850, speeds > 1810, max(speeds[1] - speeds[0], 10.0)
    c_step, l_step = max(clearances[1] - clearances[0], 0.025e-3), max(lengths[1] - lengths[0], 0.0025)
    calm = [r for r in runs(~v, speeds) if r[1] < 850]
    wild = runs(c, clearances)
    brief = [r for r in wild if 1.4e-3 < r[0] < 2.0e-3]
    long = [r for r in wild if r[0] > 2e-3]
    last = float(lengths[np.flatnonzero(length & (lengths < 0.2))[-1]]) if np.any(length & (lengths < 0.2)) else None
    resolved = "{:.0%} of the cases resolved by their certificates".format
    share = {name: resolved(float(ds["resolved"].mean())) for name, ds in (("v", by_v), ("c", by_c), ("l", by_l))}
    answers = {
        "N8 window": Answer(
            f"not above zero: {show_ranges(calm)} m/s",
            any(r[0] - step <= 485 <= r[1] + step for r in calm),
            share["v"],
        ),
        "N8 low": Answer(f"{np.mean(v[low]):.0%} of the cases", bool(np.mean(v[low]) > 0.9), share["v"]),
        "N8 high": Answer(f"{np.mean(v[high]):.0%} of the cases", bool(np.mean(v[high]) > 0.9), share["v"]),
        "N11 LLE brief": Answer(
            f"{show_ranges(brief, 1e3)} mm",
            any(r[0] - c_step <= 1.675e-3 <= r[1] + c_step for r in brief),
            share["c"],
        ),
        "N11 LLE": Answer(
            f"{show_ranges(long, 1e3)} mm", any(near(r[0], 2.575e-3, c_step) for r in long), share["c"]
        ),
        "N12 LLE": Answer(
            "nowhere" if last is None else f"last at {last:.4g} m", near(last, 0.15, 2 * l_step), share["l"]
        ),
    }
    return Outcome({"speed_exponents": by_v, "clearance_exponents": by_c, "length_exponents": by_l}, answers)


def basins(effort: Effort, options: dict) -> Outcome:
    """Not in the paper: which attractor each start reaches at 1860 m/s, where the paper's and ours part."""
    side = np.linspace(-1.5, 1.5, effort.basin)
    grid = {"v_y": side, "v_z": side}
    ds = sweep(paper_scene(1860.0), grid, transient=150, periods=20, record="strobe", steps_per_period=50, **options)
    ds["attractor"] = (
        ("start_v_y", "start_v_z"),
        groups(ds),
        {"long_name": "attractor, by falling size of its basin"},
    )
    return Outcome({"basins": ds}, {})


CONVENTIONS = {
    "total play, forces clamped (the default)": (False, True),
    "play per face, forces clamped": (True, True),
    "total play, forces may pull": (False, False),
    "play per face, forces may pull": (True, False),
}
"""Readings of what the paper leaves open: whether C is the play of each face, and whether contacts only push."""


def readings(effort: Effort, options: dict) -> list[dict[str, str]]:
    """The claims that differ, under each of `CONVENTIONS`: rows of a table."""
    table = []
    slow, fast = np.arange(760.0, 1061.0, 20.0), np.arange(1780.0, 1981.0, 20.0)
    wide = np.arange(2.4e-3, 2.81e-3, 0.05e-3)
    speeds = np.concatenate([slow, fast, np.full(len(wide) + 2, 1250.0)])
    clearances = np.concatenate([np.full(len(slow) + len(fast), 1e-3), wide, [1e-3, 1e-3]])
    lengths = np.concatenate([np.full(len(speeds) - 2, 0.2), [0.1, 0.4]])
    common = dict(product=False, steps_per_period=STEPS, transient=min(effort.transient, 300), **options)
    for name, (per_face, clamp) in CONVENTIONS.items():
        scene = paper_scene(clamp=clamp)
        grid = dict(speed=speeds, clearance=clearances * (2 if per_face else 1), length=lengths)
        ds = sweep(scene, grid, **common)
        last = {k: v[-2:] for k, v in grid.items()}
        peak = sweep(scene, last, record="history", saves_per_period=50, periods=60, **common)["contact_force"]
        kinds = attractors(ds)
        parts = np.split(np.arange(len(speeds)), np.cumsum([len(slow), len(fast), len(wide)]))
        points = section_points(ds["v_y"].values[parts[0]])
        mean = np.nanmean(ds["v_y"].values[parts[1]], axis=-1)
        drop = int(np.nanargmin(np.diff(mean)))
        wild = wide[kinds.kind[parts[2]] != "period"] * 1e3
        at_900 = int(np.argmin(abs(slow - 900)))
        row = {
            "reading": name,
            "N1 900 m/s": named(kinds, at_900),
            "N4 three points in V_Y (820..980 m/s)": show_ranges(runs(points == 3, slow)),
            "N4 drop (1810 m/s)": f"{fast[drop]:.0f}..{fast[drop + 1]:.0f}",
            "N11 not periodic from (2.575 mm)": f"{wild[0]:.4g}" if wild.size else "not up to 2.8",
        }
        for k, (length, stated) in enumerate(((0.1, "1977, 8807, 5447"), (0.4, "4256, 12824, 20365"))):
            ours = [float(peak.isel(case=k).max("time").sel(end="rear", point=p)) for p in "ACJ"]
            row[f"N14 L = {length} m ({stated} N)"] = ", ".join(f"{v:.0f}" for v in ours)
        table.append(row)
    return table


RUNS: dict[str, tuple[tuple[str, ...], Callable[[Effort, dict], Outcome]]] = {
    "histories": (("4", "7", "12"), histories),
    "speed": (("5",), over_speed),
    "clearance and length": (("8", "10"), over_clearance_and_length),
    "exponents": (("6", "9", "11"), exponents),
    "dual frequency": (("13",), dual_frequency),
    "basins": (("basins",), basins),
}
"""The runs by name, with the figures that each makes."""

FIGURES = tuple(f for figures, _ in RUNS.values() for f in figures)


class Finished(NamedTuple):
    """One run that is done."""

    name: str
    figures: tuple[str, ...]
    """Those that were asked for."""
    outcome: Outcome
    seconds: float


def reproduce(
    figures: Iterable[str] = FIGURES,
    *,
    quick: bool = False,
    transient: int | None = None,
    progress: bool = False,
) -> Iterator[Finished]:
    """Runs the study, and yields each run when it is done.

    **Arguments:** `figures`: which of `FIGURES`; `quick`: coarser grids and shorter transients; `transient`: forcing
    periods before anything is recorded, for trying whether a verdict depends on it; `progress`: bars.

    **Raises:** `ValueError` for a figure that is not one of them, before anything runs.
    """
    effort = QUICK if quick else FULL
    if transient is not None:
        effort = effort._replace(transient=whole("transient", transient, 20))
    return _runs({one_of("figures", str(f), FIGURES) for f in figures}, effort, progress)


def _runs(wanted, effort, progress):
    for name, (made, run) in RUNS.items():
        if wanted & set(made):
            begin = time.perf_counter()
            outcome = run(effort, {"progress": progress})
            yield Finished(name, tuple(f for f in made if f in wanted), outcome, time.perf_counter() - begin)
