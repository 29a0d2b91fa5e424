"""Points spread over a box of parameters, for sweeps whose lists are read side by side."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..model import STARTS, Scene, paper_scene, parameter
from ..tools import brief, one_of, whole

METHODS = ("sobol", "halton", "latin", "random")
"""Ways to spread points: low-discrepancy sequences, a Latin hypercube, or independent ones."""


def sample_box(
    box: Mapping[str, tuple[float, float]],
    count: int,
    *,
    method: str = "sobol",
    log: Sequence[str] = (),
    seed: int = 0,
    scene: Scene | None = None,
) -> dict[str, np.ndarray]:
    """Points spread over a box of parameters, from `scipy.stats.qmc`, for `sweep(..., product=False)`.

    ```python
    grid = sj.sample_box({"speed": (500.0, 2000.0), "clearance": (0.3e-3, 3e-3)}, 4096, log=["clearance"])
    ds = sj.sweep(scene, grid, product=False)
    ```

    **Arguments:** `box`: lowest and highest value by name, as in a grid, in SI units; `count`: of points, for "sobol"
    best a power of two; `method`: of `METHODS`; `log`: names whose logarithm is spread; `seed`: of the points;
    `scene`: where paths such as section.play.2 are names.

    **Returns:** lists of `count` values by name.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    from scipy.stats import qmc

    if not isinstance(box, Mapping) or not box:
        raise ValueError(f"Argument `box` must name one or more parameters with their bounds, but is {brief(box)}.")
    count, of = whole("count", count, 1), paper_scene() if scene is None else scene
    low, high = np.array([_bounds(of, name, ends) for name, ends in box.items()]).T
    rng, dimensions = np.random.default_rng(whole("seed", seed, 0)), len(box)
    method = one_of("method", method, METHODS)
    if method == "random":
        points = rng.random((count, dimensions))
    elif method == "sobol":
        # of a power of two, of which fewer are as well spread
        engine = qmc.Sobol(dimensions, rng=rng)
        points = engine.random_base2(max(count - 1, 1).bit_length())[:count]
    else:
        engine = (qmc.Halton if method == "halton" else qmc.LatinHypercube)(dimensions, rng=rng)
        points = engine.random(count)
    unknown = [name for name in log if name not in box]
    if unknown:
        raise ValueError(f"Argument `log` must name parameters of `box`, but has {unknown[0]!r}.")
    found = {}
    for name, a, b, share in zip(box, low, high, points.T, strict=True):
        if name in log and not a > 0:
            raise ValueError(f"Argument `log` must name parameters above zero, but {name} begins at {a:g}.")
        found[name] = a * (b / a) ** share if name in log else a + (b - a) * share
    return found


def _bounds(scene: Scene, name: str, ends: Any) -> tuple[float, float]:
    """Two values of a parameter, the lower first."""
    known = STARTS[name] if name in STARTS else parameter(name, scene)
    values = np.asarray(known.checked(ends), float)
    if values.shape != (2,) or not values[0] < values[1]:
        raise ValueError(f"Argument `box` must have the lower and the higher bound of {name}, but has {brief(ends)}.")
    return float(values[0]), float(values[1])
