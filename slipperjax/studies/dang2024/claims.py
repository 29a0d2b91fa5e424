"""The claims of Dang et al. 2024 as data, and a report that compares them with the answers found here."""

import json
from collections.abc import Callable, Mapping
from functools import partial
from math import inf
from pathlib import Path
from typing import NamedTuple

from ...flow.status import Status
from ...tools.files import table_lines, write_each
from .verdicts import (
    Answer,
    Diagram,
    Singles,
    constant,
    drop,
    growth,
    highest_line,
    larger,
    motion,
    peak_force,
    ranges,
    roll_points,
    share,
    softer,
    spectral_lines,
)

DUAL_LINES = {
    "f1": 150.0,
    "f2": 125.0,
    "2f1": 300.0,
    "3f2": 375.0,
    "4f2": 500.0,
    "2f2-f1": 100.0,
    "2f1-f2": 175.0,
    "f1+f2": 275.0,
    "3f1-f2": 325.0,
    "4f2-f1": 350.0,
    "f1+2f2": 400.0,
    "2f1+f2": 425.0,
    "4f1-f2": 475.0,
}
"""Lines that the paper names in its Fig. 13 [Hz]."""


class Claim(NamedTuple):
    """A claim of the paper, and how it is measured here."""

    figure: str
    says: str
    paper: str
    """Value in the paper."""
    run: str
    """Name of the dataset that answers the claim."""
    measure: Callable[..., Answer]
    """Function of the run; for a claim about single cases, also of their numbers."""
    cases: tuple[int, ...] = ()
    """Numbers of the single cases; empty for a claim about a whole diagram."""

    def answer(self, run: Diagram | Singles) -> Answer:
        """Return the answer, with the number of flagged cases; a claim about flagged single cases has none."""
        # the slice means all cases of a diagram
        cases = list(self.cases) or slice(None)
        status = run.status[cases]
        good = run.good[cases]
        flagged = f"{(~good).sum()} of {good.size} cases flagged"
        if self.cases and not good.all():
            return Answer(flagged, False, Status(int(status[~good][0])).meaning)
        found = self.measure(run, *self.cases)
        ours = found.ours if good.all() else f"{found.ours}; {flagged}"
        return Answer(ours, found.good, found.why or run.evidence)


# conditions of several claims
_positive = lambda of: of.positive
_not_periodic = lambda of: of.kinds.kind != "period"
_two_points_in_pitch = lambda of: of.has_points("w_y", 2)

CLAIMS: dict[str, Claim] = {
    # single cases: their motion, the lines in their spectrum and their section
    "N1 motion": Claim(
        "Fig. 4a",
        "900 m/s: roll acceleration repeats every 3/f",
        "period-3",
        "histories",
        partial(motion, wanted="period-3"),
        (0,),
    ),
    "N1 lines": Claim(
        "Fig. 4a",
        "900 m/s: energy at f and 2f/3",
        "lines at f and 2f/3",
        "histories",
        partial(spectral_lines, name="alpha_x", lines={"f": 112.5, "2f/3": 75.0}),
        (0,),
    ),
    "N1 section": Claim(
        "Fig. 4a",
        "900 m/s: roll section",
        "2 points",
        "histories",
        partial(roll_points, count=2),
        (0,),
    ),
    "N2 motion": Claim(
        "Fig. 4b",
        "1500 m/s: period-1 with super-harmonics",
        "period-1, lines at 2f and 3f",
        "histories",
        partial(motion, wanted="period-1", lines={"2f": 375.0, "3f": 562.5}),
        (1,),
    ),
    "N2 section": Claim(
        "Fig. 4b",
        "1500 m/s: roll section",
        "1 point",
        "histories",
        partial(roll_points, count=1),
        (1,),
    ),
    "N3 motion": Claim(
        "Fig. 4c",
        "2300 m/s: chaotic",
        "chaotic",
        "histories",
        partial(motion, wanted="chaotic"),
        (2,),
    ),
    "N3 line": Claim(
        "Fig. 4c",
        "2300 m/s: strongest line",
        "0.4 f",
        "histories",
        partial(highest_line, name="alpha_x", at=0.4, tolerance=0.05),
        (2,),
    ),
    # the diagram over speed
    "N4 period-3": Claim(
        "Fig. 5",
        "V_Y from chaotic to period-3",
        "820 m/s",
        "speed",
        partial(ranges, where=lambda of: of.has_points("v_y", 3) & ~of.is_chaotic(), begins=820),
    ),
    "N4 period-1": Claim(
        "Fig. 5",
        "V_Y to period-1",
        "980 m/s",
        "speed",
        partial(
            ranges,
            where=lambda of: of.has_points("v_y", 1) & ~of.is_chaotic(),
            begins=980,
            within=(0, 1850),
        ),
    ),
    "N4 jump": Claim(
        "Fig. 5",
        "V_Y drops sharply",
        "1810 m/s",
        "speed",
        partial(drop, section="v_y", at=1810, within=(1500, 2200)),
    ),
    "N5": Claim(
        "Fig. 5",
        "V_Z is period-2 between",
        "820..980 m/s",
        "speed",
        partial(
            ranges,
            where=lambda of: of.has_points("v_z", 2) & ~of.is_chaotic(),
            begins=820,
            ends=980,
            within=(700, 1100),
        ),
    ),
    "N6": Claim(
        "Fig. 5",
        "the roll section is never crossed",
        "1660..1810 m/s",
        "speed",
        partial(ranges, where=lambda of: of.has_points("w_x", 0), begins=1660, ends=1810, within=(1500, 2500)),
    ),
    "N7": Claim(
        "Fig. 5",
        "pitch and yaw rates very large above 1810 m/s",
        "very large",
        "speed",
        partial(larger, sections=("w_y", "w_z"), within=(1950, inf), than=(1000, 1800)),
    ),
    # exponents over speed
    "N8 window": Claim(
        "Fig. 6",
        "below 850 m/s chaotic (LLE > 0) except a periodic window",
        "480..490 m/s",
        "speed_exponents",
        partial(ranges, where=lambda of: ~of.positive, begins=480, ends=490, within=(0, 850)),
    ),
    "N8 low": Claim(
        "Fig. 6",
        "LLE > 0 below 850 m/s",
        "all but the window",
        "speed_exponents",
        partial(share, where=_positive, within=(0, 850)),
    ),
    "N8 high": Claim(
        "Fig. 6",
        "LLE > 0 above 1810 m/s",
        "all",
        "speed_exponents",
        partial(share, where=_positive, within=(1810, inf)),
    ),
    # two single cases of different play
    "N9 narrow": Claim(
        "Fig. 7",
        "C = 1 mm: closed orbits, isolated section points",
        "period-1",
        "histories",
        partial(motion, wanted="period-1"),
        (3,),
    ),
    "N9 wide": Claim(
        "Fig. 7",
        "C = 4 mm: orbits of finite width",
        "not periodic",
        "histories",
        partial(motion, wanted="not periodic"),
        (4,),
    ),
    # the diagram over clearance
    "N10 growth": Claim(
        "Fig. 8",
        "below 2.575 mm all rates grow with C",
        "all grow",
        "clearance",
        partial(growth, within=(0, 2.575)),
    ),
    "N10 period-1": Claim(
        "Fig. 8",
        "below 2.575 mm mostly period-1",
        "mostly",
        "clearance",
        partial(share, where=lambda of: of.kinds.period == 1, within=(0, 2.575), least=0.5),
    ),
    "N10 brief": Claim(
        "Fig. 8",
        "brief bifurcation",
        "1.675 mm",
        "clearance",
        partial(ranges, where=lambda of: of.kinds.period != 1, covers=1.675, within=(1.4, 2.0)),
    ),
    "N10 pitch": Claim(
        "Fig. 8",
        "pitch has two section points from",
        "0.6 mm",
        "clearance",
        partial(ranges, where=_two_points_in_pitch, begins=0.6),
    ),
    "N11": Claim(
        "Figs. 8, 9",
        "bifurcation to chaos",
        "2.575 mm",
        "clearance",
        partial(ranges, where=_not_periodic, begins=2.575),
    ),
    # exponents over clearance
    "N11 LLE brief": Claim(
        "Fig. 9",
        "LLE briefly above 0",
        "1.675 mm",
        "clearance_exponents",
        partial(ranges, where=_positive, covers=1.675, within=(1.4, 2.0)),
    ),
    "N11 LLE": Claim(
        "Fig. 9",
        "LLE above 0 from",
        "2.575 mm",
        "clearance_exponents",
        partial(ranges, where=_positive, begins=2.575, within=(2, 5)),
    ),
    # exponents over length; places may differ from the paper's places by two steps of its grid
    "N12 LLE": Claim(
        "Fig. 11",
        "LLE above 0 below",
        "0.15 m",
        "length_exponents",
        partial(ranges, where=_positive, ends=0.15, within=(0, 0.2), steps=2),
    ),
    # the diagram over length
    "N12 chaos": Claim(
        "Fig. 10",
        "chaotic below, periodic above",
        "0.15 m",
        "length",
        partial(ranges, where=_not_periodic, ends=0.15, within=(0, 0.2), steps=2),
    ),
    "N12 constant": Claim(
        "Fig. 10",
        "V_Y and V_Z do not vary with L above 0.15 m",
        "constant",
        "length",
        partial(constant, sections=("v_y", "v_z"), within=(0.16, inf)),
    ),
    "N13": Claim(
        "Fig. 10",
        "pitch has two section points",
        "0.1975..0.2275 m",
        "length",
        partial(ranges, where=_two_points_in_pitch, begins=0.1975, ends=0.2275, within=(0.18, 0.25)),
    ),
}
"""Claims of the paper by key; a claim of several parts has several keys."""

# peak forces [N] of both lengths at three points of the rear end
for _case, _length, _forces in ((5, 0.1, (1977, 8807, 5447)), (6, 0.4, (4256, 12824, 20365))):
    for _point, _force in zip("ACJ", _forces, strict=True):
        CLAIMS[f"N14 {_point}2 {_length}"] = Claim(
            "Fig. 12",
            f"L = {_length} m: peak force at {_point}2",
            f"{_force} N",
            "histories",
            partial(peak_force, point=_point, newtons=_force),
            (_case,),
        )
CLAIMS["N15"] = Claim(
    "Fig. 12",
    "the chaotic slipper (0.1 m) is hit more softly than the periodic one (0.4 m)",
    "every peak",
    "histories",
    softer,
    (5, 6),
)
# under two wavelengths the highest line is f1; sums and differences of both frequencies also have lines
for _name, _label in (("a_z", "A_Z"), ("alpha_x", "alpha_X"), ("alpha_y", "alpha_Y")):
    CLAIMS[f"N16 {_label} top"] = Claim(
        "Fig. 13",
        f"{_label}: highest line",
        "f1",
        "dual",
        partial(highest_line, name=_name, at=1.0, tolerance=1 / 150),
        (0,),
    )
    CLAIMS[f"N16 {_label}"] = Claim(
        "Fig. 13",
        f"{_label}: multiples and combinations of f1 and f2",
        "the 13 lines named",
        "dual",
        partial(spectral_lines, name=_name, lines=DUAL_LINES),
        (0,),
    )


def answers(name: str, run: Diagram | Singles) -> dict[str, Answer]:
    """Return the answers to all claims on a run."""
    return {key: claim.answer(run) for key, claim in CLAIMS.items() if claim.run == name}


def rows(found: Mapping[str, Answer]) -> list[dict[str, str]]:
    """Return the answered claims as rows of a table, in the paper's order."""
    table = []
    for key, claim in CLAIMS.items():
        if key in found:
            ours, good, why = found[key]
            row = {"claim": key, "where": claim.figure, "says": claim.says, "paper": claim.paper}
            table.append(row | {"ours": ours, "verdict": "reproduced" if good else "differs", "evidence": why})
    return table


def write_report(
    out: Path,
    answers: Mapping[str, Answer],
    seconds: Mapping[str, float],
    conventions: list[dict[str, str]],
    name: str = "claims",
) -> tuple[Path, Path]:
    """Write `claims.md` and `claims.json` into the folder `out`, or files of another `name`; return their paths.

    **Arguments:** `seconds`: time of each run; `conventions`: one row for each reading of what the paper leaves open.
    """
    table = rows(answers)
    good = sum(answer.good for answer in answers.values())
    text = [
        "# The paper's claims, answered",
        "",
        "Source: Dang, Liu, Morandini, Ma, Masarati 2024, doi:10.1115/1.4065629.",
        f"{good} of {len(table)} reproduced, {len(table) - good} differ.",
        "Motions are named by recurrence, its decay and the 0-1 test: a slow transient is not called chaos.",
        "",
        *table_lines(table),
    ]
    # a quick study, or a study of some figures only, has no readings
    if conventions:
        heading = "## The same numbers under other readings of what the paper leaves open"
        text += ["", heading, "", *table_lines(conventions)]
    text += ["", "## Time", "", *table_lines([{"run": k, "seconds": f"{v:.1f}"} for k, v in seconds.items()]), ""]
    content = {"claims": table, "conventions": conventions, "seconds": dict(seconds)}
    as_json = json.dumps(content, indent=1, ensure_ascii=False)
    markdown = out / f"{name}.md"
    data = out / f"{name}.json"
    write_each({markdown: "\n".join(text).encode, data: as_json.encode})
    return markdown, data
