"""Duration and depth of a typical impact, from which step sizes and the smooth switch are chosen."""

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
"""Default number of steps per oscillation of the highest elastic mode, in each of which RK4 loses 3e-4 of its energy.
"""
LEAST_STEPS = 40
"""Lower bound on the default steps per forcing period, and the smallest unit to which they are rounded up."""
MOST_STEPS = 100_000
"""Default steps above which the units of a scene are doubted, see `rounded_steps`."""


def given_steps(steps: object) -> int:
    """Return steps per forcing period that were given; raise `ValueError` unless they are 1 to 10 million."""
    return whole("steps_per_period", steps, 1, 10_000_000)


def contact_duration(scene: Scene, travel: Travel | None = None) -> Float[Array, ""]:
    """Return the duration of a typical impact [s], from Hertz's theory without damping.

    **Arguments:** `travel`: where the impact is, by default where the scene is slowest.

    The approach speed is the track's, see `AbstractTrack.approach_speed` (0.1 m/s at least); the mass is the
    effective mass at a corner, from translation and rotation. It is used to choose step sizes and the smooth switch,
    and to check that steps resolve impacts.
    """
    instance("scene", scene, Scene, "a slipperjax.Scene")
    if travel is not None:
        instance("travel", travel, Travel, "of `Scene.travel`")
    # Hertz's impact of a sphere: 2.94 times the greatest depth over the approach speed
    return 2.94 * contact_depth(scene, travel) / _approach(scene, travel)


def contact_depth(scene: Scene, travel: Travel | None = None) -> Float[Array, ""]:
    """Return the depth of a typical impact [m], see `contact_duration`."""
    # effective mass of a corner, which translates, rolls and pitches
    body = scene.slipper
    reach = body.reach(scene.section)
    along = body.half_length(scene.section)
    yielding = 1 / body.mass + reach**2 / body.inertia[0] + along**2 / body.inertia[1]
    if body.modes is not None:
        # modes yield to an impact, too
        yielding = yielding + jnp.max(jnp.sum(body.modes.shapes**2, axis=(0, 2)))
    mass = 1 / yielding
    return (1.25 * mass * _approach(scene, travel) ** 2 / scene.contact.stiffness) ** 0.4


def _approach(scene: Scene, travel: Travel | None = None) -> Float[Array, ""]:
    """Return the approach speed of a typical impact [m/s], 0.1 m/s at least."""
    travel = scene.slowest_travel if travel is None else travel
    # a straight track has no slope that approaches
    return jnp.maximum(scene.track.approach_speed(travel.speed), 0.1)


def settle_memory(scene: Scene) -> Scene:
    """Copy a scene with the contact memory's settings of None filled in for it, see `SmoothSwitch`."""
    memory = scene.contact_memory
    scaled = memory.scaled(contact_depth(scene), contact_duration(scene), scene.period)
    # the same object where nothing was left to fill in
    return scene if scaled is memory else eqx.tree_at(lambda s: s.memory, scene, scaled)


def prepared(scene: Scene) -> Scene:
    """Copy a scene with what is the same for all steps computed: the track's spline, and the memory's settings."""
    track = scene.track.prepared()
    if track is not scene.track:
        scene = eqx.tree_at(lambda s: s.track, scene, track)
    return settle_memory(scene)


def steps_needed(scene: Scene) -> Float[Array, ""]:
    """Return steps per forcing period with which a typical impact takes `PER_CONTACT` of them [1].

    Where the damping force at a typical touchdown exceeds twice the elastic one, the steps of an impact are shortened
    in proportion. The shortest wave of the track takes ten steps, times `damped_waves`.

    With a second wave of 0.5 or 1 m and amplitudes of 0.1 to 0.3 mm, the error after two periods was 1e-4 to 0.05
    scales with ten steps per wave, and 0.6 to 4 with half as many or fewer.

    The damping of a slow touchdown that is then pressed in decays several times faster than that of a typical impact.
    Of 200 random scenes with restitutions of 0.2 to 1 and RK4, 4 % had an error above 0.1 after the first period with
    steps that damping does not shorten; 1.5 % have with these, two of the three with a status that says so.
    """
    law = scene.contact
    # at a touchdown g' / g'_0 is one
    damping = jnp.asarray(law.damping(-_approach(scene), jnp.ones(()) if law.has_memory else None))
    impacts = scene.slowest_travel.period / contact_duration(scene)
    waves = scene.wavelength / scene.track.shortest_wavelength
    # whichever needs more: impacts or short waves
    per_impact = PER_CONTACT * impacts * jnp.maximum(damping / 2.0, 1.0)
    needed = jnp.maximum(per_impact, 10 * waves * damped_waves(damping))
    modes = scene.slipper.modes
    if modes is None:
        return needed
    return jnp.maximum(needed, PER_MODE * modes.frequency[-1] * scene.slowest_travel.period)


def damped_waves(damping: Array) -> Array:
    """Return the factor on the steps of a shortest wave where impacts are damped [1].

    Of the highest forces on 768 sled rails at 1000 m/s and a restitution of 0.5, the 95 and 99 % quantiles were 11
    and 18 % below those with 800 steps where the factor was the damping itself, and 6 and 5 % below with 400; at 0.7
    they were 4 % below those with 480 where it was one. See `tests/benchmarks/test_tails.py`.

    **Arguments:** `damping`: damping force over elastic force at a typical touchdown [1].
    """
    return jnp.maximum(2 * jnp.sqrt(damping), 1.0)


_steps_needed = jit(steps_needed)


def default_steps_per_period(scene: Scene) -> int:
    """Return steps per forcing period, at least `LEAST_STEPS`: a typical impact takes `PER_CONTACT` of them.

    More where the track's shortest wave would take less than 10 steps, or where the damping force at a touchdown
    exceeds twice the elastic one: for restitutions below 0.44.
    Rounded up: to a multiple of 40 up to 240 steps, of 80 up to 480, of 160 up to 960, and so on.

    **Raises:** `ValueError` for a traced scene, whose values are unknown.
    """
    # without its tangent, a number that is differentiated is a plain number
    scene = jax.lax.stop_gradient(check_scene(scene))
    needed = _steps_needed(scene)
    if is_traced(needed):
        raise ValueError("Argument `steps_per_period` must be given where the scene is traced (jit, vmap).")
    return int(rounded_steps(needed, scene.wavelength))


def rounded_steps(needed: Array | np.ndarray, wavelength: Array | np.ndarray) -> np.ndarray:
    """Return steps per forcing period as in `default_steps_per_period`.

    **Arguments:** `needed`: `steps_needed` of shape (*cases,); `wavelength`: travel in a forcing period [m].

    **Raises:** `ValueError` above 100,000 in a forcing period, or in `DEFAULT_WAVELENGTH` of a longer one,
    such as a whole survey: units are wrong then, and a run would not end.
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
    """Return steps per forcing period as `rounded_steps`, however many."""
    steps = np.maximum(needed, LEAST_STEPS)
    # Units of 40 up to 240 steps, of 80 up to 480, and so on: the cases of a sweep then share a few step counts.
    octave = np.maximum(np.ceil(np.log2(steps / (6 * LEAST_STEPS))), 0)
    unit = LEAST_STEPS * 2**octave
    return np.asarray(unit * np.ceil(steps / unit), int)
