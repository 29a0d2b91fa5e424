"""The layout of a scene's state: its numbers by name, unit and scale, and states as rows of arrays."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.compile import jit
from .beam import RailState
from .dynamics import State
from .kinematics import ModalMotion, Motion, PayloadMotion, euler_angles
from .quantities import MODE_NUMBERS, MOTION_NUMBERS, PAYLOAD_NUMBERS, Quantity
from .scene import Scene


@dataclass(frozen=True)
class StateLayout:
    """The numbers of a state in a row: first the motion, then each part that the scene has."""

    motion: tuple[Quantity, ...]
    """The motion's numbers, in the order of `Motion`."""
    modes: int
    """Number of elastic modes; their coordinates and rates are the last numbers of the motion."""
    memory: tuple[Quantity, ...] | None
    """The memory of each contact point, front points first; None for laws without memory."""
    integrated: bool
    """Whether there is a memory that is integrated, not latched."""
    rail: RailState | None = None
    """The shapes of the state of rails that bend, whose numbers are the last; None for rigid rails."""

    @classmethod
    def of(cls, scene: Scene) -> "StateLayout":
        """Return the layout of a scene's states."""
        memory = None
        if scene.contact.has_memory:
            points = scene.point_names
            unit = scene.contact_memory.unit
            memory = tuple(Quantity(f"memory_{point}", unit, f"contact memory at {point}") for point in points)
        motion = MOTION_NUMBERS if scene.payload is None else MOTION_NUMBERS | PAYLOAD_NUMBERS
        modes = 0 if scene.slipper.modes is None else scene.slipper.modes.count
        # all coordinates, then all rates
        of_modes = [
            replace(q, name=f"{q.name}_{k}", long_name=f"{q.long_name} {k}")
            for q in MODE_NUMBERS
            for k in range(1, modes + 1)
        ]
        beam = scene.beam
        rail = None if beam is None else jax.eval_shape(lambda: beam.at_rest(*scene.nodes))
        return cls((*motion.values(), *of_modes), modes, memory, scene.integrates_memory, rail)

    @property
    def numbers(self) -> tuple[Quantity, ...]:
        """All numbers, in the order of a row."""
        count = sum(leaf.size for leaf in jax.tree.leaves(self.rail))
        of_rail = (Quantity(f"rail_{k}", "", f"number {k} of the rails' bending") for k in range(1, count + 1))
        return (*self.motion, *(self.memory or ()), *of_rail)

    @property
    def size(self) -> int:
        """Length of a row."""
        return len(self.numbers)

    @property
    def dimension(self) -> int:
        """Number of integrated states: a latched memory follows from the motion at the touchdown."""
        return self.size if self.integrated else len(self.motion)

    @property
    def scales(self) -> Float[np.ndarray, " size"]:
        """Typical size of each number."""
        return np.array([q.scale for q in self.numbers])

    @staticmethod
    def pack(states: State) -> Float[np.ndarray, "*batch size"]:
        """Return known states (*batch) as rows of all their numbers."""
        # with NumPy nothing is compiled
        batch = np.shape(states.motion.y)
        return np.concatenate([np.reshape(leaf, (*batch, -1)) for leaf in jax.tree.leaves(states)], axis=-1)

    def unpack(self, rows: Array | np.ndarray) -> State:
        """Return states from rows of their numbers (*batch, size)."""
        count = len(self.motion)
        single = count - 2 * self.modes
        parts = [rows[..., k] for k in range(single)]
        zeros = jnp.asarray(np.zeros(1))  # in place of an array
        sled = PayloadMotion() if single > len(MOTION_NUMBERS) else None
        modes = None
        if self.modes:
            parts += [rows[..., single : single + self.modes], rows[..., single + self.modes : count]]
            modes = ModalMotion(zeros, zeros)
        memory = None
        if self.memory is not None:
            parts.append(rows[..., count : count + len(self.memory)])
            memory = zeros
            count += len(self.memory)
        for leaf in jax.tree.leaves(self.rail):
            parts.append(rows[..., count : count + leaf.size].reshape(*rows.shape[:-1], *leaf.shape))
            count += leaf.size
        # by the structure, because the classes would convert and check the values of their fields
        return jax.tree.unflatten(
            jax.tree.structure(State(Motion(payload=sled, modes=modes), memory, self.rail)), parts
        )


def coordinate_rows(state: State) -> Float[Array, "*batch coordinates"]:
    """Return coordinates and velocities of states (*batch), in the order of `slipperjax.model.COORDINATES`."""
    m = state.motion
    return jnp.stack([m.y, m.z, *euler_angles(m), m.v_y, m.v_z, m.w_x, m.w_y, m.w_z], axis=-1)


_coordinate_rows = jit(coordinate_rows)


def coordinates(states: State) -> Float[np.ndarray, "*batch coordinates"]:
    """Return `coordinate_rows` as a NumPy array."""
    return np.asarray(_coordinate_rows(states))
