"""Courses: one forcing period of a motion with its forces, as curves that functionals are made of.

Every quantity is a cubic in each integration step, through both ends with its slopes: fourth order in the step, like
the solution. Slopes of coordinates are the motion's own, all others those of `slipperjax.flow.loads`. Means
are taken over three points of a Gauss formula in each step, greatest values are those of the cubics.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..model.dynamics import Args, State, contact_forces, motion_rates
from ..model.kinematics import Motion, contacts
from ..model.scene import Scene
from ..tools.fused import materialise
from .loads import slopes
from .poincare import hermite, highest_point
from .recorders import AbstractRecorder, stacked

_NODES, _WEIGHTS = (a / 2 for a in np.polynomial.legendre.leggauss(3))
PLACES = _NODES + 0.5
"""Places inside a step at which curves are sampled [steps]."""


class Curve(NamedTuple):
    """A quantity over a period, a cubic in each step."""

    values: Float[Array, "ends ..."]
    """At both ends of every step."""
    slopes: Float[Array, "ends ..."]
    """Derivatives there, per step."""

    @property
    def samples(self) -> Float[Array, "samples ..."]:
        """Values at `PLACES` of every step, in the order of time."""
        parts = self.values[:-1], self.slopes[:-1], self.values[1:], self.slopes[1:]
        found = jnp.stack([hermite(x, *parts) for x in PLACES], axis=1)
        return found.reshape(-1, *self.values.shape[1:])

    @property
    def greatest(self) -> Float[Array, "steps ..."]:
        """The greatest value in every step."""
        return highest_point(self.values[:-1], self.slopes[:-1], self.values[1:], self.slopes[1:])[1]

    @property
    def turns(self) -> tuple[Bool[Array, "steps ..."], Float[Array, "steps ..."]]:
        """Whether the curve has an extreme in a step, where its slope changes sign, and the value there."""
        rises = self.slopes >= 0
        top, bottom = rises[:-1] & ~rises[1:], ~rises[:-1] & rises[1:]
        falling = Curve(-self.values, -self.slopes)
        return top | bottom, jnp.where(top, self.greatest, -falling.greatest)


class Course(eqx.Module):
    """One forcing period of a motion."""

    scene: Scene
    steps: Any
    """Integration steps per period; a traced number where one program serves several."""
    coordinates: Curve
    """(ends, 10), in the order of `slipperjax.model.COORDINATES`."""
    acceleration: Curve
    """(ends, 5), in the order of `slipperjax.model.ACCELERATIONS`."""
    force: Curve
    """Normal contact forces at the front and the rear points [N], (ends, 2, points)."""
    gap: Curve
    """Gaps there, negative where penetrating [m], (ends, 2, points)."""
    power: Curve
    """Power that the contacts take from the motion along the normals [W], (ends, 2, points): force times closing
    rate."""
    drive_force: Curve
    """Force along x that keeps the speed constant [N], (ends,)."""

    @property
    def taken(self) -> Bool[Array, " steps"]:
        """Which steps count: all, unless one program serves several numbers of them."""
        return jnp.arange(self.gap.values.shape[0] - 1) < self.steps

    @property
    def weights(self) -> Float[Array, " samples"]:
        """Weights of the samples in means over time [1]; their sum is one."""
        return jnp.where(self.taken[:, None], _WEIGHTS[None], 0.0).ravel() / self.steps

    def mean(self, samples: Float[Array, "samples ..."]) -> Float[Array, "..."]:
        """The mean over time of what was computed from samples of curves."""
        # 0 * NaN is NaN: samples of steps that do not count are set to zero
        weights = self.weights.reshape(-1, *[1] * (samples.ndim - 1))
        return jnp.sum(weights * jnp.where(weights > 0, samples, 0.0), axis=0)

    def greatest(self, curve: Curve) -> Float[Array, "..."]:
        """The greatest value of a curve."""
        found = curve.greatest
        found = jnp.where(self.taken.reshape(-1, *[1] * (found.ndim - 1)), found, -jnp.inf)
        # Stored, because the derivative of jnp.max looks for the values that equal the maximum: where XLA computes
        # them again and rounds otherwise, none does, and the derivative is 0 / 0.
        return jnp.max(materialise(found), axis=0)

    def least(self, curve: Curve) -> Float[Array, "..."]:
        """The least value of a curve."""
        return -self.greatest(Curve(-curve.values, -curve.slopes))

    def shallowest_turn(self, curve: Curve) -> Float[Array, "..."]:
        """The extreme of a curve that is nearest to zero, in magnitude; infinite where it has none."""
        turns, values = curve.turns
        turns &= self.taken.reshape(-1, *[1] * (values.ndim - 1))
        return jnp.min(materialise(jnp.where(turns, jnp.abs(values), jnp.inf)), axis=0)  # as in `greatest`


def course(states: State, args: Args, steps: Any) -> Course:
    """The course of a period.

    **Arguments:** as of `contact_loads`: `states` at both ends of every step, of which the first `steps` + 1 count.
    """

    def sample(place, state):
        frame = args.frame(place / steps)
        now = contacts(frame, state.motion)
        force = contact_forces(args.scene, now, state.memory)
        rates = motion_rates(args.scene, frame, now, state.motion, force)
        moving = jax.tree.map(lambda r: r * (args.scene.period / steps), rates)
        coordinates = jax.jvp(lambda m: stacked(State(m, state.memory)), (state.motion,), (moving,))
        acceleration = jnp.stack([rates.v_y, rates.v_z, rates.w_x, rates.w_y, rates.w_z])
        ends = lambda a: a.reshape(2, -1)
        points = ends(force), ends(now.gap), ends(-force * now.rate)
        others = acceleration, *points, -jnp.sum(force * frame.normal[0])
        # stored, so that XLA does not compute a sample again wherever it is used
        return Curve(*materialise(coordinates)), *map(materialise, others)

    coordinates, *others = jax.vmap(sample)(jnp.arange(states.motion.y.shape[0]), states)
    acceleration, force, gap, power, drive_force = (Curve(values, slopes(values, steps)) for values in others)
    # where a force is zero it begins or ends, or is zero throughout
    flat = lambda curve: curve._replace(slopes=jnp.where(force.values > 0, curve.slopes, 0.0))
    return Course(args.scene, steps, coordinates, acceleration, flat(force), gap, flat(power), drive_force)


@dataclass(frozen=True)
class Courses(AbstractRecorder):
    """What functions make of the course of each period, as a tuple."""

    functions: tuple[Callable[[Course], Any], ...]

    def __call__(self, states: State, args: Args, steps: Any, rates: Motion | None = None) -> tuple[Any, ...]:
        del rates
        found = course(states, args, steps)
        return tuple(function(found) for function in self.functions)

    @property
    def values(self) -> int:
        return 10 * len(self.functions)

    def collect(self, kept: Any) -> Any:
        return jax.tree.map(np.asarray, kept)

    def label(self, scene: Scene, dims: tuple[str, ...], record: Any) -> Any:
        raise NotImplementedError("What functions make of courses is labelled by those who know them.")
