"""Both latches: forces on random rails and over a joint, steps, an independent code, and the cost of a step.

    pytest -m benchmark -s tests/benchmarks/test_memories.py
"""

import dataclasses
import statistics

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.tools.compile import jit

from ..sweeps import independent_run
from .timing import in_turns

pytestmark = pytest.mark.benchmark
MEMORIES = {"at touchdown": sj.EventLatch(), "fastest": sj.PeakRateLatch()}
RAIL = sj.RandomTrack.sled(length=900.0)
SEEDS = np.arange(100.0, 164.0)
RESTITUTIONS = (0.9, 0.5, 0.3)


def on_rail(memory, restitution):
    scene = sj.paper_scene(1000.0, restitution=restitution, memory=MEMORIES[memory])
    return dataclasses.replace(scene, track=RAIL)


def swept(scene, **options):
    options = dict(product=False, transient=5, periods=50, progress=False) | options
    return sj.sweep(scene, {"track.seed": SEEDS}, record=["peak_force", "damping_ratio"], **options)


def shown(name, peaks):
    print(f"{name:44} " + " ".join(f"{1e-3 * x:6.2f}" for x in np.quantile(peaks, [0.5, 0.95, 1.0])) + " kN", flush=True)


def test_forces_on_sled_rails():
    """Highest force of 64 rails, 400 m each, at 1000 m/s: 50, 95, 100 %."""
    print()
    medians = {}
    for restitution in RESTITUTIONS:
        for memory in MEMORIES:
            scene = on_rail(memory, restitution)
            for times in (1, 4):
                steps = times * sj.default_steps_per_period(scene)
                ds = swept(scene, steps_per_period=steps)
                peaks = ds["peak_force"].max(("end", "point")).values
                ratio = float(ds["damping_ratio"].max())
                shown(f"{restitution}, {memory}, {steps} steps, ratio {ratio:.1f}", peaks)
                medians[restitution, memory, times] = np.median(peaks)
            assert np.isclose(medians[restitution, memory, 1], medians[restitution, memory, 4], rtol=0.1)
    # less restitution does not raise forces with the fastest rate; it does with that at touchdown
    assert medians[0.5, "fastest", 4] < medians[0.9, "fastest", 4]
    assert medians[0.3, "at touchdown", 4] > medians[0.9, "at touchdown", 4]


@dataclasses.dataclass
class OnRail(independent_run.Case):
    """A slipper on one of the random rails, whose displacements are looked up."""

    spline: object = None

    def rail(self, distance):
        here, slope = self.spline(distance)
        return (*here, 0.0, *slope, 0.0)


def test_cost_of_a_step():
    """Of a step and case in a batch, of alternating runs, relative to `EventLatch`."""
    lanes, steps, periods = 64, 50, 20
    speeds = jnp.linspace(1000.0, 2500.0, lanes)

    def program(memory):
        def motion(speed):
            scene = sj.paper_scene(restitution=0.7, memory=memory).replace(speed=speed)
            run = PeriodMap(scene, steps, sj.ImpulseRK4(), periods)
            return run(sj.initial_state(scene, sj.table_2_start())).motion

        return jit(jax.vmap(motion))

    timed = in_turns({name: lambda run=program(memory): run(speeds) for name, memory in MEMORIES.items()}, 40)
    first, second = (of.later for of in timed.values())
    micro = 1e6 * statistics.median(first) / (lanes * steps * periods)
    ratio = statistics.median(b / a for a, b in zip(first, second, strict=True))
    best = min(second) / min(first)
    print(f"\n{micro:.3f} us per step and case; fastest rate: {ratio:.3f} of it (median), {best:.3f} (of the best)")
    assert ratio < 1.1
