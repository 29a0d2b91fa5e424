"""Parameters of a scene from measured signals."""

from collections.abc import Mapping, Sequence

import diffrax
import numpy as np

from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene, check_scene
from ..model.sensors import Rig, Sensor
from ..model.step_size import given_steps
from ..orbits.simulate import beginning, check_rail, refuse_periods
from ..solvers.named import resolve_solver
from ..tools.checks import TOLD, instance, known, number, positive, require, whole
from ..tools.progress import bar as progress_bar, is_live
from .course import LANES, SIZES, Windows
from .measured import measured_runs
from .method import AbstractFitMethod, Problem
from .result import Fit
from .trajectories import Trajectories
from .unknowns import unknowns_of

CHANNELS = 20 * 2 * LANES
"""Greatest total of numbers at one instant of the runs that are followed together."""


def fit(
    scene: Scene,
    measured: object,
    unknowns: Mapping[str, object],
    sensors: Sequence[Sensor],
    *,
    method: AbstractFitMethod | None = None,
    frozen: Sequence[str] = (),
    begin: float | None = None,
    start: Motion | State | None = None,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    confidence: float = 0.9,
    seed: int = 0,
    progress: bool | None = None,
) -> Fit:
    """Find parameters of a scene, and of sensors, from signals that were measured in one run or several runs.

    ```python
    sensors = [sj.model.Sensor("front", place=(0.05, 0.0, 0.0)), sj.model.Sensor("side", direction="y")]
    unknowns = {"stiffness": (1e7, 1e9), "sensors.front.gain": scipy.stats.norm(1.0, 0.05)}
    found = sj.fit(scene, "measured.csv", unknowns, sensors)
    ```

    **Arguments:**

    - `measured`: a run or several, each an `xarray.Dataset` or a file. A dataset has a variable for each sensor, with
        the sensor's name and an attribute `units`, along a coordinate of times. A CSV file has a column of times and
        one for each sensor, such as `time [s], front [g]`. Times count from the instant at which the run is at
        `begin`. Sensors may have different times, and samples may be missing. A scalar coordinate, or a column of one
        value, with the name of a parameter, such as `speed [m/s]`, gives this parameter for the run.
    - `unknowns`: by name or path in the scene, or "sensors.NAME.gain", .bias, .delay, .cutoff, .place.0,
        .direction.0: a low and a high bound, or a frozen distribution of `scipy.stats`. Between bounds all values are
        equally likely a priori; if the bounds are far apart, all logarithms. The scene's own value must be allowed.
    - `frozen`: names of `unknowns` that keep the scene's value.
    - `method`: `Trajectories()` by default, for periodic motions and short records; `Features()` in chaos.
    - `begin`: place where runs begin [m], `start`: as for `simulate`. `steps_per_period`: by default the number that
        the scene needs; the number grows until half the step changes no estimate by a fifth of its standard error.
        `solver`: as for `simulate`; for trajectories by default `RK4()`, whose derivatives are the fastest.
    - `confidence`: probability of the intervals; `seed`: of the first points that are tried.

    **Returns:** a `Fit`; check its `status`, `not_identified` and `misfit`.

    **Raises:** `ValueError` that names the wrong argument; `KeyboardInterrupt` after Ctrl-C.
    """
    scene = known("scene", check_scene(scene))
    rig = Rig.of(sensors)
    modes = scene.slipper.modes
    steady = scene.travel(0.0).acceleration is None
    for sensor in rig.sensors:
        # the motion of an elastic body is not known at all places
        if modes is not None and sensor.measures in ("acceleration", "displacement"):
            modes.check_place(np.asarray(sensor.place))
        require(steady or sensor.cutoff is None, "cutoff", "be None at a speed that changes", sensor.cutoff)
    method = Trajectories() if method is None else method
    instance("method", method, AbstractFitMethod, "a method of slipperjax.fitting")
    runs = measured_runs(measured, rig)
    origin, first = beginning(scene, known("begin", begin), start)
    confidence = number(positive, "confidence", confidence)
    require(confidence < 1, "confidence", "be below 1", confidence)
    problem = Problem(
        scene=scene,
        rig=rig,
        unknowns=unknowns_of(scene, rig, unknowns, frozen),
        runs=runs,
        origin=float(scene.epoch_at(origin)),
        # one period, unless the rail begins there
        lead=int(steady and float(origin) - float(scene.wavelength) >= float(scene.track.begin)),
        steps=None if steps_per_period is None else given_steps(steps_per_period),
        solver=method.solver(scene) if solver is None else resolve_solver(scene, solver),
        start=first,
        seed=whole("seed", seed, 0),
    )
    periods = Windows.of(problem).periods
    check_rail(scene, periods, origin)
    # at each instant, channels of some runs along all directions; a wrong unit of times would make these too many
    steps = problem.steps or problem.needed(problem.own)
    refuse_periods(periods, steps, CHANNELS * steps * periods * (len(problem.unknowns) + len(SIZES)))
    told = TOLD.set(set() if TOLD.get() is None else TOLD.get())  # each kind of warning once, not at each point
    try:
        with progress_bar(progress, programs=3, bar_format="{desc} {elapsed}") as bar:
            # files and pipes need no line for each point
            posterior = method.fitted(problem, lambda text: bar.set_description_str(text, refresh=is_live()))
    finally:
        TOLD.reset(told)
    return Fit(problem, method, posterior, confidence)
