"""A rail that bends: Euler and Bernoulli's beam on an elastic bed, in Fourier modes of a ring that travels along.

A deflection w, lateral or vertical, obeys EI w'''' + m w_tt + c w_t + k w = sum of the forces at the track nodes. In
the frame that travels with the speed V the nodes stand still. The mode of the wave number K is the sum of two complex
waves, which run backwards and forwards and move as exp((-g +- i w + i K V) t), so that a step of any length
multiplies them exactly.

The ring is longer than the rail that matters, and its waves must die before they come round. Therefore each wave has
at least a damping in proportion to its speed relative to the body: few waves are slow, and these stay where they are.
Short waves are fast and need less rail: their wave numbers lie further apart, as if each had a ring of its own.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..tools.checks import not_negative, number, positive, require
from ..tools.fields import ShapeChecked, field
from ..tools.forms import store, sums
from ..tools.tracing import is_traced
from ..tools.types import AnyArray, Real

Pair = Float[Array, "2"]
Waves = tuple[Array, Array]
"""Real and imaginary parts of complex numbers, or of waves of rails, (rails, 2 directions, 2 waves, modes) [m]."""


class RailState(eqx.Module):
    """How rails bend around the body at one instant."""

    deflection: Float[Array, "2 nodes"]
    """Lateral and vertical deflection at each track node, first the front one of each slipper [m]."""
    rate: Float[Array, "2 nodes"]
    """Rates of these deflections [m/s]; the nodes travel with the body."""
    waves: Waves
    """Waves of all modes, whose sum along the ring is the deflection [m]."""


class Beam(ShapeChecked):
    """A rail that bends laterally and vertically, on an elastic bed; each rail of a track is such a beam.

    ```python
    scene = dataclasses.replace(scene, beam=sj.Beam.crane_rail())
    ```

    Values are of the lateral and of the vertical direction. There is no torsion, and supports are spread evenly along
    the rail.
    """

    bending_stiffness: Pair = field("N m^2", positive)
    """Bending stiffness EI of the lateral and the vertical direction [N m^2]."""
    mass: Float[Array, ""] = field("kg/m", positive)
    """Mass of the rail per length [kg/m]."""
    bed: Pair = field("N/m^2", positive)
    """Stiffness of the bed per length of rail [N/m^2]."""
    damping: Pair = field("N s/m^2", not_negative, default=(0.0, 0.0))
    """Damping of the bed per length of rail [N s/m^2]."""
    ring: float = eqx.field(static=True, default=64.0)
    """Length of rail that is followed, which closes to a ring [m]; shorter for short waves, see `rings`."""
    shortest: float = eqx.field(static=True, default=0.4)
    """Shortest wavelength [m]."""

    even: ClassVar = 4.0
    """Wave number up to which modes are about evenly spaced [rad/m]."""
    absorbed: ClassVar = 4.0
    """Least damping of a wave, as its decay rate times the time in which it goes around its ring [1].

    With these two numbers the 88 waves of the default answer loads of 50 to 2400 Hz as accurately as 160 evenly
    spaced ones, see `tests/benchmarks/test_waves.py`; the highest force of short impacts errs more.
    """

    def __check_init__(self):
        number(positive, "ring", self.ring, "m")
        number(positive, "shortest", self.shortest, "m")
        need = f"be 10 to 10000 times `shortest`, which is {self.shortest:g} m"
        require(10 <= self.ring / self.shortest <= 10_000, "ring", need, self.ring)
        if not is_traced(self):
            ratio = float(np.max(np.asarray(self.damping) / np.sqrt(np.asarray(self.mass * self.bed)))) / 2
            require(ratio < 0.5, "damping", "be below half the critical damping", shown=f"{ratio:.3g} of it")

    @classmethod
    def crane_rail(cls, pounds_per_yard: int = 171, *, bed: Real = 1e8, damping_ratio: Real = 0.02) -> "Beam":
        """Return a rail of steel with an American crane rail's section, of those in `CRANE_RAILS`.

        **Arguments:** `bed`: [N/m^2]; `damping_ratio`: of a rail that moves up and down as a whole [1].
        """
        known = ", ".join(map(str, CRANE_RAILS))
        require(pounds_per_yard in CRANE_RAILS, "pounds_per_yard", f"be one of {known}", pounds_per_yard)
        inertia = np.array(CRANE_RAILS[pounds_per_yard])
        mass = pounds_per_yard * POUND_PER_YARD
        damping = 2 * damping_ratio * (mass * bed) ** 0.5
        return cls(YOUNG_OF_STEEL * inertia * INCH**4, mass, (bed, bed), (damping, damping))

    @property
    def critical_speed(self) -> Pair:
        """Speeds at which a load outruns its waves, lateral and vertical, without damping [m/s]."""
        return (4 * self.bed * self.bending_stiffness / self.mass**2) ** 0.25

    @property
    def _places(self) -> Float[np.ndarray, " modes"]:
        """Places of the modes, one apart: waves come round the ring with their sign turned, so that none moves the
        ring as a whole."""
        count = np.arcsinh(2 * np.pi / self.shortest / self.even) / self._apart
        # modes that fill vector registers
        return np.arange(8 * np.ceil(count / 8)) + 0.5

    @property
    def _apart(self) -> float:
        """Distance of long modes over `even` [1]."""
        return 2 * np.pi / self.ring / self.even

    @property
    def wave_numbers(self) -> Float[np.ndarray, " modes"]:
        """Wave numbers of the modes [rad/m]."""
        return self.even * np.sinh(self._apart * self._places)

    @property
    def rings(self) -> Float[np.ndarray, " modes"]:
        """Length of each mode's ring [m], 2 pi over the distance of neighbouring wave numbers."""
        return self.ring / np.cosh(self._apart * self._places)

    def exponents(self, speed: Real) -> tuple[Array, Array]:
        """Return the exponents of the waves without and with the passage of the ring [1/s], and complex,
        (2 directions, 2 waves, modes)."""
        k = self.wave_numbers[None, None]
        stiffness, bed, damping = (of[:, None, None] for of in (self.bending_stiffness, self.bed, self.damping))
        frequency = jnp.sqrt((stiffness * k**4 + bed) / self.mass)
        group = 2 * stiffness * k**3 / (self.mass * frequency)
        # the first wave runs backwards, and the second one forwards
        sign = np.array([[[1.0], [-1.0]]])
        relative = jnp.abs(group + speed * sign)
        decay = jnp.maximum(damping / (2 * self.mass), self.absorbed / self.rings[None, None] * relative)
        # each wave oscillates, also in a ring that is too short
        decay = jnp.minimum(decay, frequency / 2)
        runs = 1j * sign * jnp.sqrt(frequency**2 - decay**2) - decay
        return jnp.asarray(runs), jnp.asarray(runs + 1j * k * speed)

    def at_rest(self, rails: int, nodes: int) -> RailState:
        """Return the state of straight rails."""
        still = jnp.zeros((2, nodes))
        none = jnp.zeros((rails, 2, 2, len(self.wave_numbers)))
        return RailState(still, still, (none, none))

    def energy(self, waves: Waves, speed: Real) -> Float[Array, " rails"]:
        """Return the energy of each rail and its bed [J]."""
        k = self.wave_numbers
        runs, _ = self.exponents(speed)
        each = waves[0] + 1j * waves[1]
        moved, rate = jnp.sum(each, axis=2), jnp.sum(runs[None] * each, axis=2)
        stiffness = self.bending_stiffness[:, None] * k[None] ** 4 + self.bed[:, None]
        energy = self.mass * jnp.abs(rate) ** 2 + stiffness[None] * jnp.abs(moved) ** 2
        # the mean square of a wave is a half
        return jnp.sum(energy, axis=1) @ (self.rings / 4)

    def step(self, on: Float[np.ndarray, "rails nodes"], places: Array, speed: Real, seconds: Real) -> "RailStep":
        """Return what multiplies the waves in a step.

        **Arguments:** `on`: 1 where a node is on a rail, 0 elsewhere; `places`: of the nodes, ahead of the body's
        centre [m]; `speed`: [m/s]; `seconds`: duration of the step.
        """
        _, exponent = self.exponents(speed)
        shape, between = self._shapes(on, places)
        pushes = self._pushes(exponent)

        def pushed(after: Real, *forms) -> list[Array]:
            """Return the waves after forces that change over some seconds as `forms`, from phi_1 and phi_2."""
            z = exponent * after
            one = (jnp.exp(z) - 1) / z
            two = (one - 1) / z
            return [after * pushes * form(one, two) for form in forms]

        def felt(waves: Array) -> Array:
            """Return deflections and rates that each node gets from each node, (2, 2, nodes, nodes)."""
            both = jnp.stack([waves, exponent * waves], axis=1)
            return jnp.einsum("dabn,jln->dajl", both, between).real

        def of_nodes(waves: Array) -> Waves:
            """Return waves by the force on each node, (nodes, rails, 2, 2, modes)."""
            return pair(jnp.conj(shape).swapaxes(0, 1)[:, :, None, None] * waves[None, None])

        steady = lambda one, two: one
        (half,) = pushed(seconds / 2, steady)
        (whole,) = pushed(seconds, steady)
        # a force linear in time, by its mean and by the mean of the force times the part of the step that is left
        driven = pushed(seconds, lambda one, two: 6 * two - 2 * one, lambda one, two: 6 * one - 12 * two)
        pair = lambda z: (z.real, z.imag)
        return RailStep(
            half=felt(half),
            # for each node and itself alone
            own=jnp.einsum("dbn,jjn->dj", exponent * whole, between).real,
            ends=(felt(driven[0]), felt(driven[1])),
            decay=pair(jnp.exp(exponent * seconds)),
            driven=(of_nodes(driven[0]), of_nodes(driven[1])),
            shape=pair(shape),
            exponent=pair(exponent),
            seconds=seconds,
        )

    def compliance(
        self, on: Float[AnyArray, "rails nodes"], places: Array, speed: Real, rates: Complex[AnyArray, " rates"]
    ) -> Complex[Array, "rates 2 nodes nodes"]:
        """Return deflections at each node by forces exp(s t) at each node [m/N].

        **Arguments:** `rates`: complex s, which grow [1/s]; others as of `step`.
        """
        _, exponent = self.exponents(speed)
        _, between = self._shapes(on, places)
        answer = lambda s: jnp.sum(self._pushes(exponent)[None] / (s[:, None, None, None] - exponent[None]), axis=2)
        of = lambda s: jnp.einsum("sdn,jln->sdjl", answer(s), between)
        # the real part of waves is half the sum of the waves and of their conjugates
        return (of(rates) + jnp.conj(of(jnp.conj(rates)))) / 2

    def _shapes(self, on: AnyArray, places: Array) -> tuple[Array, Array]:
        """Return the modes at the nodes, (rails, nodes, modes), and products of each pair of nodes."""
        turn = jnp.exp(1j * self.wave_numbers[None] * places[:, None])
        shape = jnp.asarray(on)[..., None] * turn[None]
        return shape, jnp.einsum("rjn,rln->jln", shape, jnp.conj(shape))

    def _pushes(self, exponent: Array) -> Array:
        """Return the rates of waves by a force [m/s/N]: a force moves each mode by its share of its ring's mass."""
        share = 2 / (jnp.asarray(self.rings) * self.mass)
        return share[None, None] / (exponent - exponent[:, ::-1])


INCH = 0.0254
"""Metres in an inch."""
POUND_PER_YARD = 0.45359237 / 0.9144
"""kg/m in a pound per yard."""
YOUNG_OF_STEEL = 2.07e11
"""Young's modulus of steel [N/m^2]."""
CRANE_RAILS = {171: (28.0, 73.4)}
"""Second moments of area of crane rails [in^4] by pounds per yard, lateral and vertical.

Makers' tables (Wirth Rail, for CR 171 of ASTM A759) give height and base of 6 in, a head of 4.3 in and a web of
1.25 in. The vertical moment is handed down without a table; British Steel's rail of 86.8 kg/m has 3030 cm^4, 1 %
less. The lateral one is an estimate, good to 5 %: rectangles of head, web and base with these numbers give 26.7 in^4,
and for the rails A75 to A150 1 to 4 % less than British Steel's table. A maker's own numbers go before both.
"""


class RailStep(NamedTuple):
    """What multiplies waves and forces in a step; forces are those on the rail at its nodes, (2, nodes) [N]."""

    half: Float[Array, "2 2 nodes nodes"]
    """Deflection [m/N] and rate [m/s/N] after half the step, of a force that is constant over it."""
    own: Float[Array, "2 nodes"]
    """Rates after the step, of a force at the same node that is constant over it [m/s/N]."""
    ends: tuple[Array, Array]
    """Deflections and rates after the step by the two means of a force, see `driven`."""
    decay: Waves
    """Factors of the waves in the step, (2, 2, modes)."""
    driven: tuple[Waves, Waves]
    """Waves after a force with a mean of 1 N, and with a mean of 1 N of the force times the part of the step that is
    left, (nodes, rails, 2, 2, modes)."""
    shape: Waves
    """Modes at the nodes, (rails, nodes, modes) [1]."""
    exponent: Waves
    """Rates of the waves over the waves [1/s], (2, 2, modes)."""
    seconds: Real
    """Duration of the step [s]."""

    def free(self, waves: Waves) -> RailState:
        """Return the rails after the step without forces."""
        each = lambda of: (of[0][None], of[1][None])  # of all rails
        waves = _times(waves, each(self.decay))
        at_nodes = []
        # all sums in one pass over the modes
        for moves in (waves, _times(waves, each(self.exponent))):
            x, y = (part[:, :, 0] + part[:, :, 1] for part in moves)
            at_nodes += [real[:, None] * x - imag[:, None] * y for real, imag in self._nodes]
        # of each node and direction, from all rails
        deflection, rate = jnp.reshape(jnp.stack(sums(*at_nodes)), (2, len(self._nodes), -1, 2)).sum(2).mT
        deflection, rate = store((deflection, rate))
        return RailState(deflection, rate, waves)

    @property
    def _nodes(self) -> list[Waves]:
        """The modes at each node, (rails, modes)."""
        real, imag = self.shape
        return [(real[:, j], imag[:, j]) for j in range(real.shape[1])]

    def halfway(self, start: RailState, free: RailState) -> RailState:
        """Return the free rails in the middle of the step, by the cubic between both ends."""
        moved = free.deflection - start.deflection
        middle = start.deflection + moved / 2 + self.seconds / 8 * (start.rate - free.rate)
        return RailState(middle, 1.5 / self.seconds * moved - (start.rate + free.rate) / 4, free.waves)

    def end(self, free: RailState, mean: Array, early: Array) -> RailState:
        """Return the rails after forces by their two means, see `driven`."""
        total = free.waves
        for force, driven in zip((mean, early), self.driven, strict=True):
            # one product for each node is faster than the sum of nodes times the response of each wave
            for j in range(force.shape[1]):
                at_node = force[None, :, j, None, None]
                total = tuple(wave + part[j] * at_node for wave, part in zip(total, driven, strict=True))
        moved = RailState(free.deflection, free.rate, store(total))
        return pressed(moved, (self.ends[0], mean), (self.ends[1], early))


def weights_of(rail: RailState) -> RailState:
    """Return the weights of a tangent's parts: waves count in millimetres, of which the other parts are sums."""
    none = jnp.zeros_like(rail.rate)
    wave = jnp.full_like(rail.waves[0], 1e3)
    return RailState(none, none, (wave, wave))


def pressed(free: RailState, *loads: tuple[Array, Array]) -> RailState:
    """Return rails with the deflections and rates at the nodes by forces, each with its compliance."""
    nodes = range(free.deflection.shape[1])
    more = jnp.asarray(sum(each[..., j] * force[:, None, None, j] for each, force in loads for j in nodes))
    # stored, or each contact point would compute it again
    deflection, rate = store((free.deflection + more[:, 0], free.rate + more[:, 1]))
    return RailState(deflection, rate, free.waves)


def _times(a: Waves, b: Waves) -> Waves:
    """Return the product of complex numbers."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]
