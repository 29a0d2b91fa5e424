"""Whether slippers that outrun the waves of a rail excite themselves: a linear analysis of bodies on a `Beam`.

Above the critical speed a rail that bends gives energy to oscillations of what it carries
(doi:10.1016/S0997-7538(99)80020-5). Small oscillations exp(s t) of a body that contacts of the stiffness K hold to
its rail obey det(A / s^2 + C(s) + I / K) = 0. A is the accelerance of the body and C the compliance of the rail
between the track nodes. The oscillations grow where the real part of s is positive. Contacts become stiffer the more
they are pressed; therefore all stiffnesses up to that of a typical impact are searched at once: those of the real
eigenvalues 1 / K of -A / s^2 - C(s).
"""

import jax
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
from .travel import Travel

GROWTH = 0.05
"""Least growth rate over circular frequency with which slippers excite themselves [1]. Contacts take the energy of
slower growth: see `test_where_slippers_excite_themselves` of `tests/studies/test_bending.py`."""
SPEEDS = 16
"""Number of speeds of a programme that are searched."""

_compliance = jit(Beam.compliance)


@jit  # sweeps ask for many cases
def _held(scene: Scene, travel: Travel) -> tuple[list[Array], Array]:
    """Return places x, y and z of the nodes [m], and the stiffness of contacts in a typical impact [N/m]."""
    places = [jnp.reshape(arm, (scene.nodes[1], -1)).mean(axis=1) for arm in contact_points(scene).arm]
    return places, 1.5 * scene.contact.stiffness * jnp.sqrt(contact_depth(scene, travel))


def excites_itself(scene: Scene, travel: Travel) -> bool:
    """Return whether oscillations of slippers on a rail that bends grow while the scene travels at a constant speed.

    Nodes move as points of a rigid body, and in each direction each node is held by the contacts of one point.
    """
    assert scene.beam is not None
    (x, y, z), stiffest = jax.tree.map(np.asarray, _held(scene, travel))
    j_x, j_y, j_z = map(float, scene.slipper.inertia)
    turned = lambda *arms: sum(np.outer(arm, arm) / inertia for arm, inertia in arms)
    accelerance = 1 / float(scene.slipper.mass) + np.stack([turned((z, j_x), (x, j_z)), turned((y, j_x), (x, j_y))])
    # the rail makes the fastest oscillation slower
    fastest = np.sqrt(stiffest * np.linalg.eigvalsh(accelerance).max())
    rates = (GROWTH + 1j) * np.geomspace(fastest / 100, fastest, 500)
    rail = np.asarray(_compliance(scene.beam, nodes_on_rails(scene), x, travel.speed, rates))
    # compliances of springs between nodes and rail
    springs = np.linalg.eigvals(-accelerance / rates[:, None, None, None] ** 2 - rail)
    # in this order each imaginary part changes steadily, and an eigenvalue is real where its sign changes
    springs = np.take_along_axis(springs, np.argsort(springs.imag), -1)
    crosses = np.diff(np.signbit(springs.imag), axis=0)
    return bool(np.any(crosses & (springs.real[1:] > 1 / stiffest)))


def speed_ratio(scene: Scene) -> Float[Array, ""]:
    """Return the highest speed over the critical speed of the rails, in the direction where that is lower [1]."""
    assert scene.beam is not None
    return scene.fastest_travel.speed / jnp.min(scene.beam.critical_speed)


def warn_of_excitation(scene: Scene) -> bool:
    """Give an `ImplausibleWarning` where slippers on rails that bend excite themselves at a speed of the scene.

    Faster slippers may be stable again, so all speeds of a programme are searched.

    **Returns:** whether the warning was given.
    """
    if scene.beam is None or is_traced(scene):
        return False
    with jax.ensure_compile_time_eval():  # all numbers are known, even where this is a part of a program
        critical = float(jnp.min(scene.beam.critical_speed))
        slowest, fastest = float(scene.slowest_travel.speed), float(scene.fastest_travel.speed)
        if fastest <= critical:
            return False
        for speed in np.unique(np.linspace(max(slowest, critical), fastest, SPEEDS)):
            if excites_itself(scene, Travel(jnp.asarray(speed), scene.wavelength)):
                warn(
                    f"Slippers excite themselves at {speed:.4g} m/s, {speed / critical:.3g} times the critical speed "
                    f"of their rails, {critical:.4g} m/s, and forces grow beyond what the model holds for: avoid "
                    "such speeds, or give `beam` a stiffer bed or more damping where measurements allow it."
                )
                return True
    return False
