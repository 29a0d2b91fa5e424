"""What a fit is asked, what a method of fitting answers, and what all methods have in common."""

import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import diffrax
import numpy as np
from jaxtyping import Float

from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import at_values
from ..model.scene import Scene
from .course import Windows
from .measured import MeasuredRun
from .sensors import Rig
from .unknowns import Unknown


@dataclass(frozen=True)
class Problem:
    """What a fit is asked, checked."""

    scene: Scene
    rig: Rig
    unknowns: tuple[Unknown, ...]
    runs: tuple[MeasuredRun, ...]
    origin: float
    """Forcing periods from distance zero to where runs begin."""
    steps: int | None
    """Per forcing period; None for what the scene needs."""
    solver: diffrax.AbstractSolver
    start: Motion | State
    seed: int

    @property
    def scenes(self) -> list[Scene]:
        """The scene of each run."""
        return [self.scene.replace(**run.settings) if run.settings else self.scene for run in self.runs]

    @property
    def names(self) -> tuple[str, ...]:
        """Unknown parameters of the scene."""
        return tuple(one.name for one in self.unknowns if not one.of_sensors)

    def scene_at(self, values: Mapping[str, float]) -> Scene:
        """Return the scene with values of the unknowns by name."""
        return self.scene.replace(**{name: values[name] for name in self.names})

    def rig_at(self, values: Mapping[str, float]) -> Rig:
        """Return the sensors with values of the unknowns by name."""
        names = [one.name for one in self.unknowns if one.of_sensors]
        return at_values(self.rig, names, np.array([values[name] for name in names]))


@dataclass(frozen=True)
class Posterior:
    """What is known of the parameters after a fit, by their levels, see `Unknown`."""

    level: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    information: Float[np.ndarray, "parameters parameters"]
    """Fisher's, of the record alone."""
    converged: bool
    minima: Float[np.ndarray, "minima parameters"]
    """Others that are about as likely."""
    step_change: Float[np.ndarray, " parameters"]
    """What half the step changes [standard errors]."""
    noise: Float[np.ndarray, " sensors"]
    """Standard deviations of what the model does not explain."""
    windows: Windows
    reading: Float[np.ndarray, "windows sensors samples"]
    """The signals of the model."""
    draws: Float[np.ndarray, "draws windows sensors samples"]
    """Those of parameters and starts that are as likely."""
    start: Float[np.ndarray, "windows 10"]
    """Numbers of the motions with which windows begin [SI units]."""

    def ends(self, confidence: float) -> np.ndarray:
        """Return the levels between which each parameter is with some probability, (2, parameters)."""
        from scipy.stats import norm

        reach = norm.ppf(0.5 + confidence / 2) * np.sqrt(np.diag(self.covariance))
        return np.stack([self.level - reach, self.level + reach])

    def left(self, sensor: int) -> Float[np.ndarray, " samples"]:
        """Return what the model leaves of a sensor's signals, one window after the other [its unit]."""
        known = self.windows.known[:, sensor] > 0
        return (self.windows.value - self.reading)[:, sensor][known]

    @property
    def noise_left(self) -> Float[np.ndarray, " sensors"]:
        """RMS of what the model leaves of each sensor's signals [its unit]."""
        return np.array([np.sqrt(np.mean(self.left(k) ** 2)) for k in range(len(self.noise))])


class AbstractMethod(abc.ABC):
    """A method of fitting."""

    @abc.abstractmethod
    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> Posterior:
        """Fit. **Arguments:** `shown`: is told what is done, in a few words."""
