"""Numbers that a fit finds: parameters of the scene and of the sensors, and what is known about them before."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import loguniform, norm, qmc, uniform

from ..model.parameters import Parameter, checked_parameters, parameter
from ..model.scene import Scene
from ..model.sensors import Rig
from ..tools.checks import instance, require
from ..tools.types import AnyArray

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
