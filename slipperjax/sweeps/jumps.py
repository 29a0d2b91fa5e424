"""Attractors over a parameter: what each case settles to, where a followed motion jumps, and what shares a basin."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr

from .analysis.attractor import Attractors, classify
from .batch import filled, start_states
from .checks import one_of, whole
from .kinematics import Motion, table_2_start
from .labels import OUTPUTS
from .scene import Scene
from .simulate import check_start
from .sweep import DIRECTIONS, make_plan, path_cases, run_blocks

SCALES = np.array([1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1.0, 1.0, 10.0, 10.0, 10.0])
"""What counts as one: 1 mm, 10 mrad, 1 m/s, 10 rad/s, in the order of `labels.OUTPUTS`."""


def strobe_states(ds: xr.Dataset, last: int | None = None) -> np.ndarray:
    """States once per forcing period, (*cases, periods, 10), of the `last` periods of a sweep's result.

    **Arguments:** `ds`: of `sweep` or `follow` with record "sections" or "strobe".
    """
    if "strobe" in ds:
        states = ds["strobe"].values
    elif "period" in ds["y"].dims:
        states = np.stack([ds[name].values for name in OUTPUTS], axis=-1)
    else:
        raise ValueError("Argument `ds` must come from a sweep that recorded sections or strobe, but did not.")
    return states if last is None else states[..., -whole("last", last, 1) :, :]


def attractors(ds: xr.Dataset, last: int = 200, floor: float = 1e-5, **options: Any) -> Attractors:
    """What each case of a sweep settled to, from its `last` strobe states: see `slipperjax.analysis.attractor`.

    **Arguments:** `floor`: distances below it are zero, in scales of `SCALES`: by default 10 nm.
    """
    return classify(strobe_states(ds, last), scales=SCALES, floor=floor, **options)


def groups(ds: xr.Dataset, last: int = 20, tolerance: float = 0.05) -> np.ndarray:
    """Numbers the attractors that a grid of starts leads to: 0, 1, ... by falling size of their basins.

    Two cases share a group where mean and spread of their last strobe states agree within `tolerance` (scales
    `SCALES`). For periodic attractors, which this tells apart reliably; a chaotic one may fall into several groups.

    **Returns:** whole numbers of the shape of the grid; -1 for cases that are not finite.
    """
    states = strobe_states(ds, last) / SCALES
    marks = np.concatenate([states.mean(axis=-2), states.std(axis=-2)], axis=-1)
    flat = marks.reshape(-1, marks.shape[-1])
    found = np.full(len(flat), -1)
    centres: list[np.ndarray] = []
    for k, mark in enumerate(flat):
        if not np.all(np.isfinite(mark)):
            continue
        near = [np.max(np.abs(mark - c)) for c in centres]
        if near and min(near) < tolerance:
            found[k] = int(np.argmin(near))
        else:
            found[k] = len(centres)
            centres.append(mark)
    order = np.argsort([-np.sum(found == k) for k in range(len(centres))], kind="stable")
    rank = {int(old): new for new, old in enumerate(order)} | {-1: -1}
    return np.array([rank[int(k)] for k in found]).reshape(marks.shape[:-1])


def _distance(new: np.ndarray, mark: np.ndarray) -> np.ndarray:
    """How far two mean strobe states are apart [scales of `SCALES`]."""
    return np.max(np.abs(new - mark), axis=-1)


PATIENCE = 5
"""How often a motion that still moves is held once more at a parameter's value."""


class Jump(NamedTuple):
    """Where a followed motion left its branch."""

    before: float
    """The last value on the branch [the parameter's unit]."""
    after: float
    """The first value beyond it."""
    size: float
    """How far the mean strobe state moved [scales of `SCALES`]."""


def find_jump(
    scene: Scene,
    path: dict[str, Sequence[float]],
    *,
    direction: str = "up",
    within: float = 1.0,
    transient: int = 60,
    periods: int = 10,
    steps_per_period: int | None = None,
    start: Motion | None = None,
    threshold: float = 0.3,
) -> Jump | None:
    """Follows a motion along a parameter until it jumps, and bisects for where.

    Each case starts from the state in which the one before ended. A jump is a mean strobe state that moves by more
    than `threshold` (scales `SCALES`) between neighbours; then the step is halved from the last state on the branch,
    until it is no longer than `within` [the parameter's unit]. Near the end of a branch a motion leaves it slowly: it
    is held at each value until its mean strobe state moves by less than a tenth of `threshold` from one `transient`
    and `periods` to the next, at most `PATIENCE` times.

    **Arguments:** `path`: one parameter's name and its values in increasing order; others as for `follow`.

    **Returns:** the first `Jump` met, or None.
    """
    cases, name, values = path_cases(scene, path)
    way = DIRECTIONS[one_of("direction", direction, tuple(DIRECTIONS))]
    plan = make_plan(scene, cases, "strobe", transient, periods, steps_per_period, None, None)
    start = table_2_start() if start is None else check_start(start)
    epoch, lanes = 0, filled(1)

    def run(value, states):
        nonlocal epoch
        here = {name: jnp.full(len(lanes), value)}
        states, _, (strobe,) = run_blocks(scene, plan, here, states, lambda periods: None, epoch=epoch)
        epoch += plan.total
        return states, strobe[0].mean(axis=0) / SCALES

    def hold(value, states):
        states, mark = run(value, states)
        for _ in range(PATIENCE):
            earlier = mark
            states, mark = run(value, states)
            if _distance(mark, earlier) < threshold / 10:
                break
        return states, mark

    jumped = lambda new, mark: _distance(new, mark) > threshold
    ordered = values[::way]
    states = start_states(scene, {name: jnp.full(len(lanes), ordered[0])}, start)
    states, mark = hold(ordered[0], states)
    at = ordered[0]
    for target in ordered[1:]:
        while at != target:
            value = target
            after, new = hold(value, states)
            while jumped(new, mark) and abs(value - at) > within:
                middle = (at + value) / 2
                halfway, tried = hold(middle, states)
                if jumped(tried, mark):
                    value, after, new = middle, halfway, tried
                else:  # and what looked like a jump from further away may be none from here
                    at, states, mark = middle, halfway, tried
            if jumped(new, mark):
                return Jump(float(at), float(value), float(_distance(new, mark)))
            at, states, mark = value, after, new
    return None
