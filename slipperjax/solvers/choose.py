"""Which solver a scene needs."""

from typing import NamedTuple

import diffrax

from ..contact import SmoothSwitch
from ..scene import Scene, default_steps_per_period, impacts_per_period
from .explicit import RK4
from .rosenbrock import ROS34PW2

STABLE = 2.5
"""Step times decay rate up to which RK4 is stable, a little below its 2.79."""


class Choice(NamedTuple):
    """A solver, and why."""

    solver: diffrax.AbstractSolver
    reason: str


def choose_solver(scene: Scene) -> Choice:
    """What `solver="auto"` takes, and the reason.

    Steps must resolve each impact, whatever the solver: with `default_steps_per_period` an explicit method is then
    stable as well, and cheapest. Only a memory that relaxes within a step of that length makes a scene stiff.

    **Arguments:** `scene`: one case; its numbers must be known (no `jit` around this).

    **Raises:** `ValueError` where they are not.
    """
    steps = default_steps_per_period(scene)
    period = float(scene.period)
    impact = f"an impact lasts {1 / float(impacts_per_period(scene)):.3g} of a period, {steps} steps resolve it"
    if scene.contact.has_memory and isinstance(scene.memory, SmoothSwitch):
        relaxation = scene.settled().memory.relaxation
        stretch = period / steps / float(relaxation)
        if stretch > STABLE:
            return Choice(ROS34PW2(), f"{impact}, but the memory relaxes {stretch:.3g} times per step: implicit")
        return Choice(RK4(), f"{impact}, and the memory relaxes {stretch:.3g} times per step: explicit")
    return Choice(RK4(), f"{impact}, and the contact memory changes at touchdowns only: explicit")
