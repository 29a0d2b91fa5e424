"""Records of the package's own runs, made by `simulate` with another solver and finer steps than fits use."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

import slipperjax as sj
from slipperjax.model.dynamics import Args
from slipperjax.model.sensors import channels

SETTLED = 150
"""Forcing periods before a record."""


def record(
    scene: sj.Scene,
    sensors: Sequence[sj.Sensor],
    periods: int,
    *,
    noise: float = 0.0,
    seed: int = 0,
    rate: int = 30,
    steps: int = 160,
    settled: int = SETTLED,
    start: object = None,
) -> xr.Dataset:
    """Return what sensors read of a motion, `rate` times per forcing period.

    **Arguments:** `noise`: standard deviation over that of the signal.
    """
    run = sj.simulate(
        scene, settled + periods, steps_per_period=steps, saves_per_period=steps, start=start, loads=False
    )
    count = periods * steps + 1
    states, places = jax.tree.map(lambda a: a[-count:], (run.state, run.period))
    seen = jax.jit(jax.vmap(lambda epoch, state: channels(Args(scene, epoch), 0.0, state)))(places, states)
    time = np.asarray(scene.seconds(places) - scene.seconds(places[0]))
    at = np.arange(periods * rate) * time[-1] / (periods * rate)
    rng = np.random.default_rng(seed)
    data = {}
    for sensor in sensors:
        signal = np.asarray(sensor.read(seen, jnp.asarray(time), jnp.asarray(at), scene.slipper.modes))
        noisy = signal + noise * signal.std() * rng.normal(size=signal.shape)
        data[sensor.name] = ("time", noisy, {"units": sensor.unit})
    return xr.Dataset(data, {"time": ("time", at, {"units": "s"})})
