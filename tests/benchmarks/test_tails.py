"""The highest forces on rails that do not recur, against the number of steps, and touchdowns at the least rate.

    pytest -m benchmark -s tests/benchmarks/test_tails.py

A row is an ensemble of rails of one spectrum, one for each seed: quantiles over rails of the highest contact force
over 400 m after 40 m [kN], with standard errors by the bootstrap, at some steps per 8 m. Runs are chaotic, so that
those of other steps are other runs: distributions are compared. BY_EVENTS are the same quantiles from an independent
code with adaptive steps that end at every zero of a gap.
"""

import dataclasses

import numpy as np
import pytest
import scipy.stats

import slipperjax as sj
from slipperjax.flow import Record
from slipperjax.model.quantities import Quantity
from slipperjax.model.step_size import rounded_steps

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")]
SHARES = 0.5, 0.95, 0.99
PERIODS = 50
"""Forcing periods of 8 m."""
BY_EVENTS = {
    ("sled", 1000.0, 0.9): ("4.71 +- .05", "6.62 +- .16", "7.38 +- .33"),
    ("sled", 2000.0, 0.9): ("7.78", "11.2 +- .35", "12.2 +- 1.0"),
    ("sled", 1000.0, 0.7): ("4.32", "7.02 +- .29", "8.06 +- .80"),
    ("sled", 1000.0, 0.5): ("5.82", "9.92 +- .58", "12.9 +- 1.2"),
    ("german", 1000.0, 0.9): ("34.4", "47.0", "52.1"),
}
RAILS = {
    "sled": sj.RandomTrack.sled(length=900.0),
    "german": sj.RandomTrack.german("low", length=900.0),
}


def _begun(course):
    """The memory after the steps in which a contact began, elsewhere 0."""
    memory = course.states.memory
    begins = (memory[:-1] == 0) & (memory[1:] < 0) & course.used[:, None]
    return np.where(False, 0.0, 1.0) * begins * memory[1:]


def touchdowns(course):
    return (_begun(course) < 0).sum()


def at_floor(course):
    """Those at the least rate, `EventLatch.slowest`."""
    return (_begun(course) <= -0.999999 / course.scene.memory.slowest).sum()


COUNTS = [
    Record(Quantity("touchdowns", "1", "touchdowns"), touchdowns, "sum"),
    Record(Quantity("at_floor", "1", "touchdowns at the least rate"), at_floor, "sum"),
]


def scene_of(rail, speed, restitution):
    return dataclasses.replace(sj.paper_scene(speed, restitution=restitution), track=RAILS[rail])


def ensemble(rail, speed, restitution, steps, seeds):
    """The highest force of each rail [kN], and how many touchdowns there were, and at the least rate."""
    scene = scene_of(rail, speed, restitution)
    options = dict(transient=5, periods=PERIODS, steps_per_period=steps, record=["peak_force", *COUNTS])
    ds = sj.sweep(scene, {"track.seed": np.arange(float(seeds))}, **options)
    force = ds["peak_force"].max(("end", "point")).values / 1e3
    lost = ds["status"].isin([1, 2]).values
    return np.where(lost, np.inf, force), int(ds["touchdowns"].sum()), int(ds["at_floor"].sum())


def quantiles(values, seed=0):
    """Quantiles and their standard errors by the bootstrap."""
    drawn = np.random.default_rng(seed).choice(values, (1000, len(values)))
    return np.quantile(values, SHARES), np.quantile(drawn, SHARES, axis=1).std(axis=1)


def row(rail, speed, restitution, steps, seeds):
    values, touched, floor = ensemble(rail, speed, restitution, steps, seeds)
    shown = ", ".join(f"{q:.2f} +- {e:.2f}" for q, e in zip(*quantiles(values), strict=True))
    print(f"  {steps:5d} steps: {shown}; highest {values.max():.1f}; {floor} of {touched} at the floor", flush=True)
    return values
