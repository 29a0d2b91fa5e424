"""What sensors can read of a body's motion, along some forcing periods of many runs, and its derivatives."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..flow.period_map import SlopePassage
from ..flow.record import Unlabelled
from ..model.dynamics import Args, State
from ..model.kinematics import Motion
from ..model.parameters import at_values, values_of
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene
from ..model.sensors import Channels, channels
from ..model.starts import state_and_penetration
from ..tools.batching import Batched
from ..tools.compile import jit
from ..tools.types import Real


@dataclass(frozen=True)
class ChannelRecord(Unlabelled):
    """The channels at equal distances of each forcing period, of which its end is the last."""

    samples: int

    @property
    def inside(self):
        return True

    def values(self, scene, periods):
        return 20 * self.samples * periods

    def sample(self, course) -> Channels:
        saved = course.saved(self.samples)
        instants = jnp.arange(1, self.samples + 1) / self.samples
        return jax.vmap(lambda t, state: channels(course.args, t, state))(instants, saved)


@functools.partial(jit, static_argnames=("names",))
def begin(
    scenes: Batched[Scene], starts: Motion | State, epoch: Float[Array, " runs"], *, names: tuple[str, ...]
) -> SlopePassage:
    """Return runs at their beginning, with the channels there as the sample of one instant.

    Derivatives are first by the parameters, then by the ten numbers of the start's motion.

    **Arguments:** `starts`: motions where closed contacts begin there; `epoch`: forcing periods from distance zero;
    `names`: of the parameters by which runs are differentiated.
    """

    def one(scene: Scene, start: Motion | State, epoch: Real) -> SlopePassage:
        start = start if isinstance(start, State) else State(start, None)
        count = len(names)
        numbers = jnp.stack([getattr(start.motion, name) for name in MOTION_NUMBERS])
        both = jnp.concatenate([values_of(scene, names), numbers])

        def at(both: Array) -> tuple[State, Channels]:
            here = at_values(scene, names, both[:count])
            motion = Motion(*both[count:], sled=start.motion.sled, modes=start.motion.modes)
            state, _ = state_and_penetration(here, State(motion, start.memory), epoch)
            seen = channels(Args(here, epoch), 0.0, state)
            return state, jax.tree.map(lambda a: a[None], seen)

        push = lambda way: jax.jvp(at, (both,), (way,))
        (state, seen), (slopes, seen_slopes) = jax.vmap(push, out_axes=((None, None), 0))(jnp.eye(both.size))
        return SlopePassage(state, jax.vmap(lambda slope: ravel_pytree(slope)[0])(slopes), (seen,), (seen_slopes,))

    return scenes.map(one, starts, epoch)
