"""A rail that bends under `independent_run`, written anew with NumPy, to test slipperjax with.

It differs from slipperjax where it can: the rail rests and has two pinned ends; its modes are sines along the rail;
the slipper travels over them; the same adaptive method integrates modes and slipper, without any formula of free
waves. SI units.
"""

from dataclasses import dataclass

import numpy as np

from .independent_run import SIZES, Case


@dataclass
class BendingCase(Case):
    """A slipper that begins amid a straight beam on an elastic bed; pairs: laterally and vertically."""

    bending_stiffness: tuple = (1.0, 1.0)
    rail_mass: float = 1.0
    bed: tuple = (1.0, 1.0)
    damping: tuple = (0.0, 0.0)
    rail_length: float = 40.0
    before: float = 10.0  # length of rail behind the slipper's start
    shortest: float = 0.4  # wavelength

    def __post_init__(self):
        super().__post_init__()
        self.waves = np.arange(1, int(2 * self.rail_length / self.shortest) + 1) * np.pi / self.rail_length
        pairs = (np.array(pair)[:, None] for pair in (self.bending_stiffness, self.bed, self.damping))
        stiffness, bed, damping = pairs
        self.square = (stiffness * self.waves**4 + bed) / self.rail_mass
        self.decay = damping / self.rail_mass

    @property
    def sizes(self):
        modes = 2 * len(self.waves)
        # amplitudes, then rates
        return np.concatenate([SIZES, np.full(modes, 1e-4), np.full(modes, 1.0)])

    def modes(self, state):
        """Amplitudes and rates, each (2 directions, modes)."""
        return state[len(SIZES) :].reshape(2, 2, -1)

    def phases(self, travel):
        """Of each mode at each node."""
        return self.waves * (self.before + travel - np.array([0.0, self.length]))[:, None]

    def bends(self, state, travel, speed):
        amplitude, rate = self.modes(state)
        phases = self.phases(travel)
        shape, slope = np.sin(phases), self.waves * np.cos(phases)
        at_nodes = shape @ amplitude.T, shape @ rate.T + speed * slope @ amplitude.T
        # the rail does not move along x
        return tuple(np.repeat(np.column_stack([np.zeros(2), each]), 10, axis=0) for each in at_nodes)

    def rates(self, state, began, leads, travel, speed, acceleration):
        gap, rate, normal, *_ = self.geometry(state, travel, speed)
        force = self.forces(gap, rate, began, leads)
        pressing = -(force[:, None] * normal)[:, 1:].reshape(2, 10, 2).sum(axis=1)
        pushes = pressing.T @ np.sin(self.phases(travel))
        amplitude, its_rate = self.modes(state)
        acceleration_of_modes = 2 / (self.rail_length * self.rail_mass) * pushes
        acceleration_of_modes -= self.square * amplitude + self.decay * its_rate
        own = super().rates(state, began, leads, travel, speed, acceleration)
        return np.concatenate([own, its_rate.ravel(), acceleration_of_modes.ravel()])
