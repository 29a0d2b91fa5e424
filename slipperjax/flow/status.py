"""What can go wrong with a case: one enumeration, carried by every result."""

import enum
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ..model import Scene, State, contact_duration

LEAST_PER_CONTACT = 3
"""Steps of a typical impact below which a case is not trusted. The default is 15; at K = 1e12 a case stayed finite
at 5 and did not at 1.3."""


class Status(enum.IntEnum):
    """How a case went. Datasets hold the number, 0 where nothing is wrong."""

    meaning: str
    remedy: str

    FINITE = 0, "finite", ""
    NOT_FINITE = (
        1,
        "not finite: the steps are too long for this case, or the solver gave up",
        "raise steps_per_period; loosen the tolerance of a solver that iterates or adapts its steps",
    )
    DERAILED = (
        2,
        "derailed: the slipper turned by more than 90 degrees, where the contact model has no meaning",
        "reduce the clearance or the initial spin",
    )
    UNRESOLVED = (
        3,
        f"unresolved: a typical impact takes less than {LEAST_PER_CONTACT} steps",
        "raise steps_per_period",
    )

    def __new__(cls, code: int, meaning: str, remedy: str):
        member = int.__new__(cls, code)
        member._value_ = code
        member.meaning, member.remedy = meaning, remedy
        return member

    def __str__(self) -> str:
        return self.meaning + (f"; {self.remedy}" if self.remedy else "")


MEANINGS = "; ".join(f"{int(s)}: {s}" for s in Status)
"""All codes with meaning and remedy, for the attributes of datasets."""


def status_of(states: State) -> Int[Array, ""]:
    """`Status` code of a case from its states, over any leading axes: `FINITE`, `NOT_FINITE` or `DERAILED`."""
    leaves = jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(states.motion)])
    m = states.motion
    turned = jnp.any(m.q_x**2 + m.q_y**2 + m.q_z**2 > 0.5)  # half the angle's sine is sqrt(1/2) at 90 degrees
    good = jnp.where(turned, int(Status.DERAILED), int(Status.FINITE))
    return jnp.where(jnp.all(jnp.isfinite(leaves)), good, int(Status.NOT_FINITE))


def with_resolution(code: Array, scene: Scene, steps: Any) -> Int[Array, ""]:
    """A code of `status_of`, or `UNRESOLVED` where `steps` per period are too few for the scene's impacts.

    `UNRESOLVED` comes before `DERAILED`, which too few steps can bring about.
    """
    unresolved = contact_duration(scene) * steps < LEAST_PER_CONTACT * scene.period
    return jnp.where(unresolved & (code != int(Status.NOT_FINITE)), int(Status.UNRESOLVED), code)


def first_problem(earlier: Any, later: Any) -> np.ndarray:
    """Codes of two successive stretches of a run as one: the first that is not `FINITE`.

    `NOT_FINITE` comes before `UNRESOLVED`, as within a stretch.
    """
    earlier, later = np.asarray(earlier), np.asarray(later)
    lost = (earlier == Status.UNRESOLVED) & (later == Status.NOT_FINITE)
    return np.where((earlier == Status.FINITE) | lost, later, earlier)
