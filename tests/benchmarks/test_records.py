"""Cost of records in each recorded period, and how much is kept.

pytest -m benchmark -s tests/benchmarks/test_records.py
"""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.numbers import RECORDS
from slipperjax.flow.period_map import advance, initial_states
from slipperjax.flow.record import History, RecordSet
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.solvers.named import resolve_solver
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.records import resolved_record

from .timing import in_turns, show

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")]
CASES, STEPS, PERIODS, ROUNDS = 256, 100, 20, 7

NAMED = ["motion", "peak_force", "slipper_peak", "rms", "extremes", "sections"]
OWN = [RECORDS["drive_force"]]
ASKED = {
    "plain": None,
    "history": History(50),
    "sections": "sections",
    **{f"[{r if isinstance(r, str) else r.name}]": [r] for r in [*NAMED, *OWN]},
    "all of these": [*NAMED, *OWN],
}


def test_costs():
    scene = sj.paper_scene()
    grid = Grid(scene, {"speed": np.linspace(900, 2000, CASES)})
    scenes, starts = grid.sample(sj.table_2_start(), CASES).take(np.arange(CASES))
    states = initial_states(scenes, starts)
    calls, kept = {}, {}
    for name, record in ASKED.items():
        records = RecordSet() if record is None else resolved_record(record)[0]
        kept[name] = 8 * sum(one.values(scene, PERIODS) for one in records.records)
        options = dict(solver=resolve_solver(scene, None), periods=PERIODS, records=records)
        calls[name] = lambda options=options: advance(scenes, states, 0.0, ConstantSteps(STEPS), **options).state
    times = {name: timed.later for name, timed in in_turns(calls, ROUNDS).items()}
    plain = np.median(times["plain"])
    rows = []
    for name, seconds in times.items():
        step = np.median(seconds) / (PERIODS * STEPS * CASES)
        ratio = f"{np.median(seconds) / plain:.2f}"
        spread = f"{np.min(seconds) / plain:.2f} to {np.max(seconds) / plain:.2f}"
        row = {"record": name, "step of a case": f"{1e6 * step:.3f} us", "over a plain one": ratio, "range": spread}
        rows.append(row | {"kept per case": f"{kept[name]} B"})
    print(f"\n{CASES} cases, {STEPS} steps per period, {PERIODS} periods, {ROUNDS} rounds")
    show(rows)
