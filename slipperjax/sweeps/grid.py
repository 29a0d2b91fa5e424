"""Grids and samples of parameters, as batches of scenes and starts, and as tiles. Names are resolved only here."""

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PyTree

from ..model.dang2024 import paper_scene
from ..model.dynamics import State
from ..model.excitation import speed_ratio, warn_of_excitation
from ..model.kinematics import Motion
from ..model.parameters import STARTS, Parameter, of_motion, parameter
from ..model.scene import Scene, check_scene
from ..model.step_size import rounded_steps, steps_needed
from ..model.tracks import AbstractTrack
from ..tools.batching import Batched
from ..tools.checks import known, numbers, require, whole, yes_or_no
from ..tools.compile import jit
from ..tools.limits import refuse_impossible


class Grid:
    """Values by parameter, of which every combination is a case, or which are read side by side.

    A grid has only the axes, for any number of cases.
    """

    scene: Scene  # the case whose parameters are varied
    axes: dict[str, np.ndarray]  # values by name, in SI units
    product: bool  # whether every combination is a case
    dims: tuple[str, ...]  # dimensions in a dataset
    shape: tuple[int, ...]  # lengths of `dims`

    def __init__(self, scene: Scene, grid: Mapping[str, object], *, product: bool = True):
        """**Arguments:** `grid`: values by name, of `slipperjax.PARAMETERS` or `STARTS`, in SI units.

        **Raises:** `ValueError` for a wrong name, an empty axis, a bad value, or lists of several lengths side by
        side.
        """
        self.scene = check_scene(scene)
        require(
            isinstance(grid, Mapping) and grid,
            "grid",
            "name one or more parameters with their values",
            grid,
        )
        known("scene", scene)
        known("grid", dict(grid))
        self.axes = {name: _values(scene, name, raw) for name, raw in grid.items()}
        self.product = yes_or_no("product", product)
        lengths = tuple(len(v) for v in self.axes.values())
        if self.product:
            self.dims = tuple(self.axes)
            self.shape = lengths
        else:
            require(len(set(lengths)) == 1, "grid", "have lists of one length", lengths)
            self.dims = ("case",)
            self.shape = lengths[:1]

    @property
    def count(self) -> int:
        """Number of cases."""
        return math.prod(self.shape)

    def coordinates(self) -> dict[str, object]:
        """Return the axes as coordinates of a dataset."""
        return {
            name: (name if self.product else "case", values, _parameter(self.scene, name).attributes)
            for name, values in self.axes.items()
        }

    def check_steps(self, steps: Any) -> None:
        """Raise `ValueError` unless steps per period are one number, or one number for each case."""
        if isinstance(steps, list | tuple):
            # rows of different lengths have no shape
            numbers("steps_per_period", steps)
        good = np.ndim(steps) == 0 or np.shape(steps) == self.shape
        need = f"have one number or one for each case, {self.shape}"
        require(good, "steps_per_period", need, shown=f"shape {np.shape(steps)}")

    def sample(self, start: Motion | State, count: int = 4096) -> "Cases":
        """Return `count` cases spread evenly over the grid, or all cases if there are no more."""
        if count >= self.count:
            return Cases(self.scene, self.axes, start, product=self.product)
        return Cases(self.scene, self.part(self.spread(count)), start, product=False)

    def spread(self, count: int) -> tuple[np.ndarray, ...]:
        """Return the indices of `count` cases spread evenly over the grid; some repeat if there are fewer cases."""
        # the middles of `count` equal parts of the flat list
        index = np.floor((np.arange(count) + 0.5) * self.count / count).astype(int)
        return np.unravel_index(index, self.shape)

    def part(self, index: tuple[slice | np.ndarray, ...]) -> dict[str, np.ndarray]:
        """Return the values by name in a part of the grid: a slice, or indices, for each of `dims`."""
        # lists side by side are all cut by the one index of `case`
        index = index if self.product else index * len(self.axes)
        return {name: values[k] for (name, values), k in zip(self.axes.items(), index, strict=True)}


def _parameter(scene: Scene, name: str) -> Parameter:
    """Return a parameter of a scene, or a coordinate of the start."""
    return STARTS[name] if name in STARTS else parameter(name, scene)


def _values(scene: Scene, name: str, raw: object) -> np.ndarray:
    quantity = _parameter(scene, name)
    quantity.check_exists(scene)
    values = np.atleast_1d(np.asarray(quantity.check(raw)))
    listed = values.ndim == 1 and values.size > 0
    require(listed, name, "have a list of one or more values", shown=f"shape {values.shape}")
    return values


class Tiling(NamedTuple):
    """A grid as blocks of equal shape, cut off at the grid's ends, numbered with the last dimension fastest."""

    shape: tuple[int, ...]  # of the grid
    tile: tuple[int, ...]  # of a block

    @classmethod
    def of(cls, shape: tuple[int, ...], size: int | None = None) -> "Tiling":
        """Return blocks of about `size` cases, whole along the last dimensions."""
        if size is None:
            # 2048 cases are a few seconds of work, and few enough to lose in a crash; above 4096 tiles the tiles
            # grow, because each tile has a file for every variable
            size = min(max(2048, math.prod(shape) // 4096), 65_536)
        tile = [1] * len(shape)
        left = size
        # the last dimensions whole; the first dimension that does not fit in pieces of nearly equal length
        for k in reversed(range(len(shape))):
            pieces = -(-shape[k] // max(left, 1))
            tile[k] = -(-shape[k] // pieces)
            left //= shape[k]
        return cls(shape, tuple(tile))

    @property
    def counts(self) -> tuple[int, ...]:
        """Blocks along each dimension."""
        return tuple(-(-n // m) for n, m in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    @property
    def size(self) -> int:
        """Cases of a whole block."""
        return math.prod(self.tile)

    def indices(self, number: int) -> tuple[int, ...]:
        """Return the indices of a block along the dimensions, which name its files."""
        return tuple(int(k) for k in np.unravel_index(number, self.counts))

    def region(self, number: int) -> tuple[slice, ...]:
        """Return the slices of the grid that give a block."""
        ends = zip(self.indices(number), self.tile, self.shape, strict=True)
        return tuple(slice(k * m, min((k + 1) * m, n)) for k, m, n in ends)

    def cases(self, number: int) -> int:
        """Return the number of cases of a block."""
        return math.prod(part.stop - part.start for part in self.region(number))


JUDGED = 64
"""Greatest number of cases of a grid that are searched for slippers that excite themselves."""
VECTOR_LANES = 8
"""Batches are filled up to multiples of this, the size of a vector register. Batches of several registers round
alike.
"""


class Cases(Grid):
    """The flat list of cases that a grid makes: a batch of scenes, and a start for each."""

    scenes: Batched[Scene]
    start: Motion | State  # the motion or state at time zero, where the grid does not vary it
    starts: Motion | State  # starts of the cases, with a leading axis

    def __init__(self, scene: Scene, grid: Mapping[str, object], start: Motion | State, *, product: bool = True):
        """**Arguments:** `start`: the motion or state at time zero, whose coordinates the grid may vary; other
        arguments, and errors, as for `Grid`.
        """
        super().__init__(scene, grid, product=product)
        flat = self.axes
        if self.product:
            mesh = np.meshgrid(*self.axes.values(), indexing="ij")
            flat = {name: m.ravel() for name, m in zip(self.axes, mesh, strict=True)}
        # leaves with one axis more than those of a single case vary
        varied = {name: values for name, values in flat.items() if name not in STARTS}
        single = scene.replace(**{name: values[0] for name, values in varied.items()})  # sets parts that were None
        scenes = Batched.of(scene.replace(**varied), single)
        self.scenes = Batched(jax.tree.map(np.asarray, scenes.varied), scenes.shared)
        self.start = start
        # all other values are the same in all cases
        alike = lambda v: np.broadcast_to(np.asarray(v, float), (self.count, *np.shape(v)))
        starts = jax.tree.map(alike, start)
        varying = of_motion({name: np.asarray(values, float) for name, values in flat.items()})
        motion = lambda begun: begun.motion if isinstance(begun, State) else begun
        self.starts = eqx.tree_at(motion, starts, dataclasses.replace(motion(starts), **varying))

    def take(self, index: np.ndarray) -> tuple[Batched[Scene], Motion | State]:
        """Return the scenes and starts at some indices, for a compiled program, with prepared tracks."""
        scenes, starts = self.unprepared(index)
        # most tracks have nothing to prepare, and need no program
        plain = type(scenes.shared.track).prepared is AbstractTrack.prepared
        return (scenes if plain else _prepared(scenes)), starts

    def unprepared(self, index: np.ndarray) -> tuple[Batched[Scene], Motion | State]:
        """Return the scenes and starts at some indices, with tracks that are not prepared."""
        return self.scenes.take(index), jax.tree.map(lambda v: v[index], self.starts)

    @property
    def bytes_of_rail(self) -> int:
        """Memory of the prepared rail of each case; 0 where all share one rail, or where nothing is prepared."""
        track = self.scene.track
        shared = not any(name.partition(".")[0] == "track" for name in self.axes)
        if shared or type(track).prepared is AbstractTrack.prepared:
            return 0
        made = jax.tree.leaves(eqx.filter_eval_shape(lambda rail: rail.prepared(), track))
        return sum(leaf.size * leaf.dtype.itemsize for leaf in made)

    def forcing_periods(self) -> Float[np.ndarray, " cases"]:
        """Return the forcing period of each case [s]."""
        return self.of_each(_facts)[0]

    def wavelengths(self) -> Float[np.ndarray, " cases"]:
        """Return the length of travel that counts as a forcing period of each case [m]."""
        return self.of_each(_facts)[1]

    def default_steps(self) -> Int[np.ndarray, " cases"]:
        """Return the steps per period that each case needs, see `slipperjax.model.default_steps_per_period`."""
        _, wavelengths, needed = self.of_each(_facts)
        return rounded_steps(needed, wavelengths)

    def warn_of_excitation(self) -> None:
        """Warn once where slippers excite themselves, of the first such case of a choice of cases."""
        if self.scene.beam is not None:
            ratios = self.of_each(lambda scenes, starts: scenes.map(lambda scene, _: speed_ratio(scene), starts))
            # slippers that are faster or softer may be stable
            fast = np.flatnonzero(ratios > 1)
            for k in fast[:: len(fast) // JUDGED + 1]:
                if warn_of_excitation(jax.tree.map(jnp.asarray, self.scenes.case(int(k)))):
                    return

    def of_each(self, program: Callable[..., PyTree], *more: object) -> PyTree:
        """Return the arrays (cases, ...) that `program(scenes, starts, *more)` gives, compiled for few sizes."""
        made = program(*self.unprepared(filled(np.arange(self.count), self.count)), *more)
        return jax.tree.map(lambda facts: np.asarray(facts)[: self.count], made)


@jit
def _prepared(scenes: Batched[Scene]) -> Batched[Scene]:
    """Return the same scenes with tracks in the form that runs evaluate, once for all calls."""
    tracks = Batched(scenes.varied.track, scenes.shared.track).apply(lambda track: track.prepared())
    is_track = lambda part: isinstance(part, AbstractTrack)
    put = lambda scene, track: eqx.tree_at(lambda s: s.track, scene, track, is_leaf=is_track)
    return Batched(put(scenes.varied, tracks.varied), put(scenes.shared, tracks.shared))


@jit
def _facts(scenes: Batched[Scene], starts: Motion | State) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return forcing period [s], wavelength [m] and steps needed of each case."""
    of_case = lambda scene, start: (scene.period, scene.wavelength, steps_needed(scene))
    return scenes.map(of_case, starts)


def batch_size(count: int) -> int:
    """Return the smallest of 8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 124, 132, 160, ... that is at least `count`.

    There are few sizes, four in an octave, so that sweeps with other numbers of cases use programs that already
    exist.
    """
    # Arrays of 20 points of 128 cases are multiples of 4096 bytes. All would begin at the same place of the cache's
    # rows, where only eight have room; a step of a case would take 7 % more time.
    avoided = 128
    few = VECTOR_LANES // 2
    if count > avoided and count % avoided == few:
        return count
    # 8 up to 64, 16 up to 128, 32 up to 256, ...
    unit = VECTOR_LANES * max(1, 1 << max((max(count, 1) - 1).bit_length() - 6, 0))
    size = -(-max(count, 1) // unit) * unit
    if size % avoided:
        return size
    return size - few if count <= size - few else size + few


def filled(index: np.ndarray, least: int) -> np.ndarray:
    """Return indices of cases that fill a batch of `least` cases or more: the last case is repeated."""
    count = batch_size(max(least, len(index)))
    return index[np.minimum(np.arange(count), len(index) - 1)]


def path_grid(scene: Scene, path: Mapping[str, object]) -> tuple[Grid, str, np.ndarray]:
    """Return the grid along one parameter, its name and its values, which must increase.

    **Raises:** `ValueError` for several parameters, a coordinate of the start, or values that do not increase.
    """
    need = "name one parameter with increasing values"
    require(isinstance(path, Mapping) and len(path) == 1, "path", need, path)
    grid = Grid(scene, path)
    name, values = next(iter(grid.axes.items()))
    increase = name not in STARTS and not np.any(np.diff(values) <= 0)
    require(increase, "path", need, path)
    return grid, name, values


def sample_box(
    box: Mapping[str, object],
    count: int,
    *,
    log: Sequence[str] = (),
    seed: int = 0,
    scene: Scene | None = None,
) -> dict[str, np.ndarray]:
    """Return Sobol points of parameters, spread over a box or by distributions, as a grid for `product=False`.

    ```python
    grid = sj.sweeps.sample_box({"speed": (500.0, 2000.0), "clearance": (0.3e-3, 3e-3)}, 4096, log=["clearance"])
    grid = sj.sweeps.sample_box({"speed": (500.0, 2000.0), "clearance": scipy.stats.norm(1e-3, 5e-5)}, 4096)
    ds = sj.sweep(scene, grid, product=False)
    ```

    **Arguments:** `box`: for each name, as in a grid, the lowest and the highest value in SI units, or a distribution
    of `scipy.stats` with its parameters, independent of the others; `count`: number of points, best a power of two;
    `log`: names with two bounds that are spread evenly on a logarithmic scale; `seed`: of the points; `scene`: the
    scene for names that are paths, such as section.play.2; by default the paper's scene.

    **Returns:** lists of `count` values by name.

    **Raises:** `ValueError` that names the wrong argument, or a parameter for which such a value is not allowed.
    """
    from scipy.stats import qmc

    require(
        isinstance(box, Mapping) and box,
        "box",
        "name one or more parameters with their bounds",
        box,
    )
    count = whole("count", count, 1)
    scene = paper_scene() if scene is None else check_scene(scene)
    listed = isinstance(log, Collection) and not isinstance(log, str) and all(isinstance(name, str) for name in log)
    require(listed, "log", "be a list of parameters of `box`", log)
    for name in log:
        require(name in box, "log", "name parameters of `box`", name)
    refuse_impossible(f"{count} points", 8.0 * count * len(box), 1e-7 * count * len(box))
    engine = qmc.Sobol(len(box), rng=np.random.default_rng(whole("seed", seed, 0)))
    # Sobol points balance only in powers of two: draw a power of two, and use the first points
    points = engine.random(1 << max(count - 1, 1).bit_length())[:count]
    found = {}
    for (name, ends), share in zip(box.items(), points.T, strict=True):
        quantity = _parameter(scene, name)
        if hasattr(ends, "ppf"):
            values = _drawn(name, ends, share, name in log)
        else:
            values = _spread(quantity, name, ends, share, name in log)
        found[name] = np.asarray(quantity.check(values), float)
    return found


def _spread(quantity: Parameter, name: str, ends: object, share: np.ndarray, log: bool) -> np.ndarray:
    """Return the values of a parameter at shares from 0 to 1 of its range."""
    values = np.asarray(quantity.check(ends), float)
    pair = values.shape == (2,) and values[0] < values[1]
    require(pair, "box", f"have the lower and the higher bound of {name}, or its distribution", ends)
    low, high = map(float, values)
    require(
        not log or low > 0,
        "log",
        "name parameters above zero",
        shown=f"{name}, which begins at {low:g}",
    )
    return low * (high / low) ** share if log else low + (high - low) * share


def _drawn(name: str, distribution: object, share: np.ndarray, log: bool) -> np.ndarray:
    """Return the quantiles of a distribution, as values of a parameter, at these shares."""
    require(
        not log,
        "log",
        "name parameters with two bounds",
        shown=f"{name}, which has a distribution",
    )
    need = f"have a distribution of {name} with all its parameters"
    # the value at the share 0 may be infinite: use half the spacing of Sobol points
    share = np.maximum(share, 2.0**-31)
    try:
        values = np.asarray(distribution.ppf(share), float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"Argument `box` must {need}: {error}") from None
    require(bool(np.all(np.isfinite(values))), "box", need, shown="one without finite values")
    return values
