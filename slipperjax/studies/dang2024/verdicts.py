"""From the study's runs to answers: what each claim of Dang et al. 2024 comes to in our data.

"Points" are those of a Poincare section, the velocity at upward zero crossings of a coordinate.
"""

import numpy as np
import xarray as xr

from .analysis.spectrum import find_line, power_spectral_density
from .branches import Jump, attractors
from .claims import Answer, named, near, runs, section_points, show_ranges

BY_RECURRENCE = "by recurrence, its decay and the 0-1 test: a slow transient is not called chaos"


def histories(history: xr.Dataset, sections: xr.Dataset, judged: int) -> dict[str, Answer]:
    """Figs. 4, 7 and 12, from the seven single cases; attractors are named from the last `judged` periods."""
    kinds = attractors(sections, judged)
    speeds = sections["speed"].values
    roll = section_points(sections["w_x"].values)
    spectra = [power_spectral_density(history["alpha_x"].values[k], 50 * speeds[k] / 8) for k in range(3)]
    at = spectra[2].frequency > 0.05 * speeds[2] / 8
    strongest = float(spectra[2].frequency[at][np.argmax(spectra[2].density[at])] / (speeds[2] / 8))
    present = lambda k, ratio: find_line(spectra[k], ratio * speeds[k] / 8).present
    peak = history["contact_force"].max("time")
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
        "N3 line": Answer(f"{strongest:.3g} f", abs(strongest - 0.4) < 0.05),
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
    return answers


def over_speed(ds: xr.Dataset, up: Jump | None, down: Jump | None, judged: int) -> dict[str, Answer]:
    """Fig. 5, from the diagram over speed and where the motion jumps when followed up and down."""
    speeds = ds["speed"].values
    step = max(speeds[1] - speeds[0], 10.0)
    points = {name: section_points(ds[name].values) for name in ("v_y", "v_z", "w_x", "w_y")}
    kinds = attractors(ds, judged)
    three, one = runs(points["v_y"] == 3, speeds), runs((points["v_y"] == 1) & (speeds < 1850), speeds)
    longest = max(one, key=lambda r: r[1] - r[0], default=(np.nan, np.nan))
    mean = np.array([np.nanmean(v) if np.isfinite(v).any() else np.nan for v in ds["v_y"].values])
    high = np.flatnonzero((speeds[1:] > 1500) & (speeds[1:] < 2200))
    drop = high[np.nanargmin(np.diff(mean)[high])]
    leaning = [r for r in runs(points["w_x"] == 0, speeds) if r[1] > 1500]
    two = [r for r in runs(points["v_z"] == 2, speeds) if 700 < r[0] < 1100]
    rate = lambda name, where: np.nanmax(np.abs(ds[name].values[where]))
    ratio = [rate(n, speeds > 1950) / rate(n, (speeds > 1000) & (speeds < 1800)) for n in ("w_y", "w_z")]
    upwards = "no jump" if up is None else f"{up.before:.0f}..{up.after:.0f} m/s"
    downwards = "no jump" if down is None else f"{down.after:.0f}..{down.before:.0f} m/s"
    nine = int(np.argmin(abs(speeds - 900)))
    return {
        "N4 period-3": Answer(
            f"three points: {show_ranges(three)} m/s",
            any(near(r[0], 820, step) for r in three),
            f"{speeds[nine]:.0f} m/s is {named(kinds, nine)}: {kinds.evidence[nine]}",
        ),
        "N4 period-1": Answer(f"{longest[0]:.0f} m/s", near(longest[0], 980, step)),
        "N4 jump": Answer(
            f"{speeds[drop]:.0f}..{speeds[drop + 1]:.0f} m/s from Table 2's start",
            near(speeds[drop], 1810, step),
            f"attractors coexist, so the start decides; followed upwards: {upwards}, downwards: {downwards}",
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


def over_clearance(ds: xr.Dataset, judged: int) -> dict[str, Answer]:
    """Fig. 8."""
    c = ds["clearance"].values * 1e3
    step = max(c[1] - c[0], 0.025)
    kinds = attractors(ds, judged)
    small = c < 2.575
    level = lambda name: np.nanmean(np.abs(ds[name].values[small]), axis=-1)
    grows = {name: np.corrcoef(c[small], level(name))[0, 1] for name in ("v_y", "v_z", "w_x", "w_y", "w_z")}
    one = np.mean(kinds.period[small] == 1)
    pitch = runs(section_points(ds["w_y"].values) == 2, c)
    wild = runs(kinds.kind != "period", c)
    brief = [r for r in runs(kinds.period != 1, c) if 1.4 < r[0] < 2.0]
    growth = ", ".join(f"{k}: r = {v:.2f}" for k, v in grows.items())
    return {
        "N10 growth": Answer(growth, min(grows.values()) > 0.8),
        "N10 period-1": Answer(f"{one:.0%} period-1", one > 0.5),
        "N10 brief": Answer(
            f"{show_ranges(brief)} mm not period-1", any(r[0] - step <= 1.675 <= r[1] + step for r in brief)
        ),
        "N10 pitch": Answer(f"{show_ranges(pitch[:1])} mm", bool(pitch) and near(pitch[0][0], 0.6, step)),
        "N11": Answer(
            f"not periodic: {show_ranges(wild)} mm", any(near(r[0], 2.575, step) for r in wild), BY_RECURRENCE
        ),
    }


def over_length(ds: xr.Dataset, judged: int) -> dict[str, Answer]:
    """Fig. 10."""
    length = ds["length"].values
    step = max(length[1] - length[0], 0.0025)
    kinds = attractors(ds, judged)
    unsettled = np.flatnonzero((kinds.kind != "period") & (length < 0.2))
    last = float(length[unsettled[-1]]) if unsettled.size else None
    late = length > 0.16
    spread = [np.nanstd(np.nanmean(ds[name].values[late], axis=-1)) for name in ("v_y", "v_z")]
    two = [r for r in runs(section_points(ds["w_y"].values) == 2, length) if 0.18 < r[0] < 0.25]
    return {
        "N12 chaos": Answer(
            "periodic everywhere" if last is None else f"last that is not periodic: {last:.4g} m",
            near(last, 0.15, 2 * step),
            BY_RECURRENCE,
        ),
        "N12 constant": Answer(f"spread {spread[0]:.3f} and {spread[1]:.3f} m/s", max(spread) < 0.05),
        "N13": Answer(
            f"{show_ranges(two)} m",
            bool(two) and near(two[0][0], 0.1975, step) and near(two[-1][1], 0.2275, step),
        ),
    }


DUAL_LINES = {
    "f1": (1, 0), "f2": (0, 1), "2f1": (2, 0), "3f2": (0, 3), "4f2": (0, 4), "2f2-f1": (-1, 2), "2f1-f2": (2, -1),
    "f1+f2": (1, 1), "3f1-f2": (3, -1), "4f2-f1": (-1, 4), "f1+2f2": (1, 2), "2f1+f2": (2, 1), "4f1-f2": (4, -1),
}  # fmt: skip
"""Lines that the paper names in its Fig. 13, as m and n of m f1 + n f2."""
F1, F2 = 150.0, 125.0
"""The two forcing frequencies of Fig. 13 [Hz]."""


def dual_frequency(ds: xr.Dataset) -> tuple[xr.Dataset, dict[str, Answer]]:
    """Fig. 13: the history with its spectra added, and what lines they have."""
    answers = {}
    for name, label in (("a_z", "A_Z"), ("alpha_x", "alpha_X"), ("alpha_y", "alpha_Y")):
        spectrum = power_spectral_density(ds[name].values[0], 50 * F1)
        ds[f"{name}_density"] = (("frequency",), spectrum.density, {"units": f"({ds[name].attrs['units']})^2/Hz"})
        ds["frequency"] = ("frequency", spectrum.frequency, {"units": "Hz", "long_name": "frequency"})
        top = float(spectrum.frequency[np.argmax(spectrum.density)])
        answers[f"N16 {label} top"] = Answer(f"{top:.1f} Hz", abs(top - F1) < 1)
        found = {k: find_line(spectrum, m * F1 + n * F2).present for k, (m, n) in DUAL_LINES.items()}
        missing = [k for k, there in found.items() if not there]
        text = f"{sum(found.values())} of {len(found)}" + (f", not {', '.join(missing)}" if missing else "")
        answers[f"N16 {label}"] = Answer(text, not missing)
    return ds, answers


def _positive(ds: xr.Dataset) -> np.ndarray:
    exponent, error = ds["exponent"].values[:, 0], ds["stderr"].values[:, 0]
    return exponent > np.maximum(3 * error, 1e-3)


def _share(ds: xr.Dataset) -> str:
    return f"{float(ds['resolved'].mean()):.0%} of the cases resolved by their certificates"


def exponents_over_speed(ds: xr.Dataset) -> dict[str, Answer]:
    """Fig. 6."""
    speeds, positive = ds["speed"].values, _positive(ds)
    step = max(speeds[1] - speeds[0], 10.0)
    calm = [r for r in runs(~positive, speeds) if r[1] < 850]
    window = any(near(r[0], 480, step) and near(r[1], 490, step) for r in calm)
    low, high = (float(np.mean(positive[part])) for part in (speeds < 850, speeds > 1810))
    return {
        "N8 window": Answer(f"not above zero: {show_ranges(calm)} m/s", window, _share(ds)),
        "N8 low": Answer(f"{low:.0%} of the cases", low > 0.9, _share(ds)),
        "N8 high": Answer(f"{high:.0%} of the cases", high > 0.9, _share(ds)),
    }


def exponents_over_clearance(ds: xr.Dataset) -> dict[str, Answer]:
    """Fig. 9."""
    c = ds["clearance"].values * 1e3
    step = max(c[1] - c[0], 0.025)
    wild = runs(_positive(ds), c)
    brief, wide = [r for r in wild if 1.4 < r[0] < 2.0], [r for r in wild if r[0] > 2]
    here = any(r[0] - step <= 1.675 <= r[1] + step for r in brief)
    return {
        "N11 LLE brief": Answer(f"{show_ranges(brief)} mm", here, _share(ds)),
        "N11 LLE": Answer(f"{show_ranges(wide)} mm", any(near(r[0], 2.575, step) for r in wide), _share(ds)),
    }


def exponents_over_length(ds: xr.Dataset) -> dict[str, Answer]:
    """Fig. 11."""
    length = ds["length"].values
    step = max(length[1] - length[0], 0.0025)
    short = np.flatnonzero(_positive(ds) & (length < 0.2))
    last = float(length[short[-1]]) if short.size else None
    text = "nowhere" if last is None else f"last at {last:.4g} m"
    return {"N12 LLE": Answer(text, near(last, 0.15, 2 * step), _share(ds))}
