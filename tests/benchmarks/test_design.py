"""Methods of search on orbits, with exact derivatives, and in chaos, with those of ensembles.

pytest -m benchmark -s tests/benchmarks/test_design.py
"""

import dataclasses
import warnings

import numpy as np
import pytest
import scipy.stats.qmc

import slipperjax as sj
from slipperjax.design import Descent, RailEnsemble, TrustRegion, sensitivities
from slipperjax.design.optimise import optimise_design

pytestmark = pytest.mark.benchmark


def spread(scene, variables, count):
    """The scene's own design, and others of a Latin hypercube: the same for all methods."""
    low, high = np.array(list(variables.values())).T
    designs = low + scipy.stats.qmc.LatinHypercube(len(low), rng=0).random(count) * (high - low)
    designs[0] = [float(scene.value(name)) for name in variables]
    return [dict(zip(variables, map(float, design), strict=True)) for design in designs]


def ends_of(scene, objective, variables, method, starts, **options):
    """Prints a row for a method, and returns the objective at the ends of the starts [SI unit]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.ImplausibleWarning)  # of tight designs' first transients
        call = dict(method=method, starts=spread(scene, variables, starts), max_trials=40, steps_per_period=50)
        best = optimise_design(scene, objective, variables, **call, **options)
    ends, first = best.starts["smooth"].values, best.history["smooth"].values[:starts].mean()
    name = f"Descent(steps={method.steps})" if isinstance(method, Descent) else "TrustRegion()"
    work = f"{best.history.sizes['trial']:9d}{best.simulated:18.0f}"
    print(f"{name:18}{starts:7d}{ends.mean() / first:11.5f}{ends.min():14.6g}{work}")
    return ends


HEAD = "method             starts   mean end     least end   trials   forcing periods"
"""Mean ends are over the mean of the first designs."""


@pytest.mark.parametrize("robust", ["worst", "mean"])
def test_on_orbits(robust):
    """The pitch excursion at two speeds, by length and clearance."""
    box, over = {"length": (0.18, 0.5), "clearance": (0.5e-3, 1.5e-3)}, {"speed": [1300.0, 1500.0]}
    print(f"\n\nexcursion_pitch [rad], {robust} of two speeds\n\n{HEAD}")
    for method in (TrustRegion(), Descent(steps=15), Descent(steps=40)):
        ends_of(sj.paper_scene(), "excursion_pitch", box, method, 3, over=over, robust=robust)


@pytest.mark.parametrize("objective", ["contact_load", "rms_a_z"])
def test_in_chaos(objective):
    """A short slipper by the plays of its five faces."""
    plays = {f"section.play.{k}": (0.4e-3, 1.1e-3) for k in range(5)}
    scene = sj.paper_scene(speed=1200.0, length=0.12, clearance=1.5e-3)
    print(f"\n\n{objective} [SI unit] by five plays\n\n{HEAD}")
    search = lambda method, starts: ends_of(scene, objective, plays, method, starts, transient=100)
    region, _, descent = search(TrustRegion(), 8), search(Descent(steps=15), 8), search(Descent(steps=40), 8)
    print(f"Descent(steps=40) ends lower than TrustRegion() from {np.sum(descent < region)} of 8 starts")
    search(TrustRegion(), 21)  # about the forcing periods of Descent(steps=40)


def test_over_random_rails():
    """The 90th percentile of the peak force over sled rails, by clearance and length."""
    scene = dataclasses.replace(sj.paper_scene(1000.0), track=sj.RandomTrack.sled(length=600.0))
    box, ensemble = {"clearance": (0.3e-3, 3e-3), "length": (0.12, 0.5)}, RailEnsemble(periods=60, quantile=0.9)
    options = dict(steps_per_period=80, ensemble=ensemble)
    print("\n\nmethod                      clearance [mm]  length [mm]  on 1600 other rails [kN]  trials  periods")
    for method in (TrustRegion(), Descent(steps=20)):
        best = optimise_design(scene, "peak_force", box, method=method, starts=1, max_trials=20, **options)
        large = dataclasses.replace(ensemble, rails=800, seed=1000)
        judged = sensitivities(best.scene, "peak_force", ["speed"], ensemble=large, steps_per_period=80)
        value, error = (float(judged[name][0]) / 1e3 for name in ("value", "stderr"))
        name = "TrustRegion()" if isinstance(method, TrustRegion) else "Descent(steps=20)"
        sizes = "".join(f"{1e3 * v:14.3f}" for v in best.design.values())
        print(f"{name:28}{sizes}{value:18.3f} +- {error:.3f}{best.history.sizes['trial']:10d}{best.simulated:15.0f}")
