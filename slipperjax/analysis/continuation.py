"""Branches of periodic motions: followed through folds, with their events named and located, and switched at them."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..tools.checks import shown_number, whole
from .curves import Pace, Spot, Walk, check_within, checked_bounds, correct, evaluated, passes
from .events import Event, Node, Observe, as_node, events_between
from .shooting import PeriodicMotions

FIRST = 30
"""Newton iterations for the first point of a branch."""
DOUBLED = 0.1
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
        """Whether all multipliers lie inside the unit circle, of shape (points,)."""
        return np.array([node.outside == 0 for node in self.nodes])

    @property
    def ended(self) -> tuple[str, str]:
        """Why the branch ends at its first and its last point, see `End`."""
        return self.ends[0].reason, self.ends[1].reason

    def __repr__(self) -> str:
        labels = ", ".join(f"{e.label} at {shown_number(e.node.spot.z[-1])}" for e in self.events)
        return f"Branch({len(self.nodes)} points; {labels})"


def continue_motion(
    equations: PeriodicMotions,
    start: Spot | tuple[Any, Any],
    bounds: tuple[float, float],
    *,
    ways: Sequence[int] = (1, -1),
    observe: Observe | None = None,
    tolerance: float = 1e-10,
    pace: Pace | None = None,
    points: int = 400,
    until: Sequence[str] = (),
    on_point: Callable[[Node], Any] | None = None,
) -> Branch:
    """Follows periodic motions through a parameter, past folds, and names what happens on the way.

    **Arguments:**

    - `equations`: of one parameter.
    - `start`: a state near a motion and the parameter's value there, or a point such as `switch` gives.
    - `bounds`: of the parameter. `ways`: 1 begins towards larger values or along the tangent of `start`, -1 the other
        way round.
    - `observe`: makes an `Observation` of a point; where its counts change, there is a grazing.
    - `tolerance`: greatest weighted residual. `pace`: of the steps. `points`: most points of each way.
    - `until`: labels of events after which a way is not followed further.
    - `on_point`: is called with each point, for progress.

    **Returns:** a `Branch`; after Ctrl-C what was found until then.

    **Raises:** `ValueError` where there is no motion near the start, or the bounds do not hold it.
    """
    bounds, pace = checked_bounds(bounds), Pace() if pace is None else pace
    check_within("start", start.z[-1] if isinstance(start, Spot) else start[1], bounds)
    first = start if isinstance(start, Spot) else first_spot(equations, *start, tolerance=tolerance)
    if not first.residual <= tolerance:
        raise ValueError(
            f"Argument `start` must be near a periodic motion, but Newton's method ended with a residual of "
            f"{shown_number(first.residual)}."
        )
    back, ahead = (End("count" if way in ways else "", pace.first) for way in (-1, 1))
    begin = Branch(equations, (as_node(first, observe),), (), (back, ahead))
    options: dict[str, Any] = dict(observe=observe, tolerance=tolerance, pace=pace, points=points)
    options |= dict(until=until, on_point=on_point)
    return extend_motion(begin, bounds, **options)


def extend_motion(
    branch: Branch,
    bounds: tuple[float, float],
    *,
    observe: Observe | None = None,
    tolerance: float = 1e-10,
    pace: Pace | None = None,
    points: int = 400,
    until: Sequence[str] = (),
    on_point: Callable[[Node], Any] | None = None,
) -> Branch:
    """Follows a branch further, from ends where it was not finished, and from those on bounds that are wider now.

    **Arguments:** as for `continue_motion`.
    """
    pace, most = Pace() if pace is None else pace, whole("points", points, 1)
    low, high = (np.full(branch.equations.size + 1, side * np.inf) for side in (-1, 1))
    low[-1], high[-1] = checked_bounds(bounds)
    nodes, events, ends = list(branch.nodes), list(branch.events), list(branch.ends)
    # ahead, then turned around and ahead once more
    for way in (1, 0):
        value = float(nodes[-1].spot.z[-1])
        wider = ends[way].reason == "bound" and bounds[0] < value < bounds[1]
        if wider or ends[way].reason in UNFINISHED:
            if wider:
                nodes[-1] = nodes[-1]._replace(label="")
                events = [event for event in events if not (event.label == "EP" and event.low == value)]
            walk = Walk(branch.equations, nodes[-1].spot, low, high, pace, tolerance, step=ends[way].step)
            path = _walked(walk, nodes, observe, most, until, on_point)
            if path.events and not path.nodes:  # it ends where it begins
                nodes[-1] = path.events[-1].node
            nodes, events, ends[way] = [*nodes, *path.nodes], [*events, *path.events], End(path.ended, walk.step)
            if path.ended in ("closed", "interrupted"):
                if path.ended == "closed":
                    ends[1 - way] = ends[1 - way]._replace(reason="")
                if way == 0:
                    nodes, events = _turned(nodes, events)
                break
        nodes, events = _turned(nodes, events)
    return Branch(branch.equations, tuple(nodes), tuple(events), (ends[0], ends[1]))


class _Path(NamedTuple):
    """What was found from the end of a branch on."""

    nodes: list[Node]
    events: list[Event]
    ended: str


def _turned(nodes: list[Node], events: list[Event]) -> tuple[list[Node], list[Event]]:
    turn = lambda node: node._replace(spot=node.spot._replace(tangent=-node.spot.tangent))
    back = [e._replace(node=turn(e.node), change=tuple(-c for c in e.change)) for e in reversed(events)]
    return [turn(node) for node in reversed(nodes)], back


def _walked(
    walk: Walk,
    behind: Sequence[Node],
    observe: Observe | None,
    most: int,
    until: Sequence[str],
    on_point: Callable | None,
) -> _Path:
    start, node, path = behind[0], behind[-1], _Path([], [], "")
    try:
        while len(path.nodes) < most:
            spot = walk.advance()
            if spot is None:
                break
            new = as_node(spot, observe)
            events = events_between(node, new, walk.equations, observe, walk.tolerance)
            for event in events:
                path.events.append(event)
                path.nodes.append(event.node)
            closed = len(path.nodes) + len(behind) > 3 and passes(start.spot, node.spot, spot)
            if not closed:
                path.nodes.append(new)
            if on_point is not None:
                on_point(new)
            if closed:
                return path._replace(ended="closed")
            if any(event.label in until for event in events):
                return path._replace(ended="event")
            node = new
    except KeyboardInterrupt:
        return path._replace(ended="interrupted")
    label = {"bound": "EP", "no convergence": "MX"}.get(walk.ended, "")
    if label:
        node = node._replace(label=label)
        value = float(node.spot.z[-1])
        path.events.append(Event(label, node, value, value, complex(np.nan), label == "EP", ""))
        if path.nodes:
            path.nodes[-1] = node
    return path._replace(ended=walk.ended or "count")


def first_spot(equations: PeriodicMotions, state: Any, value: Any, *, tolerance: float = 1e-10) -> Spot:
    """The motion at a parameter's value, from a state near it, by Newton's method; look at its `residual`."""
    z = equations.place(state, value)
    row = jnp.zeros(z.size).at[-1].set(1.0)
    return jax.device_get(correct(equations, z, row, tolerance=tolerance, iterations=FIRST))


def switch(branch: Branch, event: Event, *, length: float = 0.05, tolerance: float = 1e-10) -> tuple[Any, Spot]:
    """The equations and first point of the branch that leaves at a flip or a branch point.

    **Arguments:** `length`: distance of the first point from the event, in the branch's weighted length. It is halved
    until Newton's method finds a point that is not on `branch`.

    **Returns:** what `continue_motion` takes, with `ways=(1,)`.

    **Raises:** `ValueError` for other events, or where no point is found.
    """
    if event.label not in ("PD", "BP"):
        raise ValueError(f"Argument `event` must be a flip (PD) or a branch point (BP), but is {event.label}.")
    equations, spot = branch.equations, event.node.spot
    if event.label == "PD":
        equations = dataclasses.replace(equations, intervals=2 * equations.intervals)
        direction = np.append(_eigenvector(np.asarray(spot.extra), -1.0), 0.0)
    else:
        direction = _across(equations, spot)
    direction = direction / np.linalg.norm(spot.weights * direction)
    while length > 1e-6:
        guess = spot.z + length * direction
        found = jax.device_get(correct(equations, guess, spot.weights**2 * direction, spot.z, tolerance=tolerance))
        strayed = np.linalg.norm(found.weights * (found.z - guess))
        left = event.label == "BP" or _missed(branch.equations, found) > DOUBLED * length
        if found.residual <= tolerance and strayed < 2 * length and left:
            return equations, found
        length /= 2
    raise ValueError(f"Argument `event` must have a branch that leaves it, but none was found at {event.label}.")


def _missed(equations: PeriodicMotions, spot: Spot) -> float:
    """Weighted length of what a point misses of recurring by `equations`."""
    missed = evaluated(equations, spot.z).residual
    return float(np.linalg.norm(spot.weights[: missed.size] * missed))


def _eigenvector(matrices: np.ndarray, multiplier: float) -> np.ndarray:
    values, vectors = np.linalg.eig(functools.reduce(lambda total, matrix: matrix @ total, matrices))
    return vectors[:, np.argmin(np.abs(values - multiplier))].real


def _across(equations: PeriodicMotions, spot: Spot) -> np.ndarray:
    """The direction of solutions that is at right angles to the tangent, in weighted components."""
    rows, columns = (np.where(w > 0, w, 1.0) for w in map(np.asarray, equations.weights(jnp.asarray(spot.z))))
    scaled = rows[:, None] * evaluated(equations, spot.z).jacobian / columns
    tangent = columns * spot.tangent
    for direction in np.linalg.svd(scaled)[2][-2:]:
        across = direction - tangent * (tangent @ direction) / (tangent @ tangent)
        if np.linalg.norm(across) > 0.5:
            break
    return across / columns
