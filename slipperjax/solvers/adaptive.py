"""Adaptive steps for slippers: errors in multiples of the motion's scales, with a larger weight at touchdowns."""

import diffrax
import jax
import jax.numpy as jnp
from diffrax import RESULTS

from ..model.kinematics import MOTION_SCALES, Motion, contacts, scaled_size, with_parts
from ..model.step_size import contact_depth, contact_duration
from ..tools.checks import instance, number, positive
from ..tools.tracing import is_traced


class AdaptiveSteps(diffrax.AbstractAdaptiveStepSizeController):
    """Steps as long as the error allows, for any solver with an error estimate.

    Four rules are added to the error estimate:

    - Flight without contact has no error, so that steps would grow until one passes over an impact. Therefore no step
      is longer than a part of a typical contact.
    - A touchdown is a kink inside a step, and error estimates for smooth motions are too small there. Therefore the
      error of a step in which the event latch found a touchdown is multiplied by `touchdown`.
    - With an integrated memory, a step ends where the next point begins to touch down, predicted from its gap, rate
      and acceleration. Otherwise steps across this place would be tried and rejected.
    - Errors of an integrated memory count as far as they affect contacts, see `AbstractIntegratedMemory.felt`.

    Each period starts with the step length proposed at the end of the previous period.

    The tolerance is for the motion: the highest contact forces on a random rail had errors of 3.5 % at 1e-5, 12 % at
    1e-4 and 81 % at 1e-3. At equal cost the default, constant steps with `ImpulseRK4`, is 10 to 30 times more exact.
    `probe` of `slipperjax.simulate` also measures the error of forces.
    """

    tolerance: float = 1e-5
    """Error allowed per step, in multiples of `scales`."""
    touchdown: float = 10.0
    """Factor on the error of a step in which the event latch found a touchdown [1].

    Measured with Tsit5 at a tolerance of 1e-6, 10 against 1: 25 to 55 % more steps, errors 1.2 to 5 times smaller.
    """
    per_contact: float = 4.0
    """The longest step is the duration of a typical contact (`contact_duration`) divided by this number [1]."""
    shortest: float = 1e-9
    """The integration fails if a step would have to be shorter than this [forcing periods]."""
    scales: Motion = MOTION_SCALES
    """Scales of the motion's numbers [m], [1], [m/s] and [rad/s]; by default for clearances of about a millimetre. In
    the quaternion the scale of an angle counts half. Parts without scales, a sled on springs and elastic modes, have
    the scales of `slipperjax.model.accuracy_scales`."""

    def __check_init__(self):
        for name in "tolerance", "touchdown", "per_contact", "shortest":
            if not is_traced(getattr(self, name)):
                number(positive, name, getattr(self, name))
        instance("scales", self.scales, Motion, "a slipperjax.Motion of sizes")

    @property
    def rtol(self):
        """Relative tolerance [1] of the root finders of diffrax's implicit solvers."""
        return 0.0

    @property
    def atol(self):
        return 0.1 * self.tolerance

    @property
    def norm(self):
        return lambda error: scaled_size(error if isinstance(error, Motion) else error.motion, self.scales)

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        longest = self._longest(args, t0)
        wanted = jax.lax.stop_gradient(longest if dt0 is None else jnp.minimum(dt0, longest))
        return t0 + _fitted(wanted, t1 - t0), (wanted, jnp.asarray(t1, float))

    def adapt_step_size(
        self,
        t0,
        t1,
        y0,
        y1_candidate,
        args,
        y_error,
        error_order,
        controller_state,
    ):
        assert y_error is not None  # see `resolve_controller`
        _, end = controller_state
        scene = args.scene
        size = scaled_size(y_error.motion, with_parts(self.scales, scene)) / self.tolerance
        if scene.integrates_memory:
            before, now = (contacts(args.frame(t), y.motion) for t, y in ((t0, y0), (t1, y1_candidate)))
            # errors in the memory count as far as contacts feel them, in the scale of the vertical velocity
            felt = scene.contact_memory.felt(now.gap, now.rate, contact_depth(scene))
            size = jnp.maximum(size, jnp.max(jnp.abs(y_error.memory) * felt) / self.scales.v_z / self.tolerance)
        elif scene.latches_memory:
            touched = jnp.any((y0.memory >= 0) & (y1_candidate.memory < 0))
            size = jnp.where(touched, self.touchdown * size, size)
        # Reject steps with NaN.
        bad = jnp.isnan(size) | jnp.isnan(scaled_size(y1_candidate.motion))
        size = jax.lax.stop_gradient(jnp.where(bad, jnp.inf, size))
        keep = size <= 1
        # a tenth shorter than the error allows, and neither much longer nor much shorter than the last step
        safety = 0.9
        factor = safety * jnp.maximum(size, 1e-12) ** (-1 / error_order)
        factor = jnp.clip(factor, 0.2, jnp.where(keep, 5.0, safety))
        wanted = jax.lax.stop_gradient(jnp.minimum((t1 - t0) * factor, self._longest(args, t1)))
        at = jnp.where(keep, t1, t0)
        # an accepted step may propose a next step shorter than allowed, a rejected step may not
        underflow = wanted < self.shortest
        result = RESULTS.where(underflow & ~keep, RESULTS.dt_min_reached, RESULTS.successful)
        step = wanted
        if scene.integrates_memory:
            # up to where the switch of a contact begins to close
            gap, rate = (jnp.where(keep, b, a) for a, b in ((before.gap, now.gap), (before.rate, now.rate)))
            period = args.travel(at).period
            acceleration = (now.rate - before.rate) / (t1 - t0)
            step = _until(gap - scene.contact_memory.closing_gap, period * rate, period * acceleration, wanted)
        return keep, at, at + _fitted(step, end - at), False, (wanted, end), result

    def _longest(self, args, t):
        duration = contact_duration(args.scene, args.travel(t)) / args.travel(t).period
        return jax.lax.stop_gradient(duration / self.per_contact)


def _until(gap, rate, acceleration, wanted):
    """Return the time until the first of some gaps falls to zero on its parabola; `wanted` if none does before.

    Gaps that reach zero within a tenth of `wanted` are left to the next step.
    """
    root = rate * rate - 2 * acceleration * gap
    speed = jnp.sqrt(jnp.maximum(root, 0.0)) - rate
    falls = (gap > 0) & (root > 0) & (speed > 0)
    time = 2 * gap / jnp.where(falls, speed, 1.0)
    inside = falls & (time > 0.1 * wanted) & (time < wanted)
    return jax.lax.stop_gradient(jnp.min(jnp.where(inside, time, wanted)))


def _fitted(wanted, left):
    """Return the next step with `left` remaining, without a tiny last step, which spoils the latch's parabola."""
    # one step, two equal steps, or the first of many
    return jnp.where(left <= wanted, left, jnp.where(left < 2 * wanted, left / 2, wanted))
