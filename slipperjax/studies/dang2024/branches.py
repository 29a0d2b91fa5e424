"""Branches of periodic orbits behind the paper's diagrams.

A diagram shows where one start ends up; a branch shows which motions there are. Where a motion disappears from a
diagram, either its branch ends or turns unstable, at an event with a name, or the branch goes on and the start leads
elsewhere.
"""

from collections.abc import Iterator
from typing import Any

from ...model.dang2024 import paper_scene
from ...orbits.branches import OrbitBranch, continue_orbit


def follow_branches(name: str, flips: int, **options: Any) -> Iterator[OrbitBranch]:
    """Yield the branch over one parameter through the paper's nominal case, and over speed those of twice the period.

    **Arguments:** `flips`: how often a branch is left for one of twice the period; `options`: `progress`.
    """
    bounds = {"speed": (900.0, 2300.0), "clearance": (0.1e-3, 5e-3), "length": (0.1, 0.5)}[name]
    # the places of events agree to five digits with those of 400 steps
    branch = continue_orbit(paper_scene(), name, bounds, steps_per_period=200, **options)
    yield branch
    for _ in range(flips if name == "speed" else 0):
        # the flip at which the stable orbits of a branch end towards low speeds
        flip = max(branch.events_named("PD"), key=lambda event: event.value, default=None)
        if flip is None:
            return
        try:
            branch = branch.switched(flip, bounds=(800.0, 2300.0), **options)
        except ValueError:  # no orbit of twice the period was found beside the flip
            return
        yield branch
