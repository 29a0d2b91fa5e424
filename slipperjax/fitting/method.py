"""The problem of a fit: numbers to find, and what is known about them before; and the answer of its methods."""

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import diffrax
import numpy as np
from jaxtyping import Float
from scipy.stats import loguniform, norm, qmc, uniform

from ..flow.record import Labelled
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import Parameter, checked_parameters, parameter
from ..model.scene import Scene
from ..model.sensors import Rig
from ..model.step_size import default_steps_per_period
from ..solvers.named import resolve_solver
from ..tools.checks import instance, require
from ..tools.types import AnyArray
from .measured import MeasuredRun

WIDE = 5.0
"""Ratio of bounds above which all logarithms between them are equally likely."""
FARTHEST = 6.0
"""Level beyond which values hardly change."""
OF_SENSORS = "sensors."


class Unknown(NamedTuple):
    """A number to find, and its prior distribution.

    Its `level` is the standard normal deviate of the same probability. In this way all priors are alike: levels have
    mean 0 and standard deviation 1, and never leave the bounds.
    """

    parameter: Parameter
    """The parameter, whose unit is the value's unit; the bias of a sensor has the sensor's unit."""
    prior: Any
    """A frozen distribution of `scipy.stats`."""
    own: float
    """Value in the user's scene or sensors."""

    @property
    def name(self) -> str:
        return self.parameter.name

    @property
    def of_sensors(self) -> bool:
        return self.name.startswith(OF_SENSORS)

    def value(self, level: AnyArray) -> np.ndarray:
        """Return the values of some levels."""
        # from the nearer tail, where shares are exact
        return np.where(level < 0, self.prior.ppf(norm.cdf(level)), self.prior.isf(norm.sf(level)))

    def level(self, value: AnyArray) -> np.ndarray:
        """Return the levels of some values; infinite beyond the bounds."""
        low = self.prior.cdf(value)
        return np.where(low < 0.5, norm.ppf(low), norm.isf(self.prior.sf(value)))

    def slope(self, level: AnyArray) -> np.ndarray:
        """Return the derivative of the value by the level."""
        # in the farthest tails both densities vanish
        level = np.clip(level, -FARTHEST, FARTHEST)
        return np.asarray(norm.pdf(level) / self.prior.pdf(self.value(level)))


def unknowns_of(scene: Scene, rig: Rig, priors: object, frozen: Sequence[str] = ()) -> tuple[Unknown, ...]:
    """Return the numbers to find, first parameters of the scene, then of sensors.

    **Arguments:** `priors`: by name or path, a low and a high bound or a distribution; `frozen`: names among these
    that keep their value.

    **Raises:** `ValueError` for unknown names, for values that are no bounds, and for bounds that exclude the scene's
    own value.
    """
    need = 'be bounds by name, such as {"stiffness": (1e8, 1e10)}'
    given: Mapping[str, object] = instance("unknowns", priors, Mapping, need.removeprefix("be "))
    require(given, "unknowns", need, priors)
    for name in frozen:
        require(name in given, "frozen", f"be some of {', '.join(map(str, given))}", name)
    names = [name for name in given if name not in frozen]
    require(names, "unknowns", "leave something to find", shown="all frozen")
    own = [name for name in names if not str(name).startswith(OF_SENSORS)]
    found = [_unknown(one, given, scene) for one in (checked_parameters(own, scene) if own else ())]
    for name in names:
        if name not in own:
            one = parameter(name, rig)
            require(one.of(rig) is not None, name, "be a number that the sensor has", shown="None")
            if name.endswith(".bias"):
                unit = rig.sensors[rig.names.index(name.split(".")[1])].unit
                one = dataclasses.replace(one, unit=unit)
            found.append(_unknown(one, given, rig))
    return tuple(found)


def _unknown(one: Parameter, priors: Mapping[str, object], part: Scene | Rig) -> Unknown:
    """Return an unknown with bounds or a distribution that allow the present value of the scene or the sensors."""
    given = priors[one.name]
    value = float(one.of(part))
    need = "have a low and a high bound, or a frozen distribution of scipy.stats"
    prior: Any = given
    if not hasattr(given, "dist"):
        require(not hasattr(given, "ppf"), one.name, need, shown="a distribution without its parameters")
        ends = np.asarray(one.check(given), float)
        require(ends.shape == (2,) and ends[0] < ends[1], one.name, need, given)
        low, high = map(float, ends)
        prior = loguniform(low, high) if low > 0 and high > WIDE * low else uniform(low, high - low)
    low, high = map(float, prior.support())
    need = f"have bounds on both sides of the scene's own value, {value:.6g} {one.unit}".rstrip()
    require(low < value < high, one.name, need, shown=f"{low:g} to {high:g}")
    return Unknown(one, prior, value)


def spread(unknowns: Sequence[Unknown], count: int, seed: int) -> Float[np.ndarray, "count unknowns"]:
    """Return levels that cover the priors evenly, by Sobol's points."""
    engine = qmc.Sobol(len(unknowns), rng=np.random.default_rng(seed))
    points = engine.random(1 << max(count - 1, 1).bit_length())[:count]
    # not in the farthest tails, from which a fit moves slowly
    return norm.ppf(0.02 + 0.96 * points)


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
    def recurs(self) -> bool:
        """Whether the rail recurs, so that motions may settle, and be alike elsewhere."""
        return bool(np.isfinite(self.scene.recurrence))

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
    start: Motion | State
    """Start of the model's first run, `Problem.lead` periods before the record; a state where its contacts have the
    memory of the problem's start."""

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

    def start(self, scene: Scene) -> str | None:
        """Return the start that runs have by default, as for `simulate`."""
        return None

    def check(self, problem: Problem) -> None:  # noqa: B027 - most methods solve every problem
        """Raise `ValueError` for a problem that the method cannot solve."""

    @abc.abstractmethod
    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> Posterior:
        """Fit. **Arguments:** `shown`: called with short texts on the present work."""
