"""Chaos that ends late: of 40 speeds none is `resolved` by a record in which it has not ended yet.

pytest -m benchmark -s tests/benchmarks/test_transient_chaos.py
"""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.sweeps.attractors import attractors

pytestmark = pytest.mark.benchmark
STEPS = 50
"""Steps per forcing period: few, so that long transients are cheap."""
RECORD = dict(transient=200, periods=500, steps_per_period=STEPS)
SPEEDS = np.concatenate([np.linspace(534, 544, 40), np.linspace(610, 629, 60), np.linspace(2386, 2402, 60)])
"""Ends of chaotic windows, beside periodic motions [m/s]."""
LATER = 3000
"""Forcing periods after which the chaos of some speeds has ended."""
COUNT = 40
POSITIVE = 0.02
"""Exponent from which a record is called chaotic [1/period]."""


def late():
    """Speeds at which a record is chaotic, and a periodic motion attracts later, with the record's spectra."""
    found = sj.jit(jax.vmap(lambda speed: sj.lyapunov_spectrum(sj.paper_scene(speed), **RECORD)))(SPEEDS)
    exponent = np.asarray(found.per_period)[:, 0]
    # not by `is_chaotic`, of which `resolved` is made
    chaotic = (exponent > POSITIVE) & (np.asarray(found.status) == 0)
    how = dict(transient=LATER, periods=200, steps_per_period=STEPS, record=["strobe"], progress=False)
    ends = np.zeros(len(SPEEDS), bool)
    ends[chaotic] = attractors(sj.sweep(sj.paper_scene(), {"speed": SPEEDS[chaotic]}, **how)).kind == "period"
    return found, chaotic, np.flatnonzero(ends)


def test_chaos_of_one_motion_that_ends_late_is_never_resolved():
    found, chaotic, ends = late()
    exponent, stderr = np.asarray(found.per_period)[:, 0], found.stderr[:, 0]
    print(f"\nof {len(SPEEDS)} speeds {chaotic.sum()} have a chaotic record, of which {len(ends)} are periodic later")
    assert len(ends) >= COUNT
    chosen = ends[np.linspace(0, len(ends) - 1, COUNT).astype(int)]
    print("speed [m/s]   exponent [1/period]   resolved")
    for k in chosen:
        print(f"{SPEEDS[k]:11.3f}   {exponent[k]:8.4f} +- {stderr[k]:.4f}   {bool(found.resolved[k])}")
    print(f"resolved: {int(found.resolved[chosen].sum())} of {COUNT}")
    assert not found.resolved[chosen].any()
    assert not found.resolved[chaotic].any()
