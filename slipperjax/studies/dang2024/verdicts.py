"""From the study's runs to answers: what each claim of Dang et al. 2024 comes to in the data.

"Points" are those of a Poincare section, the velocity at upward zero crossings of a coordinate. Cases with a status
other than 0 are flagged: they support no claim.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ...analysis.lyapunov import is_chaotic
from ...analysis.spectra import find_line, power_spectral_density
from ...flow.status import Status, first_problem
from ...model.quantities import SECTIONS
from ...sweeps.attractors import attractors
from ...sweeps.follow import Jump
from .claims import Answer, named, near, runs, section_points, show_ranges

BY_RECURRENCE = "by recurrence, its decay and the 0-1 test: a slow transient is not called chaos"
ENOUGH = 0.9
"""Share of a range's cases that must be free of flags, for a claim about the whole range to count as reproduced."""


def good_cases(ds: xr.Dataset) -> np.ndarray:
    """Which cases are free of flags."""
    return ds["status"].values == Status.FINITE


def case_points(ds: xr.Dataset, name: str) -> np.ndarray:
    """Number of section points of each case, -1 where it is flagged."""
    good = good_cases(ds)
    return np.where(good, section_points(np.where(good[:, None], ds[name].values, np.nan)), -1)


def case_means(ds: xr.Dataset, name: str, of: Callable = np.asarray) -> np.ndarray:
    """Mean of `of(values)` over the crossings of each case; NaN where it is flagged or crosses nothing."""
    values = [row[np.isfinite(row)] for row in of(ds[name].values)]
    return np.array([v.mean() if g and v.size else np.nan for v, g in zip(values, good_cases(ds), strict=True)])


class _Axis(NamedTuple):
    """The parameter that was varied, and which of its cases are free of flags."""

    values: np.ndarray
    step: float
    """The coarser step of the two grids, the study's and the paper's."""
    good: np.ndarray

    @classmethod
    def of(cls, ds: xr.Dataset, name: str, paper_step: float, per_unit: float = 1.0) -> "_Axis":
        """From a dataset over one parameter; with exponents, those that are not finite are flagged as well."""
        values = ds[name].values * per_unit
        good = good_cases(ds)
        if "exponent" in ds:
            good = good & np.all(np.isfinite(_largest(ds)), axis=0)
        return cls(values, max(values[1] - values[0], paper_step), good)

    def runs(self, mask: np.ndarray) -> list[tuple[float, float]]:
        """Unbroken runs of good cases where `mask` holds."""
        return runs(mask & self.good, self.values)

    def is_at(self, ours: float | None, paper: float, steps: int = 1) -> bool:
        """Whether a place is the paper's within `steps`, with no flagged case there that might have moved it."""
        around = np.abs(self.values - paper) <= (steps + 1.001) * self.step
        return near(ours, paper, steps * self.step) and bool(np.all(self.good[around]))

    def answer(self, text: str, good: Any, why: str = "") -> Answer:
        """An answer whose text says how many cases were flagged, if any were."""
        flagged = int(np.sum(~self.good))
        return Answer(f"{text}; {flagged} of {len(self.good)} cases flagged" if flagged else text, bool(good), why)


def histories(history: xr.Dataset, sections: xr.Dataset, judged: int) -> dict[str, Answer]:
    """Figs. 4, 7 and 12, from the seven single cases; attractors are named from the last `judged` periods."""
    status = first_problem(sections["status"].values, history["status"].values)
    kinds = attractors(sections, judged)
    speeds = sections["speed"].values
    roll = case_points(sections, "w_x")
    peak = history["peak_force"]
    force = lambda point, k: float(peak.sel(case=k, end="rear", point=point))

    @functools.cache
    def spectrum(k):
        return power_spectral_density(history["alpha_x"].values[k], 50 * speeds[k] / 8)

    def motion(k, as_paper):
        return lambda: Answer(named(kinds, k), bool(as_paper(k)), str(kinds.evidence[k]))

    def points(k, paper):
        return lambda: Answer(f"{roll[k]} points", bool(roll[k] == paper))

    def lines(k, *ratios):
        return [find_line(spectrum(k), ratio * speeds[k] / 8).present for ratio in ratios]

    def fundamental_and_two_thirds():
        one, two_thirds = lines(0, 1, 2 / 3)
        return Answer(f"f: {one}, 2f/3: {two_thirds}", one and two_thirds)

    def super_harmonics():
        two, three = lines(1, 2, 3)
        return Answer(f"{named(kinds, 1)}, 2f: {two}, 3f: {three}", bool(kinds.period[1] == 1 and two and three))

    def strongest():
        above = spectrum(2).frequency > 0.05 * speeds[2] / 8
        place = float(spectrum(2).frequency[above][np.argmax(spectrum(2).density[above])] / (speeds[2] / 8))
        return Answer(f"{place:.3g} f", abs(place - 0.4) < 0.05)

    def peak_force(point, k, paper):
        return lambda: Answer(f"{force(point, k):.0f} N", abs(force(point, k) / paper - 1) < 0.05)

    def softer():
        pairs = [(force(p, 5), force(p, 6)) for p in "ACJ"]
        return Answer(", ".join(f"{a:.0f} against {b:.0f} N" for a, b in pairs), all(a < b for a, b in pairs))

    # which of the seven cases an answer needs, and how it is made
    makers: dict[str, tuple[tuple[int, ...], Callable[[], Answer]]] = {
        "N1 motion": ((0,), motion(0, lambda k: kinds.period[k] == 3)),
        "N1 lines": ((0,), fundamental_and_two_thirds),
        "N1 section": ((0,), points(0, 2)),
        "N2 motion": ((1,), super_harmonics),
        "N2 section": ((1,), points(1, 1)),
        "N3 motion": ((2,), motion(2, lambda k: kinds.kind[k] == "chaotic")),
        "N3 line": ((2,), strongest),
        "N9 narrow": ((3,), motion(3, lambda k: kinds.period[k] == 1)),
        "N9 wide": ((4,), motion(4, lambda k: kinds.kind[k] != "period")),
    }
    for k, length, stated in ((5, 0.1, (1977, 8807, 5447)), (6, 0.4, (4256, 12824, 20365))):
        for point, paper in zip("ACJ", stated, strict=True):
            makers[f"N14 {point}2 {length}"] = ((k,), peak_force(point, k, paper))
    makers["N15"] = ((5, 6), softer)
    return {key: _unless_flagged(status[list(needed)], make) for key, (needed, make) in makers.items()}


def _unless_flagged(status: np.ndarray, answer: Callable[[], Answer]) -> Answer:
    """Gives the answer of `answer`, or a negative one where a case that it needs is flagged."""
    flagged = status[status != Status.FINITE]
    if not flagged.size:
        return answer()
    return Answer(f"{flagged.size} of {status.size} cases flagged", False, Status(int(flagged[0])).meaning)


def over_speed(ds: xr.Dataset, up: Jump, down: Jump, judged: int) -> dict[str, Answer]:
    """Fig. 5, from the diagram over speed and where the motion jumps when followed up and down."""
    axis = _Axis.of(ds, "speed", 10.0)
    speeds = axis.values
    points = {name: case_points(ds, name) for name in ("v_y", "v_z", "w_x")}
    kinds = attractors(ds, judged)
    calm = kinds.kind != "chaotic"  # the points of a chaotic case may lie close together by chance
    three, one = axis.runs((points["v_y"] == 3) & calm), axis.runs((points["v_y"] == 1) & calm & (speeds < 1850))
    longest = max(one, key=lambda r: r[1] - r[0], default=(np.nan, np.nan))
    drop = greatest_drop(speeds, case_means(ds, "v_y"), (1500, 2200))
    leaning = [r for r in axis.runs(points["w_x"] == 0) if r[1] > 1500]
    two = [r for r in axis.runs((points["v_z"] == 2) & calm) if 700 < r[0] < 1100]
    fast, slow = speeds > 1950, (speeds > 1000) & (speeds < 1800)
    ratio = np.array([_greatest(axis, ds, n, fast) / _greatest(axis, ds, n, slow) for n in ("w_y", "w_z")])
    nine = int(np.argmin(abs(speeds - 900)))
    return {
        "N4 period-3": axis.answer(
            f"three points: {show_ranges(three)} m/s",
            any(axis.is_at(r[0], 820) for r in three),
            f"{speeds[nine]:.0f} m/s is {named(kinds, nine)}: {kinds.evidence[nine]}",
        ),
        "N4 period-1": axis.answer("nowhere" if not one else f"{longest[0]:.0f} m/s", axis.is_at(longest[0], 980)),
        "N4 jump": axis.answer(
            "no neighbours to compare" if drop is None else f"{drop[0]:.0f}..{drop[1]:.0f} m/s from Table 2's start",
            drop is not None and axis.is_at(drop[0], 1810),
            "attractors coexist, so the start decides; "
            f"followed upwards: {jump_text(up)}, downwards: {jump_text(down)}",
        ),
        "N5": axis.answer(
            f"two points: {show_ranges(two)} m/s",
            bool(two) and axis.is_at(two[0][0], 820) and axis.is_at(two[-1][1], 980),
        ),
        "N6": axis.answer(
            f"{show_ranges(leaning)} m/s",
            bool(leaning) and axis.is_at(leaning[0][0], 1660) and axis.is_at(leaning[-1][1], 1810),
            "ends where the motion jumps, which the start decides: see N4",
        ),
        "N7": axis.answer(f"{ratio[0]:.1f} and {ratio[1]:.1f} times those of 1000..1800 m/s", np.all(ratio > 2)),
    }


def greatest_drop(
    values: np.ndarray, means: np.ndarray, within: tuple[float, float] = (-np.inf, np.inf)
) -> tuple[float, float] | None:
    """The neighbouring values between which the means fall the most; None where no two neighbours have means.

    **Arguments:** `within`: bounds of the second of the two values.
    """
    falls = np.where((values[1:] > within[0]) & (values[1:] < within[1]), np.diff(means), np.nan)
    if np.all(np.isnan(falls)):
        return None
    at = int(np.nanargmin(falls))
    return float(values[at]), float(values[at + 1])


def jump_text(jump: Jump) -> str:
    """Where a followed motion jumped [m/s], or why no jump was found."""
    if jump.found:
        low, high = sorted((jump.before, jump.after))
        return f"{low:.0f}..{high:.0f} m/s"
    if jump.status != Status.FINITE:
        return f"search ended at {jump.after:.0f} m/s ({jump.status.meaning})"
    return "no jump"


def _greatest(axis: _Axis, ds: xr.Dataset, name: str, where: np.ndarray) -> float:
    """Greatest size of a velocity among the good cases of a range; NaN where there is none."""
    values = np.abs(ds[name].values[where & axis.good])
    values = values[np.isfinite(values)]
    return float(values.max()) if values.size else float("nan")


def over_clearance(ds: xr.Dataset, judged: int) -> dict[str, Answer]:
    """Fig. 8."""
    axis = _Axis.of(ds, "clearance", 0.025, 1e3)
    c = axis.values
    kinds = attractors(ds, judged)
    small = c < 2.575
    grows = {name: _correlation(c[small], case_means(ds, name, np.abs)[small]) for name in SECTIONS}
    one = np.mean(kinds.period[small] == 1)
    pitch = axis.runs(case_points(ds, "w_y") == 2)
    wild = axis.runs(kinds.kind != "period")
    brief = [r for r in axis.runs(kinds.period != 1) if 1.4 < r[0] < 2.0]
    return {
        "N10 growth": axis.answer(
            ", ".join(f"{k}: r = {v:.2f}" for k, v in grows.items()),
            np.all(np.array(list(grows.values())) > 0.8) and np.mean(axis.good[small]) >= ENOUGH,
        ),
        "N10 period-1": axis.answer(f"{one:.0%} period-1", one > 0.5),
        "N10 brief": axis.answer(f"{show_ranges(brief)} mm not period-1", _covers(brief, 1.675, axis.step)),
        "N10 pitch": axis.answer(f"{show_ranges(pitch[:1])} mm", bool(pitch) and axis.is_at(pitch[0][0], 0.6)),
        "N11": axis.answer(
            f"not periodic: {show_ranges(wild)} mm", any(axis.is_at(r[0], 2.575) for r in wild), BY_RECURRENCE
        ),
    }


def _correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Correlation coefficient of the pairs without NaN; NaN where there are fewer than three."""
    finite = np.isfinite(y)
    return float(np.corrcoef(x[finite], y[finite])[0, 1]) if np.sum(finite) > 2 else float("nan")


def _covers(ranges: list[tuple[float, float]], place: float, step: float) -> bool:
    return any(a - step <= place <= b + step for a, b in ranges)


def over_length(ds: xr.Dataset, judged: int) -> dict[str, Answer]:
    """Fig. 10."""
    axis = _Axis.of(ds, "length", 0.0025)
    length = axis.values
    kinds = attractors(ds, judged)
    last = _last(length, axis.good & (kinds.kind != "period") & (length < 0.2))
    late = length > 0.16
    spread = np.array([_spread(case_means(ds, name)[late]) for name in ("v_y", "v_z")])
    two = [r for r in axis.runs(case_points(ds, "w_y") == 2) if 0.18 < r[0] < 0.25]
    return {
        "N12 chaos": axis.answer(
            "periodic everywhere" if last is None else f"last that is not periodic: {last:.4g} m",
            axis.is_at(last, 0.15, 2),
            BY_RECURRENCE,
        ),
        "N12 constant": axis.answer(
            f"spread {spread[0]:.3f} and {spread[1]:.3f} m/s",
            np.all(spread < 0.05) and np.mean(axis.good[late]) >= ENOUGH,
        ),
        "N13": axis.answer(
            f"{show_ranges(two)} m", bool(two) and axis.is_at(two[0][0], 0.1975) and axis.is_at(two[-1][1], 0.2275)
        ),
    }


def _spread(values: np.ndarray) -> float:
    """Standard deviation of the values without NaN; NaN where there are fewer than two."""
    finite = values[np.isfinite(values)]
    return float(finite.std()) if finite.size > 1 else float("nan")


def _last(values: np.ndarray, mask: np.ndarray) -> float | None:
    """The last value where `mask` holds; None where it holds nowhere."""
    return float(values[mask][-1]) if np.any(mask) else None


DUAL_LINES = {
    "f1": (1, 0), "f2": (0, 1), "2f1": (2, 0), "3f2": (0, 3), "4f2": (0, 4), "2f2-f1": (-1, 2), "2f1-f2": (2, -1),
    "f1+f2": (1, 1), "3f1-f2": (3, -1), "4f2-f1": (-1, 4), "f1+2f2": (1, 2), "2f1+f2": (2, 1), "4f1-f2": (4, -1),
}  # fmt: skip
"""Lines that the paper names in its Fig. 13, as m and n of m f1 + n f2."""
F1, F2 = 150.0, 125.0
"""The two forcing frequencies of Fig. 13 [Hz]."""


def dual_frequency(ds: xr.Dataset) -> tuple[xr.Dataset, dict[str, Answer]]:
    """Fig. 13: the history with its spectra added, and what lines they have; no spectra where it is flagged."""
    answers = {}
    names = {"a_z": "A_Z", "alpha_x": "alpha_X", "alpha_y": "alpha_Y"}
    if np.any(ds["status"].values != Status.FINITE):
        flagged = _unless_flagged(ds["status"].values, lambda: Answer("", False))
        return ds, {f"N16 {label}{part}": flagged for label in names.values() for part in (" top", "")}
    for name, label in names.items():
        spectrum = power_spectral_density(ds[name].values[0], 50 * F1)
        density = (("frequency",), spectrum.density, {"units": f"({ds[name].attrs['units']})^2/Hz"})
        frequency = ("frequency", spectrum.frequency, {"units": "Hz", "long_name": "frequency"})
        ds = ds.assign_coords(frequency=frequency).assign({f"{name}_density": density})
        top = float(spectrum.frequency[np.argmax(spectrum.density)])
        answers[f"N16 {label} top"] = Answer(f"{top:.1f} Hz", abs(top - F1) < 1)
        missing = [k for k, (m, n) in DUAL_LINES.items() if not find_line(spectrum, m * F1 + n * F2).present]
        count = len(DUAL_LINES)
        text = f"{count - len(missing)} of {count}" + (f", not {', '.join(missing)}" if missing else "")
        answers[f"N16 {label}"] = Answer(text, not missing)
    return ds, answers


def _largest(ds: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """The largest exponents and their standard errors [1/period]."""
    return ds["exponent"].isel(count=0).values, ds["stderr"].isel(count=0).values


def _share(ds: xr.Dataset) -> str:
    return f"{float(ds['resolved'].mean()):.0%} of the cases resolved by their certificates"


def exponents_over_speed(ds: xr.Dataset) -> dict[str, Answer]:
    """Fig. 6."""
    axis = _Axis.of(ds, "speed", 10.0)
    positive = is_chaotic(*_largest(ds)) & axis.good
    calm = [r for r in axis.runs(~positive) if r[1] < 850]
    window = any(axis.is_at(r[0], 480) and axis.is_at(r[1], 490) for r in calm)
    # flagged cases are in the denominator, so that they never help a claim
    low, high = (float(np.mean(positive[part])) for part in (axis.values < 850, axis.values > 1810))
    return {
        "N8 window": axis.answer(f"not above zero: {show_ranges(calm)} m/s", window, _share(ds)),
        "N8 low": axis.answer(f"{low:.0%} of the cases", low > 0.9, _share(ds)),
        "N8 high": axis.answer(f"{high:.0%} of the cases", high > 0.9, _share(ds)),
    }


def exponents_over_clearance(ds: xr.Dataset) -> dict[str, Answer]:
    """Fig. 9."""
    axis = _Axis.of(ds, "clearance", 0.025, 1e3)
    wild = axis.runs(is_chaotic(*_largest(ds)))
    brief, wide = [r for r in wild if 1.4 < r[0] < 2.0], [r for r in wild if r[0] > 2]
    return {
        "N11 LLE brief": axis.answer(f"{show_ranges(brief)} mm", _covers(brief, 1.675, axis.step), _share(ds)),
        "N11 LLE": axis.answer(f"{show_ranges(wide)} mm", any(axis.is_at(r[0], 2.575) for r in wide), _share(ds)),
    }


def exponents_over_length(ds: xr.Dataset) -> dict[str, Answer]:
    """Fig. 11."""
    axis = _Axis.of(ds, "length", 0.0025)
    last = _last(axis.values, is_chaotic(*_largest(ds)) & axis.good & (axis.values < 0.2))
    text = "nowhere" if last is None else f"last at {last:.4g} m"
    return {"N12 LLE": axis.answer(text, axis.is_at(last, 0.15, 2), _share(ds))}


EXPONENTS: dict[str, Callable[[xr.Dataset], dict[str, Answer]]] = {
    "speed": exponents_over_speed,
    "clearance": exponents_over_clearance,
    "length": exponents_over_length,
}
"""Functions from exponents to answers, by parameter."""
