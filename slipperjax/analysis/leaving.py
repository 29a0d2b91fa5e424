"""Curves of folds, flips and Neimark-Sackers that begin at points of codimension two of other curves."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from ..tools.checks import instance, one_of, require
from .arclength import Node, evaluated
from .continuation import Branch
from .critical import CriticalMotions, located
from .events import Event
from .normal_forms import form_at

LEAVING = {"GPD": ("LP2",), "R1": ("NS",), "R2": ("NS", "NS2")}
"""Curves that begin at a point, by its label; a 2 marks those of motions of twice the period."""


def switch_critical(
    curve: Branch,
    event: Event,
    label: str,
    *,
    length: float = 0.05,
    tolerance: float = 1e-10,
) -> tuple[CriticalMotions, Node]:
    """Return the equations and first point of another curve that begins at a point of codimension two.

    ```python
    equations, first = analysis.switch_critical(curve, point, "NS2")
    other = analysis.continue_critical(equations, first, None, bounds, ways=(1,))
    ```

    **Arguments:** `curve`: of `continue_critical`; `event`: one of its points; `label`: "LP2" at a GPD, "NS" at an R1
    or R2, "NS2" at an R2, where 2 stands for twice the period; `length`: weighted distance of the first point along
    the critical eigenvector, or its angle from the resonance [rad].

    **Raises:** `ValueError` for other points and labels, or where no such curve begins there.
    """
    instance("curve", curve, Branch, "a curve of slipperjax.analysis.continue_critical")
    instance("event", event, Event, "one of the curve's events")
    one_of("event", event.label, tuple(LEAVING))
    one_of("label", label, LEAVING[event.label])
    motions = curve.equations.motions  # type: ignore[attr-defined]
    z = np.append(event.state, event.values)
    size = z.size
    angles = []
    if label == "NS":
        # the angle alone tells this curve from the point
        away = 1.0 if event.label == "R1" else -1.0
        row = np.append(0 * z, away)
        angles = [float(np.angle(event.multiplier)) % (2 * np.pi) + away * length]
    else:
        form = form_at(motions, z, event.label)
        direction = np.zeros_like(z)
        direction[: motions.size] = form.vectors(-1.0)[0].real / form.scale
        row = direction * np.append(form.scale, np.zeros(len(event.values))) ** 2
        motions = dataclasses.replace(motions, intervals=2 * motions.intervals)
        if label == "NS2":
            slope = event.coefficients["4c"]
            require(slope.real < 0, "event", "have a negative coefficient 4c for this curve to begin", slope)
            # the angle over two periods, by the flow that approximates the map near the point
            angles = [length * float(np.sqrt(-2 * slope.real))]
            row = np.append(row, 0.0)
        z = z + length * direction
    equations = CriticalMotions.of(motions, label.removesuffix("2"))
    guess = jnp.asarray(np.append(z, angles))
    node = located(equations, guess, jnp.asarray(row), tolerance=tolerance)
    found = node.residual <= tolerance
    if found and label.endswith("2"):
        # a motion of twice the period whose halves agree belongs to the curve itself
        missed = evaluated(dataclasses.replace(motions, intervals=motions.intervals // 2), node.z[:size]).residual
        found = np.linalg.norm(node.weights[: motions.size] * missed) > 0.1 * length
    require(found, "event", f"have a curve of {label} near it, with this `length`", event.label)
    return equations.update(node.z, node.null_vectors), node
