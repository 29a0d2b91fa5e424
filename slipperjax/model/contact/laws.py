"""Normal force laws of a contact point.

Laws follow Eq. (12) of Dang et al. 2024,

    F = K d^(3/2) (1 + c g' / g'_0),       d = -g > 0,

with g the gap [m], g' its rate [m/s] and g'_0 < 0 that rate at touchdown, when the contact began. The laws of the
family differ in c alone. g'_0 is a memory of the contact, see `slipperjax.model.contact.memory`.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...tools import ShapeChecked, fraction, not_negative, positive, yes_or_no


def zero_safe_sqrt(x: Array) -> Array:
    """Square root, with a derivative of zero instead of infinity at zero."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0)


class AbstractContactLaw(ShapeChecked):
    """Normal force of a point from its gap, the gap's rate, and the ratio of that rate to the rate at touchdown."""

    stiffness: eqx.AbstractVar[Float[Array, ""]]
    clamp: eqx.AbstractVar[bool]

    @property
    @abc.abstractmethod
    def has_memory(self) -> bool:
        """Whether the force depends on the rate at touchdown."""

    @abc.abstractmethod
    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        """The damping force as a multiple of the elastic force [1].

        **Arguments:** `rate`: g' [m/s]; `rate_ratio`: g' / g'_0 [1], None for a law without memory.
        """

    def __check_init__(self):
        yes_or_no("clamp", self.clamp)

    def force(self, gap: Array, rate: Array, rate_ratio: Array | None) -> Array:
        """Normal force [N]; zero where the gap is open.

        **Arguments:** `gap`: g [m]; `rate`: g' [m/s]; `rate_ratio`: g' / g'_0 [1] or None. All have the same shape.
        """
        depth = jnp.maximum(-gap, 0.0)
        # sqrt(depth) with a finite derivative at zero; the factor `depth` makes the product zero there
        root = jnp.sqrt(jnp.where(depth > 0, depth, 1.0))
        force = self.stiffness * depth * root * (1 + self.damping(rate, rate_ratio))
        return jnp.maximum(force, 0.0) if self.clamp else force

    def elastic_energy(self, gap: Array) -> Array:
        """Energy stored in the elastic part of the force [J], in the shape of `gap` [m]."""
        depth = jnp.maximum(-gap, 0.0)
        return 0.4 * self.stiffness * depth**2 * zero_safe_sqrt(depth)


class _RestitutionLaw(AbstractContactLaw):
    """Laws whose damping follows from a coefficient of restitution."""

    stiffness: Float[Array, ""] = eqx.field(converter=positive("stiffness", "N/m^1.5"))
    """Generalised stiffness K [N/m^1.5]."""
    restitution: Float[Array, ""] = eqx.field(converter=fraction("restitution"))
    """Coefficient of restitution c_r [1], in (0, 1]."""
    clamp: bool = eqx.field(static=True, default=True)
    """Whether the force is limited to F >= 0. The paper has no such limit."""

    @property
    def has_memory(self) -> bool:
        return True

    @property
    @abc.abstractmethod
    def factor(self) -> Float[Array, ""]:
        """c of Eq. (12) [1]."""

    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        del rate
        assert rate_ratio is not None  # callers pass it to laws with memory
        return self.factor * rate_ratio


class Flores(_RestitutionLaw):
    """Flores et al. 2011, doi:10.1007/s11044-010-9237-4; the paper's law: c = 8 (1 - c_r) / (5 c_r)."""

    @property
    def factor(self):
        return 8 * (1 - self.restitution) / (5 * self.restitution)


class HuntCrossley(_RestitutionLaw):
    """Hunt and Crossley 1975, doi:10.1115/1.3423596: c = 3 (1 - c_r) / 2."""

    @property
    def factor(self):
        return 1.5 * (1 - self.restitution)


class LankaraniNikravesh(_RestitutionLaw):
    """Lankarani and Nikravesh 1990, doi:10.1115/1.2912617: c = 3 (1 - c_r^2) / 4."""

    @property
    def factor(self):
        return 0.75 * (1 - self.restitution**2)


class HertzSpring(AbstractContactLaw):
    """F = K d^(3/2): no damping and no memory."""

    stiffness: Float[Array, ""] = eqx.field(converter=positive("stiffness", "N/m^1.5"))
    """Generalised stiffness K [N/m^1.5]."""

    @property
    def clamp(self) -> bool:
        return False  # the force is never negative

    @property
    def has_memory(self) -> bool:
        return False

    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        return 0.0


class ConstantDamping(AbstractContactLaw):
    """F = K d^(3/2) (1 - chi g'), with the same chi for every impact, hence no memory."""

    stiffness: Float[Array, ""] = eqx.field(converter=positive("stiffness", "N/m^1.5"))
    """Generalised stiffness K [N/m^1.5]."""
    hysteresis: Float[Array, ""] = eqx.field(converter=not_negative("hysteresis", "s/m"))
    """Damping per approach rate chi [s/m]."""
    clamp: bool = eqx.field(static=True, default=True)
    """Whether the force is limited to F >= 0."""

    @property
    def has_memory(self) -> bool:
        return False

    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        return -self.hysteresis * rate
