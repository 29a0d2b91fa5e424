"""Branches of periodic motions: followed through folds, with their events named and located, and switched at them."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..tools.checks import instance, require, shown_number, whole
from .curves import Pace, Spot, Walk, bounds_of_unknowns, check_within, checked_bounds, correct, evaluated, passes
from .events import Event, EventSearch, Node, Observe, as_node
from .floquet import product
from .shooting import PeriodicMotions

BRANCH_START_ITERATIONS = 30
"""Newton iterations for the first point of a branch."""
SEPARATION = 0.1
"""Least distance of a doubled motion's halves, over that from the flip; at a flip twice the latter."""


class End(NamedTuple):
    """One end of a branch."""

    reason: str
    """Why it ends there: "bound", "no convergence", "closed", "count", "event" or "interrupted"; empty for a start
    from which it was not followed."""
    step: float
    """The step that would be tried next."""


UNFINISHED = ("count", "event", "interrupted")
"""Reasons for which a branch can be followed further."""


@dataclasses.dataclass(frozen=True)
class Branch:
    """Periodic motions along a curve, with the events on it."""

    equations: PeriodicMotions
    nodes: tuple[Node, ...]
    """The points in their order along the branch, events included."""
    events: tuple[Event, ...]
    """In the same order."""
    ends: tuple[End, End]
    """Its first and its last point."""

    @property
    def values(self) -> np.ndarray:
        """The parameter, of shape (points,)."""
        return np.array([node.spot.z[-1] for node in self.nodes])

    @property
    def stable(self) -> np.ndarray:
        """True where no multiplier lies outside the unit circle, neutral ones left out, of shape (points,)."""
        return np.array([node.outside == 0 for node in self.nodes])

    @property
    def ended(self) -> tuple[str, str]:
        """The reasons why the branch ends at its first and its last point, see `End`."""
        return self.ends[0].reason, self.ends[1].reason

    def turned(self) -> "Branch":
        """Gives the branch the other way round."""
        turn = lambda node: node._replace(spot=node.spot._replace(tangent=-node.spot.tangent))
        events = (e._replace(node=turn(e.node), change=tuple(-c for c in e.change)) for e in reversed(self.events))
        nodes, (first, last) = map(turn, reversed(self.nodes)), self.ends
        return Branch(self.equations, tuple(nodes), tuple(events), (last, first))

    def __repr__(self) -> str:
        labels = ", ".join(f"{e.label} at {shown_number(e.node.spot.z[-1])}" for e in self.events)
        return f"Branch({len(self.nodes)} points; {labels})"


def continue_motion(
    equations: PeriodicMotions,
    start: Spot | tuple[Any, Any],
    bounds: tuple[float, float],
    *,
    ways: Sequence[int] = (1, -1),
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    **options: Any,
) -> Branch:
    """Follows periodic motions through a parameter, past folds, and names and locates events on the way.

    **Arguments:**

    - `equations`: of one parameter.
    - `start`: a state near a motion and the parameter's value there, or a point such as `switch` gives.
    - `bounds`: of the parameter. `ways`: 1 begins towards larger values or along the tangent of `start`, -1 the other
        way round.
    - `tolerance`: greatest weighted residual. `pace`: of the steps.
    - `options`: `observe`, `points`, `until` and `on_point` of `extend_motion`.

    **Returns:** a `Branch`; after Ctrl-C its part until then.

    **Raises:** `ValueError` where there is no motion near the start, or the bounds do not hold it.
    """
    instance("equations", equations, PeriodicMotions, "slipperjax.analysis.PeriodicMotions")
    pair = isinstance(start, Spot | tuple | list) and len(start) >= 2
    require(pair, "start", "be a state and the parameter's value there, or a point of a branch", start)
    check_within("start", start.z[-1] if isinstance(start, Spot) else start[1], checked_bounds(bounds))
    if not isinstance(start, Spot):
        z = equations.unknowns(*start)
        row = np.append(np.zeros(z.size - 1), 1.0)
        start = correct(equations, z, row, tolerance=tolerance, iterations=BRANCH_START_ITERATIONS)
    if not start.residual <= tolerance:
        raise ValueError(
            f"Argument `start` must be near a periodic motion, but Newton's method ended with a residual of "
            f"{shown_number(start.residual)}."
        )
    back, ahead = (End("count" if way in ways else "", pace.first) for way in (-1, 1))
    begin = Branch(equations, (as_node(start, options.get("observe")),), (), (back, ahead))
    return extend_motion(begin, bounds, tolerance=tolerance, pace=pace, **options)


def extend_motion(
    branch: Branch,
    bounds: tuple[float, float],
    *,
    observe: Observe | None = None,
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    points: int = 400,
    until: Sequence[str] = (),
    on_point: Callable[[Node], Any] | None = None,
) -> Branch:
    """Follows a branch further, from ends where it was not finished, and from those on bounds that are wider now.

    **Arguments:** as for `continue_motion`, and

    - `observe`: makes an `Observation` of a point; where its counts change, there is a grazing.
    - `points`: most points of each way. `until`: labels of events after which a way is not followed further.
    - `on_point`: is called with each point, for progress.
    """
    instance("branch", branch, Branch, "a slipperjax.analysis.Branch")
    most, (low, high) = whole("points", points, 1), bounds_of_unknowns(branch.equations.size, bounds)
    interrupted = False
    # ahead from the last point, then turned around and ahead once more
    for _ in range(2):
        end, last = branch.ends[1], branch.nodes[-1].spot
        wider = end.reason == "bound" and low[-1] < last.z[-1] < high[-1]
        if not interrupted and (wider or end.reason in UNFINISHED):
            walk = Walk(branch.equations, last, low, high, pace, tolerance, step=end.step)
            branch = _extended(branch, walk, observe, most, until, on_point)
            interrupted = branch.ends[1].reason == "interrupted"
        branch = branch.turned()
    return branch


def _extended(
    branch: Branch, walk: Walk, observe: Observe | None, most: int, until: Sequence[str], on_point: Callable | None
) -> Branch:
    """Gives a branch with up to `most` further points at its end, and the events among them."""
    nodes, events = list(branch.nodes), list(branch.events)
    if branch.ends[1].reason == "bound":  # which is wider now: the last point is no end point any more
        nodes[-1] = nodes[-1]._replace(label="")
        events = [event for event in events if not (event.label == "EP" and event.low == walk.spot.z[-1])]
    limit, search = len(nodes) + most, EventSearch(walk.equations, observe, walk.tolerance)

    def add(spot: Spot) -> str:
        last, new = nodes[-1], as_node(spot, observe)
        between = search.between(last, new)
        events.extend(between)
        nodes.extend(event.node for event in between)
        # the first points are near the start without a return to it
        closed = len(nodes) > 3 and passes(nodes[0].spot, last.spot, spot)
        if not closed:
            nodes.append(new)
        if on_point is not None:
            on_point(new)
        if closed:
            return "closed"
        if any(event.label in until for event in between):
            return "event"
        return "count" if len(nodes) >= limit and not walk.ended else ""

    reason, back = walk.follow(most, add), branch.ends[0]
    if reason in ("bound", "no convergence"):
        label, value = "EP" if reason == "bound" else "MX", float(nodes[-1].spot.z[-1])
        nodes[-1] = nodes[-1]._replace(label=label)
        events.append(Event(label, nodes[-1], value, value, complex(np.nan), label == "EP", ""))
    if reason == "closed":
        back = back._replace(reason="")
    return Branch(branch.equations, tuple(nodes), tuple(events), (back, End(reason, walk.step)))


def switch(branch: Branch, event: Event, *, length: float = 0.05, tolerance: float = 1e-10) -> tuple[Any, Spot]:
    """Finds the equations and first point of the branch that leaves at a flip or a branch point.

    **Arguments:** `length`: distance of the first point from the event, in the branch's weighted length. It is halved
    until Newton's method finds a point that is not on `branch`.

    **Returns:** what `continue_motion` takes, with `ways=(1,)`.

    **Raises:** `ValueError` for other events, or where no point is found.
    """
    instance("branch", branch, Branch, "a slipperjax.analysis.Branch")
    instance("event", event, Event, "one of the branch's events")
    if event.label not in ("PD", "BP"):
        raise ValueError(f"Argument `event` must be a flip (PD) or a branch point (BP), but is {event.label}.")
    equations, spot = branch.equations, event.node.spot
    if event.label == "PD":
        equations = dataclasses.replace(equations, intervals=2 * equations.intervals)
        values, vectors = np.linalg.eig(product(np.asarray(spot.matrices)))
        direction = np.append(vectors[:, np.argmin(np.abs(values + 1))].real, 0.0)
    else:
        direction = _across(equations, spot)
    direction = direction / np.linalg.norm(spot.weights * direction)
    while length > 1e-6:
        guess = spot.z + length * direction
        new = correct(equations, guess, spot.weights**2 * direction, spot.z, tolerance=tolerance)
        if new.residual <= tolerance and np.linalg.norm(new.weights * (new.z - guess)) < 2 * length:
            # a motion that still recurs after half the intervals is one of the old branch
            missed = evaluated(branch.equations, new.z).residual
            if event.label == "BP" or np.linalg.norm(new.weights[: missed.size] * missed) > SEPARATION * length:
                return equations, new
        length /= 2
    raise ValueError(f"Argument `event` must have a branch that leaves it, but none was found at {event.label}.")


def _across(equations: PeriodicMotions, spot: Spot) -> np.ndarray:
    """Gives the direction of solutions at right angles to the tangent, in weighted components."""
    rows, columns = (np.where(w > 0, w, 1.0) for w in map(np.asarray, equations.weights(jnp.asarray(spot.z))))
    scaled = rows[:, None] * evaluated(equations, spot.z).jacobian / columns
    tangent = columns * spot.tangent
    # of two null vectors of the Jacobian one at least is not along the tangent
    for direction in np.linalg.svd(scaled)[2][-2:]:
        across = direction - tangent * (tangent @ direction) / (tangent @ tangent)
        if np.linalg.norm(across) > 0.5:
            break
    return across / columns
