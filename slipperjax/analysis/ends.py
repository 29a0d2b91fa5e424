"""Reasons why a branch ends without convergence: a grazing, an impact at the strobe, crossing branches."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..tools.compile import call_compiled
from .arclength import Node, Walk, correct
from .events import Event
from .hybrid import AbstractCrossingStep
from .newton import AbstractEquations
from .shooting import PeriodicMotions

NEAR = 100
"""Least number of steps, from the last point of a branch, within which the reason of its end lies. Where an impact is
so gentle that RK4 does not notice it, 40 steps were measured."""
FARTHER = 7
"""How often the step across an impact at the strobe is doubled, beginning with two least steps."""
BESIDE = 1e-3
"""Greatest distance from its guess of a point beyond an impact at the strobe."""


class _Touch(NamedTuple):
    """How near a motion is to a grazing of a surface, and to an impact at the strobe."""

    turn: np.ndarray
    """Least gap at which a flight turns, see `AbstractCrossingStep.nearness`."""
    touch: np.ndarray
    """Least rate of a touch; with a smaller rate the flight would turn before the touch."""
    gap: np.ndarray
    """Gap at the strobe; NaN where the state does not jump."""
    rate: np.ndarray
    """Rate of the gap at the strobe."""
    beyond: np.ndarray
    """State at the strobe on the other side of an impact there."""


def _touch(equations: PeriodicMotions, static: tuple, z: jax.Array) -> _Touch:
    step, state = equations.step(z), equations.state(z)
    assert isinstance(step, AbstractCrossingStep)
    ks = jnp.arange(float(equations.intervals))
    turn, touch = jax.lax.scan(lambda s, k: (step(s, k), step.nearness(s, k)), state, ks)[1]
    return _Touch(jnp.min(turn), jnp.min(touch), *step.other_side(state, equations.intervals))


def _touch_of(equations: AbstractEquations, node: Node) -> _Touch | None:
    """Return the `_Touch` of a point; None for maps without a surface."""
    if not isinstance(equations, PeriodicMotions) or not isinstance(equations.step(node.z), AbstractCrossingStep):
        return None
    return jax.device_get(call_compiled(_touch, equations, (), jnp.asarray(node.z)))


def end_without_convergence(walk: Walk, nodes: Sequence[Node], places: tuple[int, ...]) -> tuple[Event, Node | None]:
    """Return the event at the last of some points, after which no step converges. Also return the first point beyond
    the event from which the branch continues, if any.

    **Arguments:** `places`: of the parameters among the unknowns.
    """
    last = nodes[-1]
    place = places[-1]
    value = float(last.z[place])

    def found(label: str, note: str, other: float = value, known: bool = False) -> Event:
        bounds = min(value, other), max(value, other)
        return Event(label, last._replace(label=label), *bounds, known, note=note, places=places)

    touch = lambda node: _touch_of(walk.equations, node)
    if len(nodes) > 1 and (before := touch(nodes[-2])) and (now := touch(last)):
        chord = last.z - nodes[-2].z

        def share(name: str) -> float:
            """How far beyond the last point a number is zero [chords]; NaN where the zero is not near."""
            one, other = float(getattr(before, name)), float(getattr(now, name))
            ahead = other / (one - other) if np.isfinite(one - other) and one != other else np.nan
            return ahead if abs(ahead) * last.length(chord) <= NEAR * walk.pace.least else np.nan

        for name in ("turn", "touch"):
            if np.isfinite(ahead := share(name)):
                note = "the branch ends where the motion grazes the surface"
                return found("GR", note, value + ahead * float(chord[place]), True), None
        if np.isfinite(ahead := share("gap")) and (point := _beyond(walk, last, now)) is not None:
            return found("ST", "", value + ahead * float(chord[place]), True), point
    return found("MX", _why(walk.equations, nodes)), None


def _beyond(walk: Walk, last: Node, touch: _Touch) -> Node | None:
    """Return the first point of a branch beyond an impact at the strobe; None where none is found."""
    ahead = np.zeros_like(last.z)
    ahead[-1] = np.sign(last.tangent[-1])
    for k in range(FARTHER):
        away = 2.0 ** (k + 1) * walk.pace.least / last.weights[-1]
        guess = np.append(touch.beyond, last.z[-1]) + away * ahead
        point = correct(walk.equations, guess, ahead, tolerance=walk.tolerance)
        if point.residual <= walk.tolerance and point.length(point.z - guess) < BESIDE:
            other = _touch_of(walk.equations, point)
            if other is not None and other.rate * touch.rate < 0:
                return point
    return None


def _why(equations: AbstractEquations, nodes: Sequence[Node]) -> str:
    """Return a text why no step converges after the last of some points, as far as these points show it."""
    motions = isinstance(equations, PeriodicMotions)
    # on curves of critical motions a multiplier may always be +1
    if motions and np.any(np.abs(np.asarray(nodes[-1].multipliers) - 1) < 1e-6):
        return "a multiplier is +1: branches cross or turn back here, begin beside it"
    sizes = np.array([np.abs(np.asarray(node.matrices)).max() for node in nodes[-6:]])
    if len(sizes) == 6 and np.all(np.diff(sizes) > 0) and sizes[-1] > 10 * sizes[0]:
        return "derivatives grow without bound, as at a grazing"
    # near a grazing, on the side without a touch, derivatives do not show the grazing
    return "the map may jump, bend or end here, as where a motion grazes a surface" if motions else ""
