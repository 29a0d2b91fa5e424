"""The smallest shock after which a slipper does not return to its orbit."""

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from ..analysis.shocks import Shock, smallest_shock
from ..flow.period_map import PeriodMap, tangent_weights
from ..model.quantities import MOTION_NUMBERS
from ..tools.checks import instance, number, positive, require
from .motions import consistent_state
from .periodic import PeriodicOrbit
from .simulate import dynamic_steps


def orbit_shock(
    orbit: PeriodicOrbit, shocks: Mapping[str, float], *, transient: int = 200, **options: object
) -> Shock:
    """Return the smallest shock at the start of a period after which the slipper does not return to its orbit.

    ```python
    shock = sj.orbits.orbit_shock(sj.periodic_orbit(scene), {"v_y": 0.1, "v_z": 0.1})
    ```

    **Arguments:** `shocks`: the change of each number of a motion that counts as a length of one [SI unit], by name:
    y, z, q_x, q_y, q_z, v_y, v_z, w_x, w_y, w_z; no shock changes the others. `transient`, `options`: as for
    `slipperjax.analysis.smallest_shock`.

    **Raises:** `ValueError` for orbits that are not stable, and where no ray leaves the basin.
    """
    instance("orbit", orbit, PeriodicOrbit, "a slipperjax.orbits.PeriodicOrbit")
    require(int(orbit.status) == 0 and orbit.stable, "orbit", "be stable", orbit)
    instance("shocks", shocks, Mapping, "changes by number of the motion")
    known = bool(shocks) and set(shocks) <= set(MOTION_NUMBERS)
    require(known, "shocks", f"name some of {', '.join(MOTION_NUMBERS)}", list(shocks))
    sizes = {
        name: jnp.asarray(number(positive, name, size, MOTION_NUMBERS[name].unit)) for name, size in shocks.items()
    }
    none = jax.tree.map(jnp.zeros_like, orbit.state)
    return smallest_shock(
        PeriodMap(orbit.scene, dynamic_steps(int(orbit.steps_per_period)), orbit.solver),
        orbit.state,
        dataclasses.replace(none, motion=dataclasses.replace(none.motion, **sizes)),
        transient=transient,
        scale=tangent_weights(orbit.scene),
        consistent=consistent_state,
        **options,
    )
