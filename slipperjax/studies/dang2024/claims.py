"""The claims of Dang et al. 2024 as data, and the report that compares them with the answers found here."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...tools.files import table_lines, write_each

CLAIMS: dict[str, tuple[str, str, str]] = {
    # key: figure, claim, the paper's value
    "N1 motion": ("Fig. 4a", "900 m/s: roll acceleration repeats every 3/f", "period-3"),
    "N1 lines": ("Fig. 4a", "900 m/s: energy at f and 2f/3", "lines at f and 2f/3"),
    "N1 section": ("Fig. 4a", "900 m/s: roll section", "2 points"),
    "N2 motion": ("Fig. 4b", "1500 m/s: period-1 with super-harmonics", "period-1, lines at 2f and 3f"),
    "N2 section": ("Fig. 4b", "1500 m/s: roll section", "1 point"),
    "N3 motion": ("Fig. 4c", "2300 m/s: chaotic", "chaotic"),
    "N3 line": ("Fig. 4c", "2300 m/s: strongest line", "0.4 f"),
    "N4 period-3": ("Fig. 5", "V_Y from chaotic to period-3", "820 m/s"),
    "N4 period-1": ("Fig. 5", "V_Y to period-1", "980 m/s"),
    "N4 jump": ("Fig. 5", "V_Y drops sharply", "1810 m/s"),
    "N5": ("Fig. 5", "V_Z is period-2 between", "820..980 m/s"),
    "N6": ("Fig. 5", "the roll section is never crossed", "1660..1810 m/s"),
    "N7": ("Fig. 5", "pitch and yaw rates very large above 1810 m/s", "very large"),
    "N8 window": ("Fig. 6", "below 850 m/s chaotic (LLE > 0) except a periodic window", "480..490 m/s"),
    "N8 low": ("Fig. 6", "LLE > 0 below 850 m/s", "all but the window"),
    "N8 high": ("Fig. 6", "LLE > 0 above 1810 m/s", "all"),
    "N9 narrow": ("Fig. 7", "C = 1 mm: closed orbits, isolated section points", "period-1"),
    "N9 wide": ("Fig. 7", "C = 4 mm: orbits of finite width", "not periodic"),
    "N10 growth": ("Fig. 8", "below 2.575 mm all rates grow with C", "all grow"),
    "N10 period-1": ("Fig. 8", "below 2.575 mm mostly period-1", "mostly"),
    "N10 brief": ("Fig. 8", "brief bifurcation", "1.675 mm"),
    "N10 pitch": ("Fig. 8", "pitch has two section points from", "0.6 mm"),
    "N11": ("Figs. 8, 9", "bifurcation to chaos", "2.575 mm"),
    "N11 LLE brief": ("Fig. 9", "LLE briefly above 0", "1.675 mm"),
    "N11 LLE": ("Fig. 9", "LLE above 0 from", "2.575 mm"),
    "N12 LLE": ("Fig. 11", "LLE above 0 below", "0.15 m"),
    "N12 chaos": ("Fig. 10", "chaotic below, periodic above", "0.15 m"),
    "N12 constant": ("Fig. 10", "V_Y and V_Z do not vary with L above 0.15 m", "constant"),
    "N13": ("Fig. 10", "pitch has two section points", "0.1975..0.2275 m"),
    "N14 A2 0.1": ("Fig. 12", "L = 0.1 m: peak force at A2", "1977 N"),
    "N14 C2 0.1": ("Fig. 12", "L = 0.1 m: peak force at C2", "8807 N"),
    "N14 J2 0.1": ("Fig. 12", "L = 0.1 m: peak force at J2", "5447 N"),
    "N14 A2 0.4": ("Fig. 12", "L = 0.4 m: peak force at A2", "4256 N"),
    "N14 C2 0.4": ("Fig. 12", "L = 0.4 m: peak force at C2", "12824 N"),
    "N14 J2 0.4": ("Fig. 12", "L = 0.4 m: peak force at J2", "20365 N"),
    "N15": ("Fig. 12", "the chaotic slipper (0.1 m) is hit more softly than the periodic one (0.4 m)", "every peak"),
    "N16 A_Z top": ("Fig. 13", "A_Z: highest line", "f1"),
    "N16 alpha_X top": ("Fig. 13", "alpha_X: highest line", "f1"),
    "N16 alpha_Y top": ("Fig. 13", "alpha_Y: highest line", "f1"),
    "N16 A_Z": ("Fig. 13", "A_Z: combinations of f1 and f2", "among the 13 lines named"),
    "N16 alpha_X": ("Fig. 13", "alpha_X: combinations of f1 and f2", "among the 13 lines named"),
    "N16 alpha_Y": ("Fig. 13", "alpha_Y: multiples and combinations of f1 and f2", "the 13 lines named"),
}
"""The paper's claims by key: figure, claim and the paper's value. A claim with several parts has several keys."""

REPRODUCED, DIFFERS = "reproduced", "differs"


class Answer(NamedTuple):
    """The value found here for a claim."""

    ours: str
    good: bool
    """Whether it agrees with the paper: within one step of the grid for places on an axis, 5 % for forces."""
    why: str = ""
    """Evidence: why it differs, or how it was decided."""


def supported(answers: Mapping[str, Answer], evidence: Mapping[str, str]) -> dict[str, Answer]:
    """The answers with further evidence by claim, which changes no verdict; what no answer is for is left out."""
    joined = lambda key, why: "; ".join(text for text in (why, evidence.get(key, "")) if text)
    return {key: answer._replace(why=joined(key, answer.why)) for key, answer in answers.items()}


def runs(mask: Iterable[bool], values: np.ndarray) -> list[tuple[float, float]]:
    """First and last of the `values` in each unbroken run of True in `mask`."""
    padded = np.concatenate([[False], np.asarray(list(mask), bool), [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return [(float(values[a]), float(values[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def section_points(values: np.ndarray, tolerance: float = 0.01) -> np.ndarray:
    """Number of distinct points of each case on a section, 0 where all its values are NaN.

    Points count as one where no gap between them exceeds `tolerance` of the whole diagram's extent.

    **Arguments:** `values`: (cases, crossings), NaN where a case has fewer crossings.
    """
    ordered = np.sort(values, axis=-1)
    present = values[np.isfinite(values)]
    extent = np.percentile(present, 99) - np.percentile(present, 1) if present.size else 0.0
    return np.sum(np.diff(ordered, axis=-1) > tolerance * extent, axis=-1) + np.isfinite(ordered[..., 0])


def show_ranges(ranges: list[tuple[float, float]]) -> str:
    """Ranges as text."""
    return ", ".join(f"{a:.4g}" + (f"..{b:.4g}" if b > a else "") for a, b in ranges) or "nowhere"


def near(ours: float | None, paper: float, step: float) -> bool:
    """Whether a place on an axis is the paper's within a step of the grid; False for None and NaN."""
    return ours is not None and bool(abs(ours - paper) <= step * 1.001)


def named(kinds: Any, k: int) -> str:
    """Describes the attractor of case number k, from `Attractors`."""
    period = int(kinds.period[k])
    return f"period-{period}" if period else str(kinds.kind[k])


def rows(answers: Mapping[str, Answer]) -> list[dict[str, str]]:
    """The claims that were answered, in the paper's order, as plain dictionaries."""
    return [
        {
            "claim": key,
            "where": where,
            "says": says,
            "paper": paper,
            "ours": answers[key].ours,
            "verdict": REPRODUCED if answers[key].good else DIFFERS,
            "evidence": answers[key].why,
        }
        for key, (where, says, paper) in CLAIMS.items()
        if key in answers
    ]


def write_report(
    out: Path,
    answers: Mapping[str, Answer],
    seconds: Mapping[str, float],
    conventions: list[dict[str, Any]],
    name: str = "claims",
) -> tuple[Path, Path]:
    """Writes `claims.md` and `claims.json` into the folder `out`, or files of another `name`.

    **Arguments:** `seconds`: time of each run; `conventions`: one row per reading of what the paper leaves open.
    """
    table = rows(answers)
    good = sum(row["verdict"] == REPRODUCED for row in table)
    text = [
        "# The paper's claims, answered",
        "",
        "Source: Dang, Liu, Morandini, Ma, Masarati 2024, doi:10.1115/1.4065629.",
        f"{good} of {len(table)} reproduced, {len(table) - good} differ.",
        "",
        *table_lines(table),
    ]
    if conventions:
        heading = "## The same numbers under other readings of what the paper leaves open"
        text += ["", heading, "", *table_lines(conventions)]
    text += ["", "## Time", "", *table_lines([{"run": k, "seconds": f"{v:.1f}"} for k, v in seconds.items()]), ""]
    markdown, data = out / f"{name}.md", out / f"{name}.json"
    content = {"claims": table, "conventions": conventions, "seconds": dict(seconds)}
    as_json = json.dumps(content, indent=1, ensure_ascii=False)
    write_each({markdown: "\n".join(text).encode, data: as_json.encode})
    return markdown, data
