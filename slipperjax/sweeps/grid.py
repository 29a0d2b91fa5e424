"""The values that a sweep runs over: names checked, labelled, and cut into parts."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..model import STARTS, Parameter, Scene, check_scene
from ..model import parameter as parameter_named
from ..tools import yes_or_no


class Grid:
    """Values by parameter, of which every combination is a case, or which are read side by side.

    It holds the axes only, however many cases these make.
    """

    scene: Scene
    """The case whose parameters are varied."""
    axes: dict[str, np.ndarray]
    """Values by name, in SI units."""
    product: bool
    """Whether every combination is a case."""
    dims: tuple[str, ...]
    """Dimensions in a dataset."""
    shape: tuple[int, ...]
    """Lengths of `dims`."""

    def __init__(self, scene: Scene, grid: Mapping[str, Any], *, product: bool = True):
        """**Arguments:** `grid`: values by name, of `slipperjax.model.PARAMETERS` or `STARTS`, in SI units.

        **Raises:** `ValueError` for a wrong name, an empty axis, a bad value, or lists of several lengths side by
        side.
        """
        self.scene = check_scene(scene)
        if not isinstance(grid, Mapping) or not grid:
            raise ValueError(f"Argument `grid` must name one or more parameters with their values, but is {grid!r}.")
        self.axes = {name: _values(scene, name, raw) for name, raw in grid.items()}
        self.product = yes_or_no("product", product)
        lengths = tuple(len(v) for v in self.axes.values())
        if self.product:
            self.dims, self.shape = tuple(map(self.label, self.axes)), lengths
        else:
            if len(set(lengths)) > 1:
                raise ValueError(f"Argument `grid` must have lists of one length, but they have {lengths}.")
            self.dims, self.shape = ("case",), lengths[:1]

    @property
    def count(self) -> int:
        """Number of cases."""
        return math.prod(self.shape)

    @staticmethod
    def label(name: str) -> str:
        """What an axis is called in a dataset, where y is the displacement and not the start's."""
        return f"start_{name}" if name in STARTS else name

    def coordinates(self) -> dict[str, Any]:
        """The axes as coordinates of a dataset."""
        found = {}
        for name, values in self.axes.items():
            label, known = self.label(name), STARTS[name] if name in STARTS else parameter_named(name, self.scene)
            found[label] = (label if label in self.dims else "case", values, known.attributes)
        return found

    def part(self, region: tuple[slice, ...]) -> dict[str, np.ndarray]:
        """The values by name in a region, one slice for each of `dims`."""
        slices = region if self.product else region * len(self.axes)
        return {name: values[cut] for (name, values), cut in zip(self.axes.items(), slices, strict=True)}


def _values(scene: Scene, name: str, raw: Any) -> np.ndarray:
    if name in STARTS:
        known: Parameter = STARTS[name]
    else:
        known = parameter_named(name, scene)
        known.check_exists(scene)
    values = np.atleast_1d(np.asarray(known.checked(raw)))
    if values.ndim != 1 or values.size == 0:
        raise ValueError(f"Argument `{name}` must be a list of one or more values, but has shape {values.shape}.")
    return values
