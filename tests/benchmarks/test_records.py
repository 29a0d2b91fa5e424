"""Cost of records in each recorded period, and how much is kept.

pytest -m benchmark -s tests/benchmarks/test_records.py
"""

import time

import numpy as np
import pytest
from slipperjax.flow.percentiles import ForcePercentile
from slipperjax.flow.reducers import Reduced
from slipperjax.flow.spectra import SpectrumLines
from slipperjax.sweeps.reducers import resolved_record

import slipperjax as sj
from slipperjax.flow.period_map import advance, initial_states
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.sweeps.executors import _of_no_period
from slipperjax.sweeps.grid import Cases
from slipperjax.sweeps.plan import make_plan
from slipperjax.tools.files import table_lines

pytestmark = pytest.mark.benchmark
CASES, STEPS, PERIODS, ROUNDS = 256, 100, 20, 7
NAMED = ["motion", "peak_force", "rms", "extremes", "sections"]
OWN = [
    ForcePercentile((50, 99)),
    SpectrumLines("v_z", (0.5, 1, 2)),
    Reduced(lambda t, state, args: sj.reactions(t, state, args).drive_force, name="drive", units="N", over="mean"),
]
RECORDS = {
    "plain": None,
    "history": "history",
    "sections": "sections",
    **{f"[{r if isinstance(r, str) else r.name}]": [r] for r in [*NAMED, *OWN]},
    "all of these": [*NAMED, *OWN],
}


def test_costs():
    scene = sj.paper_scene()
    cases = Cases(scene, {"speed": np.linspace(900, 2000, CASES)}, sj.table_2_start())
    scenes, starts = cases.take(np.arange(CASES))
    states = initial_states(scenes, starts)
    calls, kept = {}, {}
    for name, record in RECORDS.items():
        recorder = earlier = None
        if record is not None:
            recorder = resolved_record(record)
            plan = make_plan(scene, cases, record=recorder, transient=0, periods=PERIODS, steps_per_period=STEPS)
            recorder, kept[name] = plan.recorder, 8 * plan.values
            earlier = _of_no_period(recorder, scenes, states)
        options = dict(solver=sj.RK4(), periods=PERIODS, recorder=recorder, earlier=earlier)
        calls[name] = lambda options=options: advance(scenes, states, 0.0, ConstantSteps(STEPS), **options)
    times = {name: [] for name in calls}
    for call in calls.values():
        call().state.motion.y.block_until_ready()
    for _ in range(ROUNDS):
        for name, call in calls.items():
            begin = time.perf_counter()
            call().state.motion.y.block_until_ready()
            times[name].append(time.perf_counter() - begin)
    plain = np.median(times["plain"])
    rows = []
    for name, seconds in times.items():
        step = np.median(seconds) / (PERIODS * STEPS * CASES)
        ratio = f"{np.median(seconds) / plain:.2f}"
        spread = f"{np.min(seconds) / plain:.2f} to {np.max(seconds) / plain:.2f}"
        row = {"record": name, "step of a case": f"{1e6 * step:.3f} us", "over a plain one": ratio, "range": spread}
        rows.append(row | {"kept per case": f"{kept.get(name, 0)} B"})
    print(f"\n{CASES} cases, {STEPS} steps per period, {PERIODS} periods, {ROUNDS} rounds")
    print("\n".join(table_lines(rows)))
