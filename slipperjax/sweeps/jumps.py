"""Where a followed motion jumps from its branch."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..flow import Status, Trajectory, first_of, initial_states
from ..model import COORDINATE_SCALES, Motion, Scene, State
from ..tools import number, one_of, positive
from .cases import Cases, filled, path_cases
from .executors import run_chunk
from .follow import DIRECTIONS
from .plan import OnProgress, make_plan

PATIENCE = 5
"""How often a motion that still moves is held once more at a parameter's value."""


class Jump(NamedTuple):
    """Where a followed motion left its branch, or why the search ended without a jump."""

    found: bool
    """Whether a jump was met."""
    before: float
    """The last value on the branch [the parameter's unit]."""
    after: float
    """The first value beyond it; the last value tried where no jump was found."""
    size: float
    """How far the mean strobe state moved, in multiples of `COORDINATE_SCALES`; NaN without a jump."""
    status: Status
    """`FINITE`, or what ended the search at `after`."""


class _Held(NamedTuple):
    """A motion held at a parameter's value."""

    state: State
    mark: np.ndarray
    """Its mean strobe state, in multiples of `COORDINATE_SCALES`."""
    status: Status


def _distance(new: _Held, old: _Held) -> float:
    return float(np.max(np.abs(new.mark - old.mark)))


def find_jump(
    scene: Scene,
    path: Mapping[str, Any],
    *,
    direction: str = "up",
    within: float = 1.0,
    transient: int = 60,
    periods: int = 10,
    steps_per_period: int | None = None,
    start: Motion | State | Trajectory | None = None,
    threshold: float = 0.3,
    on_progress: OnProgress = lambda periods: None,
) -> Jump:
    """Follows a motion along a parameter until it jumps, and bisects for where.

    Each case starts from the state in which the one before ended. A jump is a mean strobe state that moves by more
    than `threshold` (in multiples of `slipperjax.model.COORDINATE_SCALES`) between neighbours; then the step is
    halved from the last state on the branch, until it is no longer than `within` [the parameter's unit]. Near the end
    of a branch a motion leaves it slowly: it is held at each value until its mean strobe state moves by less than a
    tenth of `threshold` from one `transient` and `periods` to the next, at most `PATIENCE` times.

    **Arguments:** `path`: one parameter's name and its values in increasing order; `on_progress`: called with the
    number of forcing periods after each call, and with 0 before it; what it raises ends the search; others as for
    `follow`.

    **Returns:** the first `Jump` met, or one with `found` False. The search ends at a value whose motion gets a
    status other than `FINITE`, because nothing can be followed from there.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    start = first_of(start)
    _, name, values = path_cases(scene, path, start)
    way = DIRECTIONS[one_of("direction", direction, tuple(DIRECTIONS))]
    within, threshold = number(positive, "within", within), number(positive, "threshold", threshold)
    options: dict[str, Any] = dict(record="strobe", transient=transient, periods=periods)
    lanes, epoch = filled(np.zeros(1, int), 1), 0

    def run(value: float, state: State | None) -> _Held:
        nonlocal epoch
        cases = Cases(scene, {name: [value]}, start)
        plan = make_plan(scene, cases, steps_per_period=steps_per_period, **options)
        scenes, starts = cases.take(lanes)
        state = initial_states(scenes, starts) if state is None else state
        done = run_chunk(plan, scenes, state, plan.most_steps, on_progress, epoch=epoch)
        epoch += plan.periods
        mark = done.record.strobe[0].mean(axis=0) / COORDINATE_SCALES
        return _Held(done.state, mark, Status(int(done.status[0])))

    def hold(value: float, state: State | None) -> _Held:
        held = run(value, state)
        for _ in range(PATIENCE):
            if held.status != Status.FINITE:
                break  # nothing can be followed from there
            earlier, held = held, run(value, held.state)
            if _distance(held, earlier) < threshold / 10:
                break
        return held

    jumped = lambda new, old: _distance(new, old) > threshold
    ordered = values[::way]
    at, on_branch = float(ordered[0]), hold(float(ordered[0]), None)
    if on_branch.status != Status.FINITE:
        return Jump(False, at, at, float("nan"), on_branch.status)
    for target in map(float, ordered[1:]):
        while at != target:
            value, new = target, hold(target, on_branch.state)
            while new.status == Status.FINITE and jumped(new, on_branch) and abs(value - at) > within:
                middle = (at + value) / 2
                halfway = hold(middle, on_branch.state)
                if halfway.status != Status.FINITE or jumped(halfway, on_branch):
                    value, new = middle, halfway
                else:  # and what looked like a jump from further away may be none from here
                    at, on_branch = middle, halfway
            if new.status != Status.FINITE:
                return Jump(False, at, value, float("nan"), new.status)
            if jumped(new, on_branch):
                return Jump(True, at, value, _distance(new, on_branch), Status.FINITE)
            at, on_branch = value, new
    return Jump(False, at, at, float("nan"), Status.FINITE)
