"""The result of a fit: estimates with intervals, what the record does not tell, and what the model leaves of it."""

import dataclasses
import os
from dataclasses import dataclass

import numpy as np
import xarray as xr

from ..analysis.environment import band_edges, window_densities
from ..flow.datasets import run_attributes, scene_attributes
from ..model.kinematics import Motion
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..tools.columns import column
from ..tools.description import describe
from ..tools.files import user_path, write_whole
from .judged import unexplained, untold, whiteness
from .method import AbstractMethod, Posterior, Problem

AT_BOUND = 2.33
"""Level beyond which an estimate is at a bound, among the 1 % of values next to it."""


@dataclass(frozen=True)
class Fit:
    """Parameters that explain measured signals, and how well they are known."""

    problem: Problem
    method: AbstractMethod
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
        """Ends of the interval in which each parameter is, with the probability `confidence`, by name."""
        low, high = map(self._by_name, self.posterior.ends(self.confidence))
        return {name: (low[name], high[name]) for name in self.names}

    @property
    def stderr(self) -> dict[str, float]:
        """Standard errors by name [their SI units]."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance.values)).tolist(), strict=True))

    @property
    def covariance(self) -> xr.DataArray:
        """Covariance of the parameters [products of their SI units]."""
        slope = np.array([one.slope(x) for one, x in zip(self.problem.unknowns, self.posterior.level, strict=True)])
        values = self.posterior.covariance * np.outer(slope, slope)
        return xr.DataArray(values, {"parameter": list(self.names), "other": list(self.names)}, ("parameter", "other"))

    @property
    def minima(self) -> list[dict[str, float]]:
        """Other values that explain the signals about as well."""
        return [self._by_name(level) for level in self.posterior.minima]

    @property
    def untold(self) -> list[str]:
        """In words, what the record does not tell."""
        return untold(self.names, self.posterior.information)

    @property
    def unexplained(self) -> list[str]:
        """In words, which signals the model does not explain."""
        texts = []
        for k, sensor in enumerate(self.problem.rig.sensors):
            texts.append(unexplained(sensor.name, self.whiteness[k], float(self.posterior.noise_left[k]), sensor.noise))
        return [text for text in texts if text]

    @property
    def whiteness(self) -> list[float]:
        """For each sensor the probability that white noise is as correlated as what the model leaves [1]."""
        return [whiteness(self.posterior.left(k)) for k in range(len(self.problem.rig.sensors))]

    @property
    def at_bounds(self) -> dict[str, str]:
        """Parameters that ended at one of their bounds, "lower" or "upper"."""
        level = dict(zip(self.names, self.posterior.level, strict=True))
        return {name: "lower" if x < 0 else "upper" for name, x in level.items() if abs(x) > AT_BOUND}

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
        return self.problem.scene_at(self.estimate)

    @property
    def sensors(self) -> tuple:
        """The sensors with the estimates."""
        return self.problem.rig_at(self.estimate).sensors

    @property
    def start(self) -> Motion:
        """The motion with which the first run begins."""
        return Motion(*self.posterior.start[0])

    def _by_name(self, levels: np.ndarray) -> dict[str, float]:
        pairs = zip(self.problem.unknowns, levels, strict=True)
        return {one.name: float(one.value(level)) for one, level in pairs}

    def __repr__(self) -> str:
        rows = []
        for one in self.problem.unknowns:
            q = _quantity(one)
            low, high = (q.shown(end) for end in self.interval[one.name])
            value = q.shown(self.estimate[one.name])
            bound = self.at_bounds.get(one.name)
            where = f" (its {bound} bound)" if bound else ""
            rows.append(f"{one.name} {value:.5g} ({low:.5g} to {high:.5g}) {q.display_unit}".rstrip() + where)
        rows += [f"another minimum: {other}" for other in self.minima]
        rows += [*self.untold, *self.unexplained]
        inside = ",\n  ".join(rows)
        return f"Fit(status: {self.status}, {100 * self.confidence:g} % intervals,\n  {inside})"

    def to_xarray(self) -> xr.Dataset:
        """Return one dataset for files and pictures.

        - Over `parameter`: `estimate`, `stderr`, the interval's `low` and `high`, `prior_low` and `prior_high`, 1 % of
          what was expected before lies beyond either, `step_change` by half the step [standard errors], each with
          the coordinate `unit`; `covariance`; `minimum` for other minima.
        - Over `sensor`: `noise` that the model leaves, `whiteness`; and over `window` and `sample` the signals:
          `seconds` since the run began, `measured`, `fitted`, `fitted_low` and `fitted_high` of 90 % of likely
          parameters.
        - Over `sensor` and `frequency`: densities of the signals, `measured_density`, and of likely ones,
          `density_low`, `density` and `density_high` of 5, 50 and 95 %.
        """
        posterior = self.posterior
        names = list(self.names)
        each = "in the unit of each parameter"
        ends = np.array([self.interval[name] for name in names])
        prior = np.array([one.value(np.array([-AT_BOUND, AT_BOUND])) for one in self.problem.unknowns])
        units = [sensor.unit for sensor in self.problem.rig.sensors]
        minima = np.array([[other[name] for name in names] for other in self.minima]).reshape(-1, len(names))
        over = ("window", "sensor", "sample")
        windows = posterior.windows
        blank = lambda array: np.where(windows.known > 0, array, np.nan)
        low, high = np.quantile(posterior.draws, [0.05, 0.95], axis=0)
        data = {
            "estimate": column("parameter", list(self.estimate.values()), "", f"estimate, {each}"),
            "stderr": column("parameter", list(self.stderr.values()), "", f"standard error, {each}"),
            "low": column("parameter", ends[:, 0], "", f"lower end of the interval, {each}"),
            "high": column("parameter", ends[:, 1], "", f"upper end of the interval, {each}"),
            "prior_low": column("parameter", prior[:, 0], "", f"expected before with 99 % to be above, {each}"),
            "prior_high": column("parameter", prior[:, 1], "", f"expected before with 99 % to be below, {each}"),
            "step_change": column("parameter", posterior.step_change, "1", "change by half the step [standard errors]"),
            "covariance": column(("parameter", "other"), self.covariance.values, "", "covariance"),
            "minimum": column(("minimum", "parameter"), minima, "", f"other minima, {each}"),
            "noise": column("sensor", posterior.noise_left, "", "RMS of what the model leaves, in the sensor's unit"),
            "whiteness": column("sensor", self.whiteness, "1", "probability that white noise is as correlated"),
            "seconds": column(over, blank(windows.time), "s", "time since the run began"),
            "measured": column(over, blank(windows.value), "", "measured signal, in the sensor's unit"),
            "fitted": column(over, blank(posterior.reading), "", "the model's signal, in the sensor's unit"),
            "fitted_low": column(over, blank(low), "", "5 % quantile of likely signals, in the sensor's unit"),
            "fitted_high": column(over, blank(high), "", "95 % quantile of likely signals, in the sensor's unit"),
        }
        coords = {
            "parameter": names,
            "unit": ("parameter", [one.unit for one in self.problem.unknowns]),
            "other": names,
            "sensor": list(self.problem.rig.names),
            "sensor_unit": ("sensor", units),
            "run": ("window", windows.run),
        }
        frequency, densities = self._densities()
        along = ("sensor", "frequency")
        text = "power spectral density, the square of the sensor's unit per Hz"
        data["measured_density"] = column(along, densities[0], "", f"{text}, measured")
        for name, share in (("density_low", 0.05), ("density", 0.5), ("density_high", 0.95)):
            data[name] = column(along, np.quantile(densities[1:], share, axis=0), "", f"{text}, {share:.0%} of likely ones")
        coords["frequency"] = column("frequency", frequency, "Hz", "middle of a band")
        attrs = scene_attributes(self.scene) | run_attributes(self.scene, self.start, self._call())
        attrs |= dict(status=self.status, confidence=self.confidence)
        attrs |= {"untold": "; ".join(self.untold), "unexplained": "; ".join(self.unexplained)}
        return xr.Dataset(data, coords, attrs)

    def _densities(self) -> tuple[np.ndarray, np.ndarray]:
        """Return middles of bands [Hz], and densities of the first window: measured, then of likely parameters with
        noise, (kinds, sensors, bands)."""
        windows = self.posterior.windows
        rng = np.random.default_rng(0)
        every = [windows.value[0], *self.posterior.draws[:, 0]]
        time = windows.time[0]
        known = windows.known[0] > 0
        longest = max(float(np.ptp(time[k][known[k]])) for k in range(len(time)) if known[k].any())
        rates = [known[k].sum() / max(np.ptp(time[k][known[k]]), 1e-12) for k in range(len(time)) if known[k].any()]
        edges = band_edges(min(3.0 / longest, max(rates) / 8), max(rates) / 2, per_octave=3)
        found = np.full((len(every), len(time), len(edges) - 1), np.nan)
        for k in range(len(time)):
            at = time[k][known[k]]
            if len(at) < 8:
                continue
            # unequal samples as equal ones
            grid = np.linspace(at[0], at[-1], len(at))
            rate = (len(at) - 1) / (at[-1] - at[0])
            for number, signal in enumerate(every):
                noise = self.posterior.noise[k] * rng.normal(size=len(at)) if number else 0.0
                equal = np.interp(grid, at, signal[k][known[k]] + noise)
                found[number, k] = window_densities(equal, rate, edges, window=longest)[1].mean(axis=0)
        return np.sqrt(edges[1:] * edges[:-1]), found

    def _call(self) -> dict[str, object]:
        problem = self.problem
        bounds = [[one.name, *map(float, one.value(np.array([-AT_BOUND, AT_BOUND])))] for one in problem.unknowns]
        return {
            "function": "fit",
            "unknowns": bounds,
            "sensors": [describe(sensor) for sensor in problem.rig.sensors],
            "method": [type(self.method).__name__, *map(str, dataclasses.astuple(self.method))],
            "steps_per_period": problem.steps,
            "solver": problem.solver,
            "seed": problem.seed,
        }

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write `to_xarray()`, whole or not at all; `load_scene` reads the scene with the estimates from it."""
        write_whole(user_path(path), self.to_xarray().to_netcdf(engine="h5netcdf"))


def _quantity(one) -> Quantity:
    """Return the quantity of an unknown, whose unit may be that of a sensor."""
    return one.parameter if one.parameter.unit == one.unit else dataclasses.replace(one.parameter, unit=one.unit)
