"""Parameters of a scene from measured signals, with intervals, and what a record does not show."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import diffrax
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..flow.datasets import result_dataset, run_attributes, scene_attributes
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import at_values
from ..model.scene import Scene, check_scene
from ..model.sensors import Rig, Sensor
from ..model.step_size import given_steps
from ..orbits.simulate import beginning, check_rail, refuse_periods
from ..results.result import AbstractResult
from ..solvers.named import resolve_solver
from ..tools.checks import TOLD, instance, known, number, positive, require, whole
from ..tools.columns import column
from ..tools.description import describe
from ..tools.progress import bar as progress_bar, is_live
from .course import LANES, SIZES, Windows
from .measured import measured_runs
from .method import AbstractFitMethod, Posterior, Problem, unknowns_of
from .trajectories import Trajectories

LEAST_INFORMATION = 3.0
"""Information on a direction, in multiples of the information of the bounds, below which a record shows little about
it: the standard error is then half that of the bounds."""
LEAST_SHARE = 0.3
"""Least share of a parameter in a direction, over the greatest share, for its name to be listed."""
AT_BOUND = 2.33
"""Level beyond which an estimate is at a bound: among the 1 % of values next to the bound."""


@dataclass(frozen=True, repr=False)
class Fit(AbstractResult):
    """Parameters that explain measured signals, and how well they are known."""

    problem: Problem
    method: AbstractFitMethod
    posterior: Posterior
    confidence: float
    """Probability of `interval` [1]."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.problem.unknowns)

    @property
    def estimate(self) -> dict[str, float]:
        """Values by name [their SI units]."""
        return self._by_name(self.posterior.level)

    @property
    def interval(self) -> dict[str, tuple[float, float]]:
        """Ends of the interval that contains each parameter with the probability `confidence`, by name."""
        low, high = map(self._by_name, self.posterior.ends(self.confidence))
        return {name: (low[name], high[name]) for name in self.names}

    @property
    def stderr(self) -> dict[str, float]:
        """Standard errors by name [their SI units]."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance.values)).tolist(), strict=True))

    @property
    def covariance(self) -> xr.DataArray:
        """Covariance of the parameters [products of their SI units]."""
        slope = self.problem.slopes(self.posterior.level)
        values = self.posterior.covariance * np.outer(slope, slope)
        return xr.DataArray(
            values, {"parameter": list(self.names), "other": list(self.names)}, ("parameter", "other")
        )

    @property
    def minima(self) -> list[dict[str, float]]:
        """Other values that explain the signals about as well."""
        return [self._by_name(level) for level in self.posterior.minima]

    @property
    def not_identified(self) -> list[str]:
        """Texts on what the record does not show."""
        return not_identified(self.names, self.posterior.information)

    @property
    def misfit(self) -> list[str]:
        """Texts on what the model does not explain."""
        return self.posterior.misfit(self.problem.rig)

    @property
    def at_bounds(self) -> dict[str, str]:
        """Parameters that ended at one of their bounds, "lower" or "upper"."""
        levels = zip(self.names, self.posterior.level, strict=True)
        return {name: "lower" if x < 0 else "upper" for name, x in levels if abs(x) > AT_BOUND}

    @property
    def status(self) -> str:
        """One of "not converged", "several minima", "at a bound" and "converged", the first that holds."""
        if not self.posterior.converged:
            return "not converged"
        if len(self.posterior.minima):
            return "several minima"
        return "at a bound" if self.at_bounds else "converged"

    @property
    def scene(self) -> Scene:
        """The scene with the estimates."""
        found = self.estimate
        return self.problem.scene.replace(**{name: found[name] for name in self.problem.names})

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors with the estimates."""
        found = self.estimate
        names = self.problem.sensor_names
        return at_values(self.problem.rig, names, np.array([found[name] for name in names])).sensors

    @property
    def start(self) -> Motion | State:
        """The motion or state with which the first run begins."""
        return self.posterior.start

    def _by_name(self, levels: np.ndarray) -> dict[str, float]:
        return dict(zip(self.names, self.problem.values(levels).tolist(), strict=True))

    @property
    def _prior(self) -> np.ndarray:
        """Values beyond each of which 1 % was expected a priori, (parameters, 2)."""
        return np.array([one.value(np.array([-AT_BOUND, AT_BOUND])) for one in self.problem.unknowns])

    @functools.cached_property
    def ds(self) -> xr.Dataset:
        """One dataset for files and pictures.

        Over `parameter` it has `estimate`, `stderr`, the interval's `low` and `high`; `prior_low` and `prior_high`,
        beyond each of which 1 % was expected a priori; `at_bound`, the bound at which it ended, if any; `step_change`
        by half the step [standard errors]; `covariance`; other minima as `minimum`. All are in the parameters' units,
        the coordinate `unit`.

        For trajectories it has, over `window`, `sensor` and `sample`, the times `seconds` and the signals `measured`,
        `fitted`, `fitted_low` and `fitted_high`, and over `sensor` `noise` and `whiteness`. For features it has, over
        `feature`, `measured_feature`, `fitted_feature` and `feature_stderr`. For both it has, over `sensor` and
        `frequency`, the density of the record, `measured_density`, and the 5, 50 and 95 % densities of likely
        signals, `density_low`, `density` and `density_high`.
        """
        posterior = self.posterior
        names = list(self.names)
        low, high = np.transpose(list(self.interval.values()))
        prior_low, prior_high = self._prior.T
        minima = np.reshape([list(other.values()) for other in self.minima], (-1, len(names)))
        along = ("other_minimum", "parameter")
        each = lambda values, text, dims="parameter": column(
            dims, values, "", f"{text}, in the unit of each parameter"
        )
        data = {
            "estimate": each(list(self.estimate.values()), "estimate"),
            "stderr": each(list(self.stderr.values()), "standard error"),
            "low": each(low, "lower end of the interval"),
            "high": each(high, "upper end of the interval"),
            "prior_low": each(prior_low, "below which 1 % were expected"),
            "prior_high": each(prior_high, "above which 1 % were expected"),
            "step_change": column(
                "parameter", posterior.step_change, "1", "change by half the step, standard errors"
            ),
            "at_bound": column("parameter", [self.at_bounds.get(name, "") for name in names], "", "bound"),
            "covariance": column(("parameter", "other"), self.covariance.values, "", "covariance"),
            "minimum": each(minima, "other minima", along),
        }
        coords = {
            "parameter": names,
            "unit": ("parameter", [one.parameter.unit for one in self.problem.unknowns]),
            "other": names,
            "sensor": list(self.problem.rig.names),
            "sensor_unit": ("sensor", [sensor.unit for sensor in self.problem.rig.sensors]),
        }
        of_method, along = posterior.label(self.problem.rig)
        attrs = scene_attributes(self.scene, without=self.problem.names)
        attrs |= run_attributes(self.scene, self.start, self._call())
        attrs |= dict(status=self.status, confidence=self.confidence)
        attrs |= {"not_identified": "; ".join(self.not_identified), "misfit": "; ".join(self.misfit)}
        return result_dataset(data | of_method, coords | along, attrs)

    def _call(self) -> dict[str, object]:
        """Return the arguments of `fit` that state its problem, in the form of `load_call`."""
        problem = self.problem
        return {
            "function": "fit",
            "unknowns": [[name, *ends] for name, ends in zip(self.names, self._prior.tolist(), strict=True)],
            "sensors": [describe(sensor) for sensor in problem.rig.sensors],
            "method": repr(self.method),
            "steps_per_period": problem.steps,
            "solver": problem.solver,
            "seed": problem.seed,
        }


def not_identified(names: Sequence[str], information: Float[np.ndarray, "parameters parameters"]) -> list[str]:
    """Return texts on what a record does not show.

    **Arguments:** `information`: Fisher's, of the record only, by levels: multiples of the prior information.
    """
    texts = []
    values, directions = np.linalg.eigh(information)
    for value, way in zip(values, directions.T, strict=True):
        if value < LEAST_INFORMATION:
            named = [names[k] for k in np.argsort(-np.abs(way)) if abs(way[k]) > LEAST_SHARE * np.abs(way).max()]
            if len(named) == 1:
                texts.append(f"the record tells little of {named[0]}")
            else:
                texts.append(f"the record does not tell {named[0]} from {' and '.join(map(str, named[1:]))}")
    return texts


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
    - `begin`: place where runs begin [m], `start`: as for `simulate`; for trajectories on rails that do not recur by
        default at rest. `steps_per_period`: by default the number that the scene needs; the number grows until half
        the step changes no estimate by a fifth of its standard error. `solver`: as for `simulate`; for trajectories
        by default `RK4()`, whose derivatives are the fastest.
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
    origin, first = beginning(scene, known("begin", begin), method.start(scene) if start is None else start)
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
    method.check(problem)
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
