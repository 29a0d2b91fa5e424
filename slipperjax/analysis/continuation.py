"""Branches of periodic motions, followed through folds: located events, and changes to other branches."""

import contextlib
import dataclasses
import inspect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from ..tools.checks import instance, require, shown_number, whole
from .arclength import Node, Pace, Walk, check_within, checked_bounds, correct, evaluated, passes
from .ends import end_without_convergence
from .events import Event, EventSearch, Observe, observed
from .floquet import eigenvector
from .newton import AbstractEquations
from .shooting import PeriodicMotions


class End(NamedTuple):
    """One end of a branch."""

    reason: str
    """Reason for the end: "bound", "no convergence", "closed", "count", "event", "interrupted" or "strong resonance
    1:1", for example; empty for a start from which the branch was not followed."""
    step: float
    """Length of the step that would be tried next."""


@dataclasses.dataclass(frozen=True)
class Branch:
    """Periodic motions along a curve, with the events on it."""

    equations: AbstractEquations
    nodes: tuple[Node, ...]
    """Points in their order along the branch, including events."""
    events: tuple[Event, ...]
    """Events in the same order."""
    ends: tuple[End, End]
    """Ends at the first and the last point."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: of the arguments of `family`."""
        return tuple(parameter_places(self.equations, self.nodes[0].z.size))

    @property
    def parameters(self) -> np.ndarray:
        """Values of the parameters, of shape (points, parameters), in the order of `names`."""
        points = np.array([node.z for node in self.nodes])
        return points[:, list(parameter_places(self.equations, points.shape[1]).values())]

    @property
    def values(self) -> np.ndarray:
        """Values of the last parameter, of shape (points,); see `parameters` for a curve over two parameters."""
        return self.parameters[:, -1]

    @property
    def stable(self) -> np.ndarray:
        """Whether no multiplier is outside the unit circle, see `Node.outside`, of shape (points,)."""
        return np.array([node.outside == 0 for node in self.nodes])

    @property
    def ended(self) -> tuple[str, str]:
        """Reasons why the branch ends at its first and its last point, see `End`."""
        return self.ends[0].reason, self.ends[1].reason

    def turned(self) -> "Branch":
        """Return the branch in the opposite direction."""
        turn = lambda node: node._replace(tangent=-node.tangent)
        events = []
        for event in reversed(self.events):
            events.append(event._replace(node=turn(event.node), change=tuple(-c for c in event.change)))
        nodes = map(turn, reversed(self.nodes))
        return Branch(self.equations, tuple(nodes), tuple(events), self.ends[::-1])

    def __repr__(self) -> str:
        places = parameter_places(self.equations, self.nodes[0].z.size)
        if len(places) == 1:
            why = lambda e: f" ({e.note})" if e.label == "MX" and e.note else ""
            labels = ", ".join(f"{e.label} at {shown_number(e.value)}{why(e)}" for e in self.events)
            return f"Branch({len(self.nodes)} points; {labels})"
        of = lambda z: ", ".join(f"{name} = {shown_number(z[k])}" for name, k in places.items())
        labels = "; ".join(f"{e.label} at {of(e.node.z)}" for e in self.events)
        return f"Branch({len(self.nodes)} points over {' and '.join(places)}; {labels})"


def parameter_places(equations: AbstractEquations, unknowns: int) -> dict[str, int]:
    """Return the place of each parameter among the unknowns, by its name: of the `names` of the family of motions, or
    of its arguments."""
    motions = getattr(equations, "motions", equations)
    if not isinstance(motions, PeriodicMotions):
        return {"parameter": unknowns - 1}
    count = int(np.size(motions.reach))
    names = getattr(motions.family, "names", [f"parameter {k + 1}" for k in range(count)])
    with contextlib.suppress(ValueError, TypeError):
        given = inspect.signature(motions.family).parameters.values()
        own = [one.name for one in given if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)]
        names = own[:count] if len(own) >= count else names
    return {name: motions.size + k for k, name in enumerate(names)}


def continue_motion(
    equations: PeriodicMotions,
    start: Node | tuple[PyTree, float],
    bounds: tuple[float, float],
    *,
    ways: Sequence[int] = (1, -1),
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    observe: Observe | None = None,
    **options: object,
) -> Branch:
    """Follow periodic motions over a parameter, past folds; locate and label the events along the branch.

    **Arguments:**

    - `equations`: of one parameter.
    - `start`: a state near a motion and the parameter's value there; or a point, such as `switch` returns.
    - `bounds`: of the parameter. `ways`: 1 begins towards larger values, or along the tangent of a point; -1 in the
        opposite direction.
    - `tolerance`: greatest weighted residual. `pace`: of the steps.
    - `observe`: makes an `Observation` of a point; a change of its counts is a grazing. Without `observe`, branches
        of `impact_step` and `switched_step` that end at a grazing say so; they continue where an impact falls on the
        strobe ("ST").
    - `options`: `points`, `until` and `on_point` of `extend`.

    **Returns:** a `Branch`; after Ctrl-C the part followed so far.

    **Raises:** `ValueError` where there is no motion near the start, or where the bounds do not contain it.
    """
    instance("equations", equations, PeriodicMotions, "slipperjax.analysis.PeriodicMotions")
    pair = isinstance(start, tuple | list) and len(start) >= 2
    require(pair, "start", "be a state and the parameter's value there, or a point of a branch", start)
    check_within("start", start.z[-1] if isinstance(start, Node) else start[1], checked_bounds(bounds))
    if not isinstance(start, Node):
        z = equations.unknowns(*start)
        row = np.append(np.zeros(z.size - 1), 1.0)
        start = correct(equations, z, row, tolerance=tolerance, iterations=30)
    check_found("start", "a periodic motion", start, tolerance)
    return followed(equations, start, bounds, ways=ways, tolerance=tolerance, pace=pace, observe=observe, **options)


def check_found(name: str, sought: str, point: Node, tolerance: float) -> None:
    """Raise `ValueError` where Newton's method has not converged."""
    ended = f"at a residual of {shown_number(point.residual)}, where Newton's method ended"
    require(point.residual <= tolerance, name, f"be near {sought}", shown=ended)


def followed(
    equations: AbstractEquations,
    start: Node,
    *bounds: tuple[float, float],
    ways: Sequence[int] = (1, -1),
    pace: Pace = Pace(),
    observe: Observe | None = None,
    **options: Any,
) -> Branch:
    """Return the branch through a point, followed in these `ways`; `bounds`, `options`: as for `extend`."""
    back, ahead = (End("count" if way in ways else "", pace.first) for way in (-1, 1))
    begin = Branch(equations, (observed(start, observe),), (), (back, ahead))
    return extend(begin, *bounds, pace=pace, observe=observe, **options)


def extend(
    branch: Branch,
    *bounds: tuple[float, float],
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    observe: Observe | None = None,
    search: type[EventSearch] = EventSearch,
    points: int = 400,
    until: Sequence[str] = (),
    on_point: Callable[[Node], object] | None = None,
) -> Branch:
    """Follow a branch further, from ends by count, event or interrupt, and from former bounds that are wider now.

    **Arguments:** as for `continue_motion`, and

    - `bounds`: of each unknown after the state. `search`: for events between two points.
    - `points`: most points in each direction. `until`: labels of events that end a direction.
    - `on_point`: called with each new point, to show progress.
    """
    instance("branch", branch, Branch, "a slipperjax.analysis.Branch")
    points = whole("points", points, 1)
    # the state's components have no bounds
    free = [(-np.inf, np.inf)] * (branch.nodes[0].z.size - len(bounds))
    low, high = np.transpose([*free, *map(checked_bounds, bounds)])
    finder = search(branch.equations, observe, tolerance)
    interrupted = False
    # extend the last end, turn the branch, extend the other end, and turn the branch back
    for _ in range(2):
        end = branch.ends[1]
        last = branch.nodes[-1]
        wider = end.reason == "bound" and np.all((low < last.z) & (last.z < high))
        if not interrupted and (wider or end.reason in ("count", "event", "interrupted")):
            walk = Walk(branch.equations, last, low, high, pace, tolerance, end.step, smooth=search.smooth)
            branch = _extended(branch, walk, finder, points, until, on_point)
            interrupted = branch.ends[1].reason == "interrupted"
        branch = branch.turned()
    return branch


def _extended(branch, walk, search, most, until, on_point):
    """Return a branch with up to `most` further points at its end, and the events among them."""
    nodes = list(branch.nodes)
    events = list(branch.events)
    if branch.ends[1].reason == "bound":  # the bound is wider now: its end point becomes an ordinary point
        nodes[-1] = nodes[-1]._replace(label="")
        events.pop()
    limit = len(nodes) + most
    reason = ""
    # the unknowns may end with an angle
    places = tuple(parameter_places(branch.equations, nodes[-1].z.size).values())
    begin = 0

    def passed(point: Node) -> str:
        """Add a point, and the events before it; return the reason why the branch ends here, if any."""
        last = nodes[-1]
        new = observed(point, search.observe)
        if why := search.ends(new):
            return why
        between = search.between(last, new)
        events.extend(between)
        nodes.extend(event.node for event in between)
        # the first points are near the start because the walk begins there
        closed = len(nodes) > 3 and passes(nodes[0], last, new)
        # the last point of a closed curve is beyond its start, and would repeat the first points
        if not closed:
            nodes.append(new)
        if on_point is not None:
            on_point(new)
        if closed:
            return "closed"
        if any(event.label in until for event in between):
            return "event"
        return "count" if len(nodes) >= limit and not walk.ended else ""

    try:
        while not reason:
            reason = next(filter(None, map(passed, walk)), "") or walk.ended
            if reason == "no convergence":
                event, beyond = end_without_convergence(walk, nodes[begin:], places)
                events.append(event)
                nodes[-1] = event.node
                if beyond is not None:
                    # the branch continues from the state on the other side of an impact
                    begin = len(nodes)
                    nodes.append(observed(beyond, search.observe))
                    walk = dataclasses.replace(walk, last=nodes[-1], step=walk.pace.first, ended="")
                    reason = "event" if event.label in until else ""
    except KeyboardInterrupt:
        reason = "interrupted"
    if reason == "bound":
        value = float(nodes[-1].z[places[-1]])
        nodes[-1] = nodes[-1]._replace(label="EP")
        events.append(Event("EP", nodes[-1], value, value, True, places=places))
    back = branch.ends[0]
    if reason == "closed":
        # a closed curve has no rest to follow from its start
        back = back._replace(reason="")
    return Branch(branch.equations, tuple(nodes), tuple(events), (back, End(reason, walk.step)))


def switch(
    branch: Branch,
    event: Event,
    *,
    length: float = 0.05,
    tolerance: float = 1e-10,
) -> tuple[AbstractEquations, Node]:
    """Return the equations and first point of the branch that leaves at a flip or a branch point.

    **Arguments:** `length`: weighted distance of the first point from the event. The length is halved until Newton's
    method finds a point that is not on `branch`.

    **Returns:** the first two arguments of `continue_motion`, which must be called with `ways=(1,)`.

    **Raises:** `ValueError` for other events, or where no point is found.
    """
    instance("branch", branch, Branch, "a slipperjax.analysis.Branch")
    instance("event", event, Event, "one of the branch's events")
    if event.label not in ("PD", "BP"):
        raise ValueError(f"Argument `event` must be a flip (PD) or a branch point (BP), but is {event.label}.")
    equations = branch.equations
    point = event.node
    if event.label == "PD":
        equations = dataclasses.replace(equations, intervals=2 * equations.intervals)
        # along the eigenvector of the multiplier -1
        direction = np.append(eigenvector(np.asarray(point.matrices), -1.0).real, 0.0)
    else:
        direction = _across(equations, point)
    direction = direction / point.length(direction)
    # closer and closer to the event until Newton's method finds the other branch
    while length > 1e-6:
        guess = point.z + length * direction
        new = correct(equations, guess, point.weights**2 * direction, point.z, tolerance=tolerance)
        if new.residual <= tolerance and new.length(new.z - guess) < 2 * length:
            # A motion of the doubled period whose halves agree belongs to the old branch. On the new branch the
            # halves differ by twice the distance from the flip.
            missed = evaluated(branch.equations, new.z).residual
            apart = np.linalg.norm(new.weights[: missed.size] * missed)
            if event.label == "BP" or apart > 0.1 * length:
                return equations, new
        length /= 2
    raise ValueError(f"Argument `event` must have a branch that leaves it, but none was found at {event.label}.")


def _across(equations: AbstractEquations, point: Node) -> np.ndarray:
    """Return the direction of the crossing branch: the Jacobian's null vector perpendicular to the tangent."""
    rows, columns = (np.asarray(weights) for weights in equations.weights(jnp.asarray(point.z)))
    # components of weight zero would vanish from the scaled Jacobian, so that they count with weight one
    rows = np.where(rows > 0, rows, 1.0)
    columns = np.where(columns > 0, columns, 1.0)
    scaled = rows[:, None] * evaluated(equations, point.z).jacobian / columns
    tangent = columns * point.tangent
    # at a branch point the Jacobian has two null vectors, at least one of which is not along the tangent
    for direction in np.linalg.svd(scaled)[2][-2:]:
        across = direction - tangent * (tangent @ direction) / (tangent @ tangent)
        if np.linalg.norm(across) > 0.5:
            break
    return across / columns
