"""Methods of search on orbits, with exact derivatives, and in chaos, with those of ensembles.

pytest -m benchmark -s tests/benchmarks/test_design.py
"""

import warnings

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design import Descent, TrustRegion
from slipperjax.design.optimise import optimise_design

pytestmark = pytest.mark.benchmark
METHODS = {
    "TrustRegion()": TrustRegion(),
    "Descent(steps=15)": Descent(steps=15),
    "Descent(steps=40)": Descent(steps=40),
}


def compare(scene, objective, variables, **options):
    """Prints a row for each method: the objective at the ends of the starts, trials and forcing periods."""
    print(
        "\nmethod               mean and least end, over the mean of the first designs    trials    forcing periods"
    )
    ends = {}
    for name, method in METHODS.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", sj.ImplausibleWarning)  # of tight designs' first transients
            how = dict(method=method, max_trials=40, steps_per_period=50)
            best = optimise_design(scene, objective, variables, **how, **options)
        first = best.history["smooth"].values[: best.starts.sizes["start"]].mean()
        ends[name] = best.starts["smooth"].values / first
        row = (
            f"{ends[name].mean():.5f}  {ends[name].min():.5f}{best.history.sizes['trial']:48d}{best.simulated:19.0f}"
        )
        print(f"{name:20} {row}")
    return ends


@pytest.mark.parametrize("robust", ["worst", "mean"])
def test_on_orbits(robust):
    """The pitch excursion at two speeds, by length and clearance."""
    box, over = {"length": (0.18, 0.5), "clearance": (0.5e-3, 1.5e-3)}, {"speed": [1300.0, 1500.0]}
    print(f"\n\nexcursion_pitch, {robust} of two speeds, three starts")
    compare(sj.paper_scene(), "excursion_pitch", box, over=over, robust=robust, starts=3)


@pytest.mark.parametrize("objective", ["contact_load", "rms_a_z"])
def test_in_chaos(objective):
    """A short slipper by the plays of its five faces, eight starts."""
    plays = {f"section.play.{k}": (0.4e-3, 1.1e-3) for k in range(5)}
    scene = sj.paper_scene(speed=1200.0, length=0.12, clearance=1.5e-3)
    print(f"\n\n{objective} by five plays, eight starts")
    ends = compare(scene, objective, plays, starts=8, transient=100)
    lower = np.sum(ends["Descent(steps=40)"] < ends["TrustRegion()"])
    print(f"Descent(steps=40) ends lower than TrustRegion() from {lower} of 8 starts")
