"""Records of the package's own runs, made by `simulate` with another solver and finer steps than fits use."""

from collections.abc import Sequence

import xarray as xr

import slipperjax as sj
from slipperjax.fitting import synthetic_record

SETTLED = 150
"""Forcing periods before a record."""


def record(
    scene: sj.Scene,
    sensors: Sequence[sj.model.Sensor],
    periods: int,
    *,
    noise: float = 0.0,
    seed: int = 0,
    rate: int = 30,
    steps: int = 160,
    settled: int = SETTLED,
    start: object = None,
) -> xr.Dataset:
    """What sensors read of a motion, `rate` times per forcing period; `noise`: over the signal's deviation."""
    how = dict(steps_per_period=steps, saves_per_period=steps, start=start, loads=False)
    run = sj.simulate(scene, settled + periods, **how)
    per_second = rate / float(scene.period)
    return synthetic_record(run, sensors, rate=per_second, periods=periods, noise=noise, seed=seed)
