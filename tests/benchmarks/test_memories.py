"""Both latches: forces on random rails and over a joint, steps, an independent code, and the cost of a step.

pytest -m benchmark -s tests/benchmarks/test_memories.py
"""

import dataclasses
import statistics
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import slipperjax as sj

from ..sweeps import independent_run
from .timing import batch, micros

pytestmark = pytest.mark.benchmark
MEMORIES = {"at touchdown": sj.model.EventLatch(), "fastest": sj.model.PeakRateLatch()}
RAIL = sj.RandomTrack.sled(length=900.0)
SEEDS = np.arange(100.0, 164.0)
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
RESTITUTIONS = (0.9, 0.5, 0.3)


def on_rail(memory, restitution):
    scene = sj.paper_scene(1000.0, restitution=restitution, memory=MEMORIES[memory])
    return dataclasses.replace(scene, track=RAIL)


def swept(scene, **options):
    options = dict(product=False, transient=5, periods=50, progress=False) | options
    return sj.sweep(scene, {"track.seed": SEEDS}, record=["peak_force", "damping_ratio"], **options)


def shown(name, peaks):
    print(
        f"{name:44} " + " ".join(f"{1e-3 * x:6.2f}" for x in np.quantile(peaks, [0.5, 0.95, 1.0])) + " kN", flush=True
    )


def test_forces_on_sled_rails():
    """Highest force of 64 rails, 400 m each, at 1000 m/s: 50, 95, 100 %."""
    print()
    medians = {}
    for restitution in RESTITUTIONS:
        for memory in MEMORIES:
            scene = on_rail(memory, restitution)
            for times in (1, 4):
                steps = times * sj.model.default_steps_per_period(scene)
                ds = swept(scene, steps_per_period=steps)
                peaks = ds["peak_force"].max(("end", "point")).values
                ratio = float(ds["damping_ratio"].max())
                shown(f"{restitution}, {memory}, {steps} steps, ratio {ratio:.1f}", peaks)
                medians[restitution, memory, times] = np.median(peaks)
            assert np.isclose(medians[restitution, memory, 1], medians[restitution, memory, 4], rtol=0.1)
    # less restitution does not raise forces with the fastest rate; it does with that at touchdown
    assert medians[0.5, "fastest", 4] < medians[0.9, "fastest", 4]
    assert medians[0.3, "at touchdown", 4] > medians[0.9, "at touchdown", 4]


JOINT = 0.030 * 0.0254  # [m]


@pytest.mark.filterwarnings("ignore:File:slipperjax.ImplausibleWarning")  # a column of remarks
@pytest.mark.parametrize("example", ["one_slipper", "four_slippers"])
def test_a_joint(example):
    """Loads where a slipper of 9 kg, or a sled of 400 kg, at rest on surveyed rails meets a joint of 0.030 in."""
    scene = sj.load(EXAMPLES / f"{example}.toml").scene
    scene = dataclasses.replace(scene.replace(restitution=0.5), speed=300.0)
    joint = sj.model.LocalTrack([10.0], [-JOINT], 0.6, shape="joint")
    track = sj.model.SumTrack(scene.track, joint)
    print()
    ratios = {}
    for memory in MEMORIES:
        own = dataclasses.replace(scene, track=track, memory=MEMORIES[memory])
        for times in (1, 4):
            steps = times * sj.model.default_steps_per_period(own)
            records = ["peak_force", "slipper_peak", "damping_ratio"]
            ds = sj.run(own, length=14.0, record=records, steps_per_period=steps, progress=False)
            after = ds.sel(distance=slice(8.0, 14.0))
            ratio = ratios[memory, times] = float(after["damping_ratio"].max())
            status = sj.Status(int(ds["status"])).name
            net, point = (1e-3 * float(abs(after[name]).max()) for name in ("peak_slipper_force", "peak_force"))
            loads = f"net {net:.2f} kN, point {point:.2f} kN, damping ratio {ratio:.1f}, {status}"
            print(f"{example}, {memory}, {steps} steps: {loads}", flush=True)
    assert ratios["fastest", 4] <= 1.001 * float(scene.contact.factor)


@dataclasses.dataclass
class OnRail(independent_run.Case):
    """A slipper on one of the random rails, whose displacements are looked up."""

    spline: object = None

    def rail(self, distance):
        here, slope = self.spline(distance)
        return (*here, 0.0, *slope, 0.0)


def test_rails_by_an_independent_code():
    """The same highest forces over 24 m, before chaos tells the motions apart."""
    windows = 24
    places = np.arange(-4.0, windows + 4.0, 0.01)
    start = [0.0] * 5 + [0.5, 0.5, 0.2, 0.3, 0.4]
    print()
    for restitution in (0.5, 0.3):
        for seed in SEEDS[:3]:
            scene = on_rail("fastest", restitution).replace(**{"track.seed": seed})
            motion = jax.vmap(scene.track.prepared().irregularity)(jnp.asarray(places))
            rail = make_interp_spline(places, np.stack([motion.lateral, motion.vertical], 1), 5)
            slope = rail.derivative()
            programme = independent_run.Programme([0.0, windows], [1000.0, 1000.0])
            case = OnRail(
                programme, restitution=restitution, fastest=True, spline=lambda x, r=rail, s=slope: (r(x), s(x))
            )
            # steps shorter than a short passing of the fastest rate, whose both ends one step may hold
            want = independent_run.run(case, start, windows, tolerance=1e-7, longest=2e-5).peaks.max(axis=1)
            found = []
            for times in (1, 4):
                options = dict(length=windows, window=1.0, record="peak_force", progress=False)
                options["steps_per_period"] = times * sj.model.default_steps_per_period(scene)
                ds = sj.run(scene, start=sj.table_2_start(), begin=0.0, **options)
                found.append(ds["peak_force"].max(("end", "point")).values.ravel())
            far = [np.max(np.abs(one / want.max() - want / want.max())) for one in found]
            print(f"{restitution}, rail {seed:g}: {1e-3 * want.max():.3f} kN; apart in any metre {far}", flush=True)
            assert far[1] < 0.0025  # measured 8.5e-4


def test_cost_of_a_step():
    """Of a step and case in a batch, of alternating runs, relative to `EventLatch`."""
    of = lambda memory: batch(sj.solvers.ImpulseRK4(), restitution=0.7, memory=memory)
    programs = {name: of(memory) for name, memory in MEMORIES.items()}
    taken = {name: [] for name in MEMORIES}
    for _ in range(60):
        for name, run in programs.items():
            # of the processor, which other work on the machine disturbs less
            begin = time.process_time()
            jax.block_until_ready(run())
            taken[name].append(time.process_time() - begin)
    # without the first calls, which compile
    first, second = (of[1:] for of in taken.values())
    ratio = statistics.median(b / a for a, b in zip(first, second, strict=True))
    own = micros(statistics.median(first))
    print(f"\n{own:.3f} us of processor time per step and case; with the fastest rate {ratio:.3f} of it")
    assert ratio < 1.1  # measured 1.02 to 1.04 on a busy machine
