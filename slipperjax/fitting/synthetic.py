"""Records of the model's own runs: what sensors would measure, to plan tests and to check fits."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..model.dynamics import Args, State
from ..model.scene import Scene
from ..model.sensors import Channels, Rig, Sensor, channels
from ..orbits.simulate import Trajectory
from ..tools.checks import instance, not_negative, number, positive, require, whole
from ..tools.columns import column
from ..tools.compile import jit


def synthetic_record(
    run: Trajectory,
    sensors: Sequence[Sensor],
    *,
    rate: float,
    periods: int | None = None,
    noise: float = 0.0,
    seed: int = 0,
) -> xr.Dataset:
    """Return what sensors would measure in a run, in the form that `slipperjax.fit` takes.

    ```python
    run = sj.simulate(scene, 220, steps_per_period=160, saves_per_period=160)
    measured = synthetic_record(run, sensors, rate=10e3, periods=20, noise=0.05)
    ```

    **Arguments:** `run`: with as many saves as steps, or as many as a contact needs; `rate`: of samples [Hz];
    `periods`: number of last forcing periods, by default all; `noise`: standard deviation of white noise over that of
    each signal [1], for sensors that have no `noise` of their own; `seed`: of the noise.

    **Returns:** an `xarray.Dataset` with a variable for each sensor over `time` [s], from zero.

    **Raises:** `ValueError` for periods that the run does not have, and for a run that is shorter than 8 samples.
    """
    instance("run", run, Trajectory, "a slipperjax.orbits.Trajectory")
    rig = Rig.of(sensors)
    rate = number(positive, "rate", rate, "Hz")
    noise = number(not_negative, "noise", noise)
    total = len(run.steps_taken)
    periods = total if periods is None else whole("periods", periods, 1, total)
    count = (len(run.period) - 1) // total * periods + 1
    places, states = jax.tree.map(lambda a: a[-count:], (run.period, run.state))
    time = np.asarray(run.scene.seconds(places) - run.scene.seconds(places[0]))
    samples = int(time[-1] * rate * (1 + 1e-12))
    require(samples >= 8, "rate", "give 8 samples or more", rate)
    at = np.arange(samples) / rate
    seen = _seen(run.scene, places, states)
    rng = np.random.default_rng(whole("seed", seed, 0))
    data = {}
    for sensor in rig.sensors:
        signal = np.asarray(sensor.read(seen, jnp.asarray(time), jnp.asarray(at), run.scene.slipper.modes))
        deviation = noise * signal.std() if sensor.noise is None else sensor.noise
        text = f"{sensor.measures.replace('_', ' ')} with noise of {deviation:.3g} {sensor.unit}"
        data[sensor.name] = column("time", signal + deviation * rng.normal(size=samples), sensor.unit, text)
    return xr.Dataset(data, {"time": column("time", at, "s", "time since the record began")})


@jit
def _seen(scene: Scene, places: jax.Array, states: State) -> Channels:
    return jax.vmap(lambda epoch, state: channels(Args(scene, epoch), 0.0, state))(places, states)
