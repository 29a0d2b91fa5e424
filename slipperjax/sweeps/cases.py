"""Grids of parameters as a batch of scenes and starts: names are resolved here, and nowhere below."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from ..model import STARTS, Motion, Scene, State, rounded_steps, steps_needed
from ..tools import Batched, jit
from .grid import Grid
from .limits import refuse_cases

LANES = 8
"""Batches are filled up to multiples of this, a vector register's worth: results then depend on no batch size."""


class Cases:
    """The flat list of cases that a grid makes: a batch of scenes, and a start for each."""

    scene: Scene
    """The case whose parameters are varied."""
    scenes: Batched[Scene]
    start: Motion | State
    """The motion or state at time zero, where the grid does not vary it."""
    starts: Motion | State
    """Those of the cases, with a leading axis."""
    grid: Grid
    """What is varied, in SI units."""

    def __init__(self, scene: Scene, grid: Mapping[str, Any], start: Motion | State, *, product: bool = True):
        """**Arguments:**

        - `scene`: the case whose parameters are varied.
        - `grid`: values by name, of `slipperjax.model.PARAMETERS` or `STARTS`, in SI units.
        - `start`: the motion or state at time zero, where the grid does not vary it.
        - `product`: whether every combination is a case, or the lists are read side by side.

        **Raises:** `ValueError` for a wrong name, an empty axis, a bad value, or lists of several lengths side by
        side.
        """
        self.grid = Grid(scene, grid, product=product)
        self.scene = scene
        refuse_cases(self.grid.count)
        flat = self.axes
        if self.grid.product:
            mesh = np.meshgrid(*self.axes.values(), indexing="ij")
            flat = {name: m.ravel() for name, m in zip(self.axes, mesh, strict=True)}
        varied = {name: values for name, values in flat.items() if name not in STARTS}
        single = scene.replace(**{name: values[0] for name, values in varied.items()})  # parts that were None are set
        scenes = Batched.of(scene.replace(**varied), single)
        self.scenes = Batched(jax.tree.map(np.asarray, scenes.varied), scenes.shared)
        self.start = start
        motion = start.motion if isinstance(start, State) else start
        of_start = vars(motion) | {name: values for name, values in flat.items() if name in STARTS}
        self.starts = Motion(**{k: np.broadcast_to(np.asarray(v, float), self.count) for k, v in of_start.items()})
        if isinstance(start, State):
            alike = jax.tree.map(lambda v: np.broadcast_to(np.asarray(v, float), (self.count, *np.shape(v))), start)
            self.starts = eqx.tree_at(lambda state: state.motion, alike, self.starts)

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """The grid's values by name, in SI units."""
        return self.grid.axes

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the grid in a dataset."""
        return self.grid.dims

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of `dims`."""
        return self.grid.shape

    @property
    def count(self) -> int:
        """Number of cases."""
        return self.grid.count

    def label(self, name: str) -> str:
        """What an axis is called in a dataset, where y is the displacement and not the start's."""
        return self.grid.label(name)

    def coordinates(self) -> dict[str, Any]:
        """The axes as coordinates of a dataset."""
        return self.grid.coordinates()

    def take(self, index: np.ndarray) -> tuple[Batched[Scene], Motion | State]:
        """The scenes and starts at some places, for a compiled program."""
        return self.scenes.take(index), jax.tree.map(lambda v: v[index], self.starts)

    def forcing_periods(self) -> Float[np.ndarray, " cases"]:
        """The forcing period of each case [s]."""
        return np.asarray(_forcing_periods(*self.take(np.arange(self.count))))

    def default_steps(self) -> Int[np.ndarray, " cases"]:
        """Steps per period that each case needs, see `slipperjax.default_steps_per_period`."""
        index = filled(np.arange(self.count), self.count)
        return rounded_steps(np.asarray(_steps_needed(*self.take(index))))[: self.count]


@jit
def _steps_needed(scenes: Batched[Scene], starts: Motion | State) -> jax.Array:
    return scenes.map(lambda scene, start: steps_needed(scene), starts)


@jit
def _forcing_periods(scenes: Batched[Scene], starts: Motion | State) -> jax.Array:
    return scenes.map(lambda scene, start: scene.period, starts)


def batch_size(count: int) -> int:
    """The smallest of 8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 160, ... that is not below `count`.

    Few sizes, four in an octave, so that sweeps of other numbers of cases meet programs that are compiled already.
    """
    unit = LANES * max(1, 1 << max((max(count, 1) - 1).bit_length() - 6, 0))
    return -(-max(count, 1) // unit) * unit


def filled(index: np.ndarray, least: int) -> np.ndarray:
    """Indices of cases, the last one repeated until there are `least`, and as many as `batch_size` gives."""
    count = batch_size(max(least, len(index)))
    return index[np.minimum(np.arange(count), len(index) - 1)]


def path_cases(scene: Scene, path: Mapping[str, Any], start: Motion | State) -> tuple[Cases, str, np.ndarray]:
    """The cases along one parameter, its name and its values, which must increase.

    **Raises:** `ValueError` for several parameters, a coordinate of the start, or values that do not increase.
    """
    if not isinstance(path, Mapping) or len(path) != 1:
        raise ValueError(f"Argument `path` must name one parameter with increasing values, but is {path!r}.")
    cases = Cases(scene, path, start)
    name, values = next(iter(cases.axes.items()))
    if len(cases.axes) > 1 or name in STARTS or np.any(np.diff(values) <= 0):
        raise ValueError(f"Argument `path` must name one parameter with increasing values, but is {path!r}.")
    return cases, name, values
