"""Paths with memory: each case begins in the state in which its neighbour ended; and the places of jumps."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import diffrax
import numpy as np

from ..analysis.attractor import recurrence
from ..flow.record import AbstractOutput, RecordSet, Strobe
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import COORDINATE_SCALES
from ..model.scene import Scene, check_steady
from ..model.step_size import given_steps
from ..orbits.simulate import Trajectory, beginning_of, check_rail, first_of
from ..results.result import Result
from ..tools.checks import number, one_of, positive, require, whole
from .call import Call, make_plan
from .engine import PartRun, run_part, run_parts
from .exponents import LyapunovExponents
from .grid import Grid, filled, path_grid
from .plan import Part
from .records import resolved_record

DIRECTIONS = {"up": 1, "down": -1}
"""Order of the increasing values of a parameter, by the name of the direction."""


def follow(
    scene: Scene,
    path: Mapping[str, object],
    *,
    record: str | AbstractOutput | Sequence[str | AbstractOutput] = "sections",
    transient: int = 30,
    periods: int = 10,
    steps_per_period: int | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | str | None = None,
    begin: float | None = None,
    progress: bool | None = None,
) -> Result:
    """Sweep a parameter with memory: each case starts from the state in which its neighbour ended.

    In this way a motion is followed along its branch until the branch ends; a fixed start may lead to another
    attractor. "up" begins at the first value, "down" at the last; both run as one batch. Where they disagree,
    attractors coexist.

    **Arguments:**

    - `path`: name and values of one parameter, in increasing order.
    - `transient`, `periods`: forcing periods at each value, before recording and recorded.
    - `start`: start of each direction at its first value; `begin`: place of this start on the rail [m]; the values
        follow each other along the rail.
    - others: as for `sweep`. Up and down advance together, with the larger of both step counts.

    **Returns:** a `Result` as of `sweep`, with the dimension `direction` before the others.

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C.
    """
    call = Call(
        transient,
        periods,
        saves_per_period,
        begin,
        record=record,
        steps_per_period=steps_per_period,
        solver=solver,
        function="follow",
    )
    start = first_of(start)
    grid, _, values = path_grid(check_steady(scene), path)
    records, stages = resolved_record(call.record)
    runs_on = any(isinstance(one, LyapunovExponents) for one in stages)
    require(not runs_on, "record", "not run on where cases follow one another", call.record)
    plan = make_plan(grid, start, call, records, stages)
    # one value after the other, on one rail
    count = len(values)
    check_rail(scene, plan.periods * count, beginning_of(scene, call.begin))
    # of the two values that the directions visit at the same time, both get the larger number of steps
    plan = replace(plan, which=np.maximum(plan.which, plan.which[::-1]))
    # places in the list of all cases of the two cases at one time, "up" first: (values, directions)
    up = np.arange(count)
    met = np.stack([up, count + up[::-1]], axis=1)
    parts = []
    for at, k in zip(met, plan.which, strict=True):
        row = filled(at, len(at))
        parts.append(Part(plan, row % count, row, len(at), plan.schedules[k]))
    # states at the end of the previous part, and the number of parts so far
    states: State | None = None
    passed = 0

    def work(part: Part) -> PartRun:
        nonlocal states, passed
        run = run_part(part, part.states if states is None else states, passed * plan.periods)
        states = run.state
        passed += 1
        return run

    # one worker, because each part begins where the previous part ended
    run = run_parts(parts, 1, work, periods=plan.periods, progress=progress)
    first = {"direction": list(DIRECTIONS)}
    more = dict(values=count, steps_per_period=call.steps_per_period)
    return run.checked(lambda: Result(call.dataset(plan, run.results, first, **more)))


class Jump(NamedTuple):
    """Place where a followed motion left its branch, or the reason why the search ended without a jump."""

    found: bool
    """Whether a jump was found."""
    before: float
    """The last value on the branch [the parameter's unit]."""
    after: float
    """The first value beyond the jump; the last tried value where no jump was found."""
    size: float
    """Distance that the mean strobe state moved, in multiples of `COORDINATE_SCALES`; NaN without a jump."""
    status: Status
    """`FINITE`, or the status that ended the search at `after`."""
    recurs: bool = True
    """Whether the motion at `before` recurs within the periods of a hold. If it does not recur, it may be chaos that
    ends by escape; then the place of the jump depends on `transient`, `periods` and `most_holds`."""


class _HeldMotion(NamedTuple):
    """A motion held at a parameter's value."""

    state: State
    mark: np.ndarray  # its mean strobe state, in multiples of `COORDINATE_SCALES`
    status: Status
    wander: float  # least change of its strobe states over some periods, in multiples of `COORDINATE_SCALES`

    def distance(self, other: "_HeldMotion") -> float:
        """Return the distance of its mean strobe state from another motion's, in multiples of `COORDINATE_SCALES`."""
        return float(np.max(np.abs(self.mark - other.mark)))


def find_jump(
    scene: Scene,
    path: Mapping[str, object],
    *,
    direction: str = "up",
    within: float = 1.0,
    transient: int = 60,
    periods: int = 10,
    steps_per_period: int | None = None,
    start: Motion | State | Trajectory | str | None = None,
    begin: float | None = None,
    threshold: float = 0.3,
    most_holds: int = 5,
) -> Jump:
    """Follow a motion along a parameter until it jumps, and bisect for the place of the jump.

    Each value starts from the state in which the previous value ended. A motion jumps where its mean strobe state
    moves by more than `threshold` from one value to the next. Then the step is halved, always from the last state on
    the branch, until it is no longer than `within`.

    Near the end of a branch a motion leaves the branch slowly. Therefore it is held at each value: simulated for
    `transient` and `periods` again, until its mean strobe state moves by less than a tenth of `threshold`.

    **Arguments:** `path`: one parameter's name and its values in increasing order; `direction`: "up" or "down";
    `within`: longest last step [the parameter's unit]; `threshold`: in multiples of
    `slipperjax.model.COORDINATE_SCALES` [1]; `most_holds`: most repetitions at one value; others as for `follow`.

    **Returns:** the first `Jump`, or one with `found` False. For a jump out of chaos `recurs` is False, because its
    place depends on how long the motion is held. The search ends at a value where the motion has a status other than
    `FINITE`, because no motion can be followed from there.

    **Raises:** `ValueError` that names the wrong argument.
    """
    start = first_of(start)
    _, name, values = path_grid(scene, path)
    way = DIRECTIONS[one_of("direction", direction, tuple(DIRECTIONS))]
    within = number(positive, "within", within)
    threshold = number(positive, "threshold", threshold)
    most_holds = whole("most_holds", most_holds, 0)
    if steps_per_period is not None:
        steps_per_period = given_steps(steps_per_period)
    call = Call(transient, periods, begin=begin, steps_per_period=steps_per_period)
    lanes = filled(np.zeros(1, int), 1)
    epoch = 0

    def run(value: float, state: State | None) -> _HeldMotion:
        nonlocal epoch  # the rail continues from one value to the next
        plan = make_plan(Grid(scene, {name: [value]}), start, call, RecordSet((Strobe(),)))
        part = Part(plan, lanes, lanes, 1, plan.schedules[0])
        done = run_part(part, part.states if state is None else state, epoch)
        epoch += plan.periods
        strobe = done.record[0][0] / COORDINATE_SCALES
        # over the periods that the record contains twice, because the motion's own period is unknown
        changes = recurrence(strobe, len(strobe) // 2).values()
        wander = min((float(np.max(change)) for change in changes), default=np.inf)
        return _HeldMotion(done.state, strobe.mean(axis=0), Status(int(done.status[0])), wander)

    def hold(value: float, state: State | None) -> _HeldMotion:
        held = run(value, state)
        for _ in range(most_holds):
            if held.status != Status.FINITE:
                break  # no motion can be followed from there
            earlier = held
            held = run(value, held.state)
            if held.distance(earlier) < threshold / 10:
                break
        return held

    first, *others = map(float, values[::way])
    at = first
    on_branch = hold(first, None)
    if on_branch.status != Status.FINITE:
        return Jump(False, at, at, float("nan"), on_branch.status)
    # values still to visit, the next value last
    pending = others[::-1]
    # the last value that seemed to be beyond a jump, and the motion there
    beyond = first, on_branch
    while pending:
        value = pending.pop()
        # a bisection comes back to the value beyond the jump, whose motion is known
        new = beyond[1] if value == beyond[0] else hold(value, on_branch.state)
        if new.status != Status.FINITE:
            return Jump(False, at, value, float("nan"), new.status)
        size = new.distance(on_branch)
        if not size > threshold:  # a jump seen from far away may be no jump from here
            at = value
            on_branch = new
        elif abs(value - at) > within:
            pending += [value, (at + value) / 2]  # first the middle, then this value again
            beyond = value, new
        else:
            return Jump(True, at, value, size, Status.FINITE, on_branch.wander < threshold / 10)
    return Jump(False, at, at, float("nan"), Status.FINITE)
