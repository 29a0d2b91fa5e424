"""What sensors can read of a body's motion, along some forcing periods of many runs, and its derivatives."""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..flow.period_map import PeriodMap
from ..flow.record import RecordSet, Unlabelled
from ..flow.stepping import AbstractStepping
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


class Pushed(NamedTuple):
    """Runs at their beginning, or after a forcing period."""

    state: State
    slopes: Float[Array, "runs directions size"]
    """Derivatives of the state, first by the parameters, then by the ten numbers of the start's motion."""
    channels: Channels
    """At the beginning, (runs, ...), or in the period, (runs, samples, ...)."""
    channel_slopes: Channels
    """Their derivatives, (runs, directions, ...)."""


@functools.partial(jit, static_argnames=("names",))
def begin(scenes: Batched[Scene], starts: State, epoch: Float[Array, " runs"], *, names: tuple[str, ...]) -> Pushed:
    """Return runs at their beginning.

    **Arguments:** `starts`: with a memory of None where closed contacts begin there; `epoch`: forcing periods from
    distance zero; `names`: of the parameters by which runs are differentiated.
    """

    def one(scene: Scene, start: State, epoch: Real) -> Pushed:
        count = len(names)
        numbers = jnp.stack([getattr(start.motion, name) for name in MOTION_NUMBERS])
        both = jnp.concatenate([values_of(scene, names), numbers])

        def at(both: Array) -> tuple[State, Channels]:
            here = at_values(scene, names, both[:count])
            motion = Motion(*both[count:], sled=start.motion.sled, modes=start.motion.modes)
            state, _ = state_and_penetration(here, State(motion, start.memory), epoch)
            return state, channels(Args(here, epoch), 0.0, state)

        push = lambda way: jax.jvp(at, (both,), (way,))
        (state, seen), (slopes, seen_slopes) = jax.vmap(push, out_axes=((None, None), 0))(jnp.eye(both.size))
        return Pushed(state, jax.vmap(lambda slope: ravel_pytree(slope)[0])(slopes), seen, seen_slopes)

    return scenes.map(one, starts, epoch)


@functools.partial(jit, static_argnames=("names", "samples", "solver"))
def push(
    scenes: Batched[Scene],
    states: State,
    slopes: Float[Array, "runs directions size"],
    epoch: Float[Array, " runs"],
    stepping: AbstractStepping,
    *,
    names: tuple[str, ...],
    samples: int,
    solver: diffrax.AbstractSolver,
) -> Pushed:
    """Run a forcing period, whose channels are kept `samples` times, and differentiate both. Arguments as of
    `begin`."""
    records = RecordSet((ChannelRecord(samples),))

    def one(scene: Scene, state: State, slopes: Array, epoch: Real) -> Pushed:
        flat, unravel = ravel_pytree(state)

        def run(x: Array, p: Array) -> tuple[Array, Channels]:
            step = PeriodMap(at_values(scene, names, p), stepping, solver)
            passage = step.run(unravel(x), epoch, periods=1, records=records)
            # the only record, without its axis of periods
            return ravel_pytree(passage.state)[0], jax.tree.map(lambda a: a[0], passage.samples[0])

        p = values_of(scene, names)
        along = jnp.eye(len(slopes), p.size)
        push = lambda dx, dp: jax.jvp(run, (flat, p), (dx, dp))
        (end, seen), (end_slopes, seen_slopes) = jax.vmap(push, out_axes=((None, None), 0))(slopes, along)
        return Pushed(unravel(end), end_slopes, seen, seen_slopes)

    return scenes.map(one, states, slopes, epoch)
