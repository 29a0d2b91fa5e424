"""Whether slippers that outrun the waves of a rail excite themselves: a linear analysis of bodies on a `Beam`.

Above the critical speed a rail that bends gives energy to oscillations of what it carries
(doi:10.1016/S0997-7538(99)80020-5). Small oscillations exp(s t) of a body that contacts of the stiffness k hold to
its rail obey det(A / s^2 + C(s) + 1 / k) = 0. A and C are the compliances of body and rail between the track nodes.
They grow where the real part of s is positive. Contacts become stiffer the more they are pressed; therefore all
stiffnesses up to that of a typical impact are searched at once: those of the real eigenvalues 1 / k of
-A / s^2 - C(s).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import warn
from ..tools.compile import jit
from ..tools.tracing import is_traced
from .beam import Beam
from .kinematics import contact_points, nodes_on_rails
from .scene import Scene
from .step_size import contact_depth

GROWTH = 0.05
"""Least growth rate over circular frequency with which slippers excite themselves [1]. Contacts take the energy of
slower growth: see `test_where_slippers_excite_themselves` of `tests/studies/test_bending.py`."""


_compliance = jit(Beam.compliance)


def excites_itself(scene: Scene) -> bool:
    """Return whether oscillations of slippers on a rail that bends grow at the highest speed of a scene.

    Nodes move as points of a rigid body, and in each direction each node is held by the contacts of one point.
    """
    assert scene.beam is not None
    travel = scene.fastest_travel
    depth = contact_depth(scene, travel)
    stiffest = float(1.5 * scene.contact.stiffness * jnp.sqrt(depth))
    x, y, z = (np.asarray(arm).reshape(scene.nodes[1], -1).mean(axis=1) for arm in contact_points(scene).arm)
    j_x, j_y, j_z = map(float, scene.slipper.inertia)
    turned = lambda *arms: sum(np.outer(arm, arm) / inertia for arm, inertia in arms)
    yielding = 1 / float(scene.slipper.mass) + np.stack([turned((z, j_x), (x, j_z)), turned((y, j_x), (x, j_y))])
    # the rail makes the fastest oscillation slower
    fastest = np.sqrt(stiffest * np.linalg.eigvalsh(yielding).max())
    rates = (GROWTH + 1j) * np.geomspace(fastest / 100, fastest, 500)
    rail = np.asarray(_compliance(scene.beam, nodes_on_rails(scene), x, travel.speed, rates))
    softness = np.linalg.eigvals(-yielding / rates[:, None, None, None] ** 2 - rail)
    # in this order each imaginary part changes steadily, and an eigenvalue is real where its sign changes
    softness = np.take_along_axis(softness, np.argsort(softness.imag), -1)
    crosses = np.diff(np.signbit(softness.imag), axis=0)
    return bool(np.any(crosses & (softness.real[1:] > 1 / stiffest)))


def outrun(scene: Scene) -> Float[Array, ""]:
    """Return the highest speed over the critical speed of the rails, in the direction where that is lower [1]."""
    assert scene.beam is not None
    return scene.fastest_travel.speed / jnp.min(scene.beam.critical_speed)


def warn_of_excitation(scene: Scene) -> None:
    """Give an `ImplausibleWarning` where slippers on rails that bend excite themselves."""
    if scene.beam is None or is_traced(scene) or outrun(scene) <= 1 or not excites_itself(scene):
        return
    speed, ratio = float(scene.fastest_travel.speed), float(outrun(scene))
    warn(
        f"Slippers excite themselves at {speed:.4g} m/s, {ratio:.3g} times the critical speed of their rails, "
        f"{speed / ratio:.4g} m/s, and forces grow beyond what the model holds for: go slower, or give `beam` a "
        "stiffer bed or more damping where measurements allow it."
    )
