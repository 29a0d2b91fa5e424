"""The problem of a fit, the answer of a method of fitting, and common parts of all methods."""

import abc
from collections.abc import Callable
from dataclasses import dataclass

import diffrax
import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from ..flow.record import Labelled
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..model.sensors import Rig
from ..model.step_size import default_steps_per_period
from ..solvers.named import resolve_solver
from .measured import MeasuredRun
from .unknowns import Unknown


@dataclass(frozen=True)
class Problem:
    """The checked problem of a fit."""

    scene: Scene
    rig: Rig
    unknowns: tuple[Unknown, ...]
    runs: tuple[MeasuredRun, ...]
    origin: float
    """Forcing periods from distance zero to the beginning of runs."""
    lead: int
    """Forcing periods that the model runs before this beginning; zero where the rail begins."""
    steps: int | None
    """Steps per forcing period; None for the number that the scene needs."""
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

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Unknown numbers of sensors."""
        return tuple(one.name for one in self.unknowns if one.of_sensors)

    @property
    def motion(self) -> Motion:
        """The motion of `start`."""
        return self.start.motion if isinstance(self.start, State) else self.start

    @property
    def own(self) -> Float[np.ndarray, " parameters"]:
        """Levels of the values of scene and sensors."""
        return np.array([float(one.level(one.own)) for one in self.unknowns])

    def values(self, levels: Float[np.ndarray, "*points parameters"]) -> Float[np.ndarray, "*points parameters"]:
        """Return the unknowns' values from their levels."""
        return np.stack([one.value(levels[..., k]) for k, one in enumerate(self.unknowns)], axis=-1)

    def slopes(self, levels: Float[np.ndarray, "*points parameters"]) -> Float[np.ndarray, "*points parameters"]:
        """Return the derivatives of the unknowns' values by their levels."""
        return np.stack([one.slope(levels[..., k]) for k, one in enumerate(self.unknowns)], axis=-1)

    def needed(self, levels: Float[np.ndarray, " parameters"]) -> int:
        """Return the number of steps per period that runs need."""
        own = dict(zip(self.names, self.values(levels), strict=False))
        return max(default_steps_per_period(scene.replace(**own)) for scene in self.scenes)


@dataclass(frozen=True, kw_only=True)
class Posterior(abc.ABC):
    """What is known about the parameters after a fit, by their levels, see `Unknown`."""

    level: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    information: Float[np.ndarray, "parameters parameters"]
    """Fisher's information of the record only."""
    converged: bool
    minima: Float[np.ndarray, "minima parameters"]
    """Other minima that are about as likely."""
    step_change: Float[np.ndarray, " parameters"]
    """Change by half the step [standard errors]; NaN where it is not known."""
    start: Motion
    """Motion with which the model's first run begins, `Problem.lead` periods before the record."""

    def ends(self, confidence: float) -> Float[np.ndarray, "2 parameters"]:
        """Return the levels between which each parameter is with some probability."""
        reach = norm.ppf(0.5 + confidence / 2) * np.sqrt(np.diag(self.covariance))
        return np.stack([self.level - reach, self.level + reach])

    @abc.abstractmethod
    def misfit(self, rig: Rig) -> list[str]:
        """Return texts on the parts of the signals that the model does not explain."""

    @abc.abstractmethod
    def label(self, rig: Rig) -> Labelled:
        """Return variables and coordinates of a dataset: the quantities that the method compares."""


class AbstractFitMethod(abc.ABC):
    """A method of fitting."""

    def solver(self, scene: Scene) -> diffrax.AbstractSolver:
        """Return the solver that runs have by default."""
        return resolve_solver(scene, None)

    @abc.abstractmethod
    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> Posterior:
        """Fit. **Arguments:** `shown`: called with short texts on the present work.

        **Raises:** `ValueError` for a problem that the method cannot solve.
        """
