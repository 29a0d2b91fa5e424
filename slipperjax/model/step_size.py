"""Duration and depth of a typical impact, from which steps and the settings of the smooth switch are chosen."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import instance, whole
from ..tools.compile import jit
from ..tools.tracing import is_traced
from .scene import Scene, check_scene
from .tracks import DEFAULT_WAVELENGTH
from .travel import Travel

PER_CONTACT = 10
"""Default number of steps per typical impact, chosen by `tests/benchmarks/test_steps.py`."""
PER_MODE = 20
"""Default number of steps per oscillation of the highest elastic mode; RK4 loses 3e-4 of its energy in an
oscillation.
"""
LEAST_STEPS = 40
"""Lower bound of the default steps per forcing period, and the smallest unit to which steps are rounded up."""
MOST_STEPS = 100_000
"""Default steps above which the scene's units are probably wrong, see `rounded_steps`."""


def given_steps(steps: object) -> int:
    """Return the given steps per forcing period; raise `ValueError` unless they are 1 to 10 million."""
    return whole("steps_per_period", steps, 1, 10_000_000)


def contact_duration(scene: Scene, travel: Travel | None = None) -> Float[Array, ""]:
    """Return the duration of a typical impact [s], from Hertz's theory without damping.

    **Arguments:** `travel`: where the impact is, by default where the scene is slowest.

    The approach speed is that of the track, see `AbstractTrack.approach_speed` (0.1 m/s at least). The mass is the
    effective mass at a corner, from translation and rotation. The duration gives step sizes and the settings of the
    smooth switch, and shows whether steps resolve impacts.
    """
    instance("scene", scene, Scene, "a slipperjax.Scene")
    if travel is not None:
        instance("travel", travel, Travel, "of `Scene.travel`")
    # Hertz's impact of a sphere: 2.94 times the greatest depth over the approach speed
    return 2.94 * contact_depth(scene, travel) / _approach(scene, travel)


def contact_depth(scene: Scene, travel: Travel | None = None) -> Float[Array, ""]:
    """Return the depth of a typical impact [m], see `contact_duration`."""
    # effective mass at a corner, which translates, rolls and pitches
    body = scene.slipper
    yielding = 1 / body.mass + scene.reach**2 / body.inertia[0] + scene.half_length**2 / body.inertia[1]
    if body.modes is not None:
        # modes also yield to an impact
        yielding = yielding + jnp.max(jnp.sum(body.modes.shapes**2, axis=(0, 2)))
    mass = 1 / yielding
    return (1.25 * mass * _approach(scene, travel) ** 2 / scene.contact.stiffness) ** 0.4


def _approach(scene: Scene, travel: Travel | None = None) -> Float[Array, ""]:
    """Return the approach speed of a typical impact [m/s], 0.1 m/s at least."""
    travel = scene.slowest_travel if travel is None else travel
    # a straight track has no slope
    return jnp.maximum(scene.track.approach_speed(travel.speed), 0.1)


def settle_memory(scene: Scene) -> Scene:
    """Copy a scene, with its own values in place of the contact memory's settings of None, see `SmoothSwitch`."""
    memory = scene.contact_memory
    scaled = memory.scaled(contact_depth(scene), contact_duration(scene), scene.period)
    # the same object where there was no None
    return scene if scaled is memory else eqx.tree_at(lambda s: s.memory, scene, scaled)


def prepared(scene: Scene) -> Scene:
    """Copy a scene with values that are the same for all steps: the track's spline, and the memory's settings."""
    track = scene.track.prepared()
    if track is not scene.track:
        scene = eqx.tree_at(lambda s: s.track, scene, track)
    return settle_memory(scene)


def steps_needed(scene: Scene) -> Float[Array, ""]:
    """Return steps per forcing period such that a typical impact takes `PER_CONTACT` steps [1].

    Where the damping force at a typical touchdown exceeds twice the elastic force, the steps of an impact are shorter
    in proportion. The shortest wave of the track takes ten steps, times `damped_waves`.

    With a second wave of 0.5 or 1 m and amplitudes of 0.1 to 0.3 mm, the error after two periods was 1e-4 to 0.05
    scales with ten steps per wave, and 0.6 to 4 with five steps or fewer.

    The damping of a slow touchdown that is then pressed in decays several times faster than that of a typical impact.
    Of 200 random scenes with restitutions of 0.2 to 1 and RK4, 4 % had an error above 0.1 after the first period
    where damping did not shorten steps. With the shorter steps 1.5 % have such an error, two of the three with a
    status.
    """
    law = scene.contact
    # at a touchdown g' / g'_0 is one
    damping = jnp.asarray(law.damping(-_approach(scene), jnp.ones(()) if law.has_memory else None))
    impacts = scene.slowest_travel.period / contact_duration(scene)
    waves = scene.wavelength / scene.track.shortest_wavelength
    # impacts or short waves, whichever need more steps
    per_impact = PER_CONTACT * impacts * jnp.maximum(damping / 2.0, 1.0)
    needed = jnp.maximum(per_impact, 10 * waves * damped_waves(damping))
    modes = scene.slipper.modes
    if modes is None:
        return needed
    return jnp.maximum(needed, PER_MODE * modes.frequency[-1] * scene.slowest_travel.period)


def damped_waves(damping: Array) -> Array:
    """Return the factor on the steps of a shortest wave where impacts are damped [1].

    Measured on the highest forces of 768 sled rails at 1000 m/s. At a restitution of 0.5, the 95 and 99 % quantiles
    with the damping itself as the factor were 11 and 18 % below the quantiles with 800 steps; with 400 steps 6 and 5
    % below. At 0.7, with the factor one, they were 4 % below those with 480 steps. See
    `tests/benchmarks/test_tails.py`.

    **Arguments:** `damping`: damping force over elastic force at a typical touchdown [1].
    """
    return jnp.maximum(2 * jnp.sqrt(damping), 1.0)


_steps_needed = jit(steps_needed)


def default_steps_per_period(scene: Scene) -> int:
    """Return steps per forcing period, at least `LEAST_STEPS`, such that a typical impact takes `PER_CONTACT` steps.

    There are more steps where the track's shortest wave would take less than 10 steps, or where the damping force at
    a touchdown exceeds twice the elastic force, for restitutions below 0.44.
    Rounded up: to a multiple of 40 up to 240 steps, of 80 up to 480, of 160 up to 960, and so on.

    **Raises:** `ValueError` for a traced scene, whose values are unknown.
    """
    # without its tangent, a differentiated number is a plain number
    scene = jax.lax.stop_gradient(check_scene(scene))
    needed = _steps_needed(scene)
    if is_traced(needed):
        raise ValueError("Argument `steps_per_period` must be given where the scene is traced (jit, vmap).")
    return int(rounded_steps(needed, scene.wavelength))


def rounded_steps(needed: Array | np.ndarray, wavelength: Array | np.ndarray) -> np.ndarray:
    """Return steps per forcing period as in `default_steps_per_period`.

    **Arguments:** `needed`: `steps_needed` of shape (*cases,); `wavelength`: travel in a forcing period [m].

    **Raises:** `ValueError` above 100,000 steps in a forcing period, or in `DEFAULT_WAVELENGTH` of a longer period
    such as a whole survey; the units are wrong then, and a run would not end.
    """
    needed = np.asarray(needed)
    share = np.minimum(DEFAULT_WAVELENGTH / np.asarray(wavelength), 1.0)
    if np.max(share * needed) > MOST_STEPS:
        raise ValueError(
            f"Argument `steps_per_period` must be given: the default would be {np.max(needed):.1e}, because impacts "
            "are that short beside the forcing period. Are speed, stiffness and amplitude in SI units?"
        )
    return rounded_up(needed)


def rounded_up(needed: np.ndarray) -> np.ndarray:
    """Return steps per forcing period as `rounded_steps`, without an upper limit."""
    steps = np.maximum(needed, LEAST_STEPS)
    # Units of 40 up to 240 steps, of 80 up to 480, and so on, so that the cases of a sweep share a few step counts.
    octave = np.maximum(np.ceil(np.log2(steps / (6 * LEAST_STEPS))), 0)
    unit = LEAST_STEPS * 2**octave
    return np.asarray(unit * np.ceil(steps / unit), int)
