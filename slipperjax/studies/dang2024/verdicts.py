"""Measures of the study's diagrams and single cases, compared with the paper's values.

"Points" are points of a Poincare section: the velocity at upward zero crossings of a coordinate. Cases with a status
other than 0 are flagged: they support no claim.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from ...analysis.attractor import Attractors
from ...analysis.lyapunov import is_chaotic
from ...analysis.spectra import Spectrum, find_line, power_spectral_density
from ...flow.status import Status, first_problem
from ...model.quantities import SECTIONS
from ...sweeps.attractors import attractors
from ...tools.types import Numbers

Range = tuple[float, float]
"""First and last value of a range of a parameter."""


class Answer(NamedTuple):
    """Value found here for a claim."""

    ours: str
    good: bool
    """Whether it agrees with the paper: within a step of the grid for places on an axis, within 5 % for forces."""
    why: str = ""
    """Evidence: reason of a difference, or how the answer was decided."""


def good_cases(ds: xr.Dataset) -> np.ndarray:
    """Return which cases are free of flags."""
    return ds["status"].values == Status.FINITE


def section_points(values: np.ndarray) -> np.ndarray:
    """Return the number of distinct points of each case on a section, 0 where all its values are NaN.

    Points count as one where no gap between them exceeds 1 % of the whole diagram's extent.

    **Arguments:** `values`: (cases, crossings), NaN where a case has fewer crossings.
    """
    # sort puts NaN last
    ordered = np.sort(values, axis=-1)
    present = values[np.isfinite(values)]
    # percentiles leave out outliers
    extent = np.percentile(present, 99) - np.percentile(present, 1) if present.size else 0.0
    gaps = np.sum(np.diff(ordered, axis=-1) > 0.01 * extent, axis=-1)
    # n gaps are between n + 1 points, unless there are none
    return gaps + np.isfinite(ordered[..., 0])


def case_points(ds: xr.Dataset, section: str) -> np.ndarray:
    """Return the number of points of each case on a section, 0 where it is flagged."""
    # as NaN, so that flagged cases do not count for the extent of the diagram
    good = good_cases(ds)[:, None]
    return section_points(np.where(good, ds[section].values, np.nan))


def unbroken_ranges(mask: np.ndarray, values: np.ndarray) -> list[Range]:
    """Return the first and last of the `values` in each unbroken range of True in `mask`."""
    # edges alternate: the first case of a range, and the first case after it
    edges = np.flatnonzero(np.diff(np.pad(mask, 1)))
    return [(float(values[a]), float(values[b - 1])) for a, b in edges.reshape(-1, 2)]


# --- diagrams over a parameter --------------------------------------------------------------------------------------


class Diagram:
    """A sweep over one parameter, in the paper's unit of the parameter."""

    kinds: Attractors
    """Attractors of the cases; only for a sweep with sections."""
    positive: np.ndarray
    """Whether the largest exponent is above zero; only for a sweep of exponents."""

    def __init__(self, ds: xr.Dataset, name: str, judged: int = 0, evidence: str = ""):
        """**Arguments:** `name`: of the parameter; `judged`: number of the last periods that classify attractors;
        `evidence`: for answers that have no evidence of their own."""
        # the paper's unit over the SI unit, the step of the paper's grid, and the unit's name
        per_unit, paper_step, self.unit = {
            "speed": (1.0, 10.0, "m/s"),
            "clearance": (1e3, 0.025, "mm"),
            "length": (1.0, 0.0025, "m"),
        }[name]
        self.ds = ds
        self.evidence = evidence
        self.values = ds[name].values * per_unit
        # step of the coarser grid, the study's or the paper's
        self.step = max(self.values[1] - self.values[0], paper_step)
        self.status = ds["status"].values
        self.good = good_cases(ds)
        # a sweep of exponents records no sections
        if "exponent" in ds:
            largest = ds.isel(count=0)
            exponent = largest["exponent"].values
            stderr = largest["stderr"].values
            self.good = self.good & np.isfinite(exponent) & np.isfinite(stderr)
            self.positive = is_chaotic(exponent, stderr)
            self.evidence = f"{float(ds['resolved'].mean()):.0%} of the cases resolved by their certificates"
        else:
            self.kinds = attractors(ds, judged)

    def has_points(self, section: str, count: int) -> np.ndarray:
        """Return which cases have `count` points on a section."""
        return case_points(self.ds, section) == count

    def is_chaotic(self) -> np.ndarray:
        """Return which cases are chaotic; by chance a chaotic case may have few points on a section."""
        return self.kinds.kind == "chaotic"

    def means(self, section: str, of: Callable = np.positive) -> np.ndarray:
        """Return the mean of `of(velocity)` over the crossings of each case; NaN where flagged or without
        crossings."""
        velocities = of(self.ds[section])
        return velocities.where(self.ds["status"] == Status.FINITE).mean("crossing").values

    def inside(self, within: Range) -> np.ndarray:
        """Return which cases are inside a range."""
        return (self.values > within[0]) & (self.values < within[1])

    def greatest(self, section: str, within: Range) -> float:
        """Return the greatest magnitude of a velocity among the good cases of a range; -infinity without any."""
        sizes = np.abs(self.ds[section].values[self.inside(within) & self.good])
        return float(np.nanmax(sizes, initial=-np.inf))

    def knows(self, within: Range) -> bool:
        """Return whether 90 % of a range's cases are free of flags, enough for a claim about the whole range."""
        return bool(np.mean(self.good[self.inside(within)]) >= 0.9)

    def is_at(self, ours: float, paper: float, steps: int = 1) -> bool:
        """Return whether a place on the axis agrees with the paper's within `steps`, with no flagged case near it."""
        # next to a flagged case, which interrupts a range, the place may come from the flag
        around = np.abs(self.values - paper) <= (steps + 1.001) * self.step
        # slightly more than whole steps, because values of a grid are rounded
        return bool(abs(ours - paper) <= 1.001 * steps * self.step and np.all(self.good[around]))


Where = Callable[[Diagram], np.ndarray]
"""Condition: a function that returns for which cases of a diagram it holds."""


def ranges(
    of: Diagram,
    where: Where,
    begins: float | None = None,
    ends: float | None = None,
    covers: float | None = None,
    within: Range = (-np.inf, np.inf),
    steps: int = 1,
) -> Answer:
    """Return the ranges in which a condition holds; they agree if one range begins, ends, or covers a value as in the
    paper.

    **Arguments:** `begins`, `ends`, `covers`: the paper's places; `within`: bounds of the beginnings of ranges that
    count; `steps`: steps of the grid by which a place may differ.
    """
    # flagged cases interrupt a range
    unbroken = unbroken_ranges(where(of) & of.good, of.values)
    found = [(first, last) for first, last in unbroken if within[0] < first < within[1]]
    agrees = [bool(found)]
    if begins is not None:
        agrees.append(any(of.is_at(first, begins, steps) for first, _ in found))
    if ends is not None:
        agrees.append(any(of.is_at(last, ends, steps) for _, last in found))
    # a range that ends one step before the place also covers it
    if covers is not None:
        agrees.append(any(first - of.step <= covers <= last + of.step for first, last in found))
    texts = [f"{first:.4g}" + (f"..{last:.4g}" if last > first else "") for first, last in found]
    return Answer(f"{', '.join(texts)} {of.unit}" if texts else "nowhere", all(agrees))


def share(of: Diagram, where: Where, within: Range, least: float = 0.9) -> Answer:
    """Return the share of a range's cases for which a condition holds; it agrees above `least`."""
    # flagged cases count as cases where the condition does not hold, so that they never help the claim
    found = np.mean((where(of) & of.good)[of.inside(within)])
    return Answer(f"{found:.0%} of the cases", bool(found > least))


def drop(of: Diagram, section: str, at: float, within: Range) -> Answer:
    """Return the neighbouring values between which the mean velocity on a section falls the most.

    **Arguments:** `within`: bounds of the second of the two values.
    """
    # NaN outside the range, and where one of two neighbours has no mean
    falls = np.where(of.inside(within)[1:], np.diff(of.means(section)), np.nan)
    if np.all(np.isnan(falls)):
        return Answer("no neighbours to compare", False)
    k = int(np.nanargmin(falls))
    return Answer(f"{of.values[k]:.0f}..{of.values[k + 1]:.0f} {of.unit}", of.is_at(of.values[k], at))


def larger(of: Diagram, sections: tuple[str, ...], within: Range, than: Range) -> Answer:
    """Return the ratios of the greatest velocities of a range to those of another; they agree if all exceed 2."""
    ratios = [of.greatest(name, within) / of.greatest(name, than) for name in sections]
    text = " and ".join(f"{ratio:.1f}" for ratio in ratios)
    return Answer(f"{text} times those of {than[0]:.0f}..{than[1]:.0f} {of.unit}", min(ratios) > 2)


def growth(of: Diagram, within: Range) -> Answer:
    """Return the correlation of the mean velocity on each section with the parameter; all agree if above 0.8."""
    found = {}
    for name in SECTIONS:
        means = of.means(name, np.abs)
        known = of.inside(within) & np.isfinite(means)
        # two points are always on a line, so that the correlation would be one
        found[name] = np.corrcoef(of.values[known], means[known])[0, 1] if known.sum() > 2 else np.nan
    text = ", ".join(f"{name}: r = {r:.2f}" for name, r in found.items())
    return Answer(text, of.knows(within) and all(r > 0.8 for r in found.values()))


def constant(of: Diagram, sections: tuple[str, ...], within: Range) -> Answer:
    """Return the standard deviations of mean velocities [m/s]; below 0.05 m/s they agree with a constant."""
    spreads = []
    for name in sections:
        means = of.means(name)[of.inside(within)]
        means = means[np.isfinite(means)]
        spreads.append(np.std(means) if means.size else np.nan)
    text = " and ".join(f"{spread:.3f}" for spread in spreads)
    return Answer(f"spread {text} m/s", of.knows(within) and all(spread < 0.05 for spread in spreads))


# --- single cases ---------------------------------------------------------------------------------------------------


def named(kinds: Attractors, k: int) -> str:
    """Return the attractor of case number k as a text."""
    period = int(kinds.period[k])
    return f"period-{period}" if period else str(kinds.kind[k])


class Singles:
    """Single cases: their histories, with 50 samples per forcing period, and their sections."""

    evidence = ""

    def __init__(self, history: xr.Dataset, forcing: Numbers, sections: xr.Dataset | None = None, judged: int = 0):
        """**Arguments:** `forcing`: forcing frequency of each case [Hz]; `judged`: as for `Diagram`."""
        self.history = history
        self.forcing = np.asarray(forcing)
        self.status = history["status"].values
        # claims on spectra need no sections
        if sections is not None:
            self.status = first_problem(sections["status"].values, self.status)
            self.kinds = attractors(sections, judged)
            self.roll = case_points(sections, "w_x")
        self.good = self.status == Status.FINITE

    def spectrum(self, k: int, name: str) -> Spectrum:
        """Return the spectrum of an acceleration of case number k."""
        # 50 samples per forcing period
        return power_spectral_density(self.history[name].values[k], 50 * self.forcing[k])

    def peak(self, k: int, point: str) -> float:
        """Return the greatest force [N] at a point of the rear end in case number k."""
        return float(self.history["peak_force"].sel(case=k, end="rear", point=point))


def motion(of: Singles, k: int, wanted: str, lines: Mapping[str, float] | None = None) -> Answer:
    """Return the kind of a motion; it agrees if it is `wanted` and the roll acceleration has all `lines`."""
    text = named(of.kinds, k)
    # a motion that is not periodic may be a torus, chaos or unresolved
    good = not text.startswith("period") if wanted == "not periodic" else text == wanted
    if lines:
        has = spectral_lines(of, k, "alpha_x", lines)
        text = f"{text}, lines: {has.ours}"
        good = good and has.good
    return Answer(text, good, str(of.kinds.evidence[k]))


def roll_points(of: Singles, k: int, count: int) -> Answer:
    """Return the number of points on the roll section, which agrees if it is `count`."""
    return Answer(f"{of.roll[k]} points", bool(of.roll[k] == count))


def spectral_lines(of: Singles, k: int, name: str, lines: Mapping[str, float]) -> Answer:
    """Return how many of the lines a spectrum has, given their frequencies [Hz]; it agrees if it has all."""
    spectrum = of.spectrum(k, name)
    missing = [text for text, frequency in lines.items() if not find_line(spectrum, frequency).present]
    text = f"{len(lines) - len(missing)} of {len(lines)}"
    return Answer(f"{text}, not {', '.join(missing)}" if missing else text, not missing)


def highest_line(of: Singles, k: int, name: str, at: float, tolerance: float) -> Answer:
    """Return the frequency of a spectrum's highest line as a multiple of the forcing frequency."""
    spectrum = of.spectrum(k, name)
    # the lowest frequencies are left out: they belong to a drift, not to a line
    density = np.where(spectrum.frequency > 0.05 * of.forcing[k], spectrum.density, 0.0)
    place = float(spectrum.frequency[np.argmax(density)] / of.forcing[k])
    return Answer(f"{place:.4g} f", abs(place - at) < tolerance)


def peak_force(of: Singles, k: int, point: str, newtons: float) -> Answer:
    """Return the greatest force at a point, which agrees within 5 % of `newtons`."""
    force = of.peak(k, point)
    return Answer(f"{force:.0f} N", abs(force / newtons - 1) < 0.05)


def softer(of: Singles, k: int, other: int) -> Answer:
    """Return the greatest forces in two cases; they agree if those of the first are less at every point."""
    # the points for which the paper has forces
    pairs = [(of.peak(k, point), of.peak(other, point)) for point in "ACJ"]
    text = ", ".join(f"{a:.0f} against {b:.0f} N" for a, b in pairs)
    return Answer(text, all(a < b for a, b in pairs))
