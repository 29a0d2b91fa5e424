"""Folds, flips and Neimark-Sackers as solutions of extended equations: exact, differentiable, and as curves.

The motion's equations are completed by one or two for its multiplier mu = exp(i angle): the number g of

    (P_x - mu) v + left g = 0,    right^H v = 1

is zero where mu is a multiplier (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria,
doi:10.1137/1.9780898719543). Its derivative is that of P_x along two fixed vectors, so that second derivatives of the
map are needed along one direction only.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import one_of
from ..tools.compile import call_compiled, is_transformed
from .continuation import Branch, begun, check_found, extend
from .curves import Pace, check_within, checked_bounds, correct
from .events import observed, resonance
from .floquet import product, solve
from .newton import AbstractEquations, Linearisation, newton, without_derivatives
from .shooting import PeriodicMotions, Shot

CRITICAL_MULTIPLIERS = {"LP": 1.0, "PD": -1.0, "NS": None}
"""The critical multiplier by label; None for a pair of unknown angle."""
BORDER_UPDATES = 3
"""Updates of the borders before Newton's method begins."""


class CriticalMotions(AbstractEquations):
    """Periodic motions with a critical multiplier. The unknowns are state, parameters, and for "NS" its angle.

    The null vectors of its linearisations are those of P_x - mu from the left and the right, of weighted length one.
    """

    motions: PeriodicMotions
    left: Array
    """Borders, near the null vectors, of shape (size,)."""
    right: Array
    label: str = eqx.field(static=True)
    """One of `CRITICAL_MULTIPLIERS`."""

    @classmethod
    def of(cls, motions: PeriodicMotions, label: str) -> "CriticalMotions":
        """Return them with arbitrary borders; those of evaluations are better, see `update`."""
        dtype = complex if CRITICAL_MULTIPLIERS[label] is None else float
        one = jnp.asarray(np.random.default_rng(0).standard_normal(motions.size), dtype)
        return cls(motions, one, one, label)

    @property
    def angled(self) -> bool:
        """True where the multiplier's angle is an unknown."""
        return CRITICAL_MULTIPLIERS[self.label] is None

    @property
    def size(self) -> int:
        """Numbers in a state."""
        return self.motions.size

    def multiplier(self, z: Array) -> Array:
        """Return the critical multiplier."""
        return jnp.exp(1j * z[-1]) if self.angled else jnp.asarray(CRITICAL_MULTIPLIERS[self.label])

    def evaluate(self, z: Array) -> Linearisation:
        of = self._of_motion(z)
        mu = self.multiplier(z)
        scale = self._scale(z)
        motion = self.motions.evaluate(of)
        v, w, g = self._null(product(motion.matrices), mu, scale)
        # the derivative of g is that of P_x v, along each unknown in turn
        along = lambda t: jax.jvp(lambda of: self._pushed(of, v / scale), (of,), (t,))[1]
        slope = -jax.vmap(along)(jnp.eye(of.size)) @ jnp.conj(w * scale)
        jacobian = motion.jacobian
        if self.angled:
            slope = jnp.append(slope, 1j * mu * jnp.vdot(w, v))
            jacobian = jnp.concatenate([jacobian, jnp.zeros((self.size, 1))], axis=1)
        unit = lambda a: a / jnp.linalg.norm(a)
        return Linearisation(
            jnp.concatenate([motion.residual, self._parts(g)]),
            jnp.concatenate([jacobian, self._parts(slope)]),
            motion.matrices,
            (unit(w), unit(v)),
        )

    def defect(self, z: Array, null_vectors: tuple[Array, Array]) -> Array:
        """Return the residual for fixed null vectors. Its derivatives are those of the exact equations. Pure."""
        of = self._of_motion(z)
        scale = self._scale(z)
        mu = self.multiplier(z)
        left, right = jax.lax.stop_gradient(null_vectors)
        miss = jnp.vdot(left * scale, self._pushed(of, right / scale) - mu * right / scale)
        factor = jnp.vdot(left, self.left) * jnp.vdot(self.right, right)  # of w and v over their lengths
        return jnp.concatenate([self.motions.mapped(of) - of[: self.size], self._parts(-miss / factor)])

    def weights(self, z: Array) -> tuple[Array, Array]:
        rows, columns = self.motions.weights(self._of_motion(z))
        more = 2 if self.angled else 1
        return jnp.append(rows, jnp.ones(more)), jnp.append(columns, jnp.zeros(more - 1))

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        of = self.motions.project(self._of_motion(z), self._of_motion(before), residual[: self.size])
        return jnp.append(of, z[-1]) if self.angled else of

    def update(self, z: Any, null_vectors: tuple[Any, Any]) -> "CriticalMotions":
        """Return the equations with the null vectors of a point as borders."""
        left, right = map(jnp.asarray, null_vectors)
        return dataclasses.replace(self, left=left, right=right)

    def _of_motion(self, z: Array) -> Array:
        """Return the unknowns of the motion's equations."""
        return z[:-1] if self.angled else z

    def _parts(self, value: Array) -> Array:
        """Return one equation as one or two real ones, in rows."""
        return jnp.stack([value.real, value.imag]) if self.angled else value[None].real

    def _scale(self, z: Array) -> Array:
        """Return the weights of the state, one where they are zero."""
        weights = self.motions.weights(self._of_motion(z))[0]
        return jax.lax.stop_gradient(jnp.where(weights > 0, weights, 1.0))

    def _null(self, matrix: Array, mu: Array, scale: Array) -> tuple[Array, Array, Array]:
        """Return the vectors v and w of the bordered systems, in scaled components, and the number g."""
        # the matrix of the module's first equation, bordered by a column and a row
        critical = scale[:, None] * matrix / scale[None] - mu * jnp.eye(self.size)
        last = jnp.zeros(self.size + 1, critical.dtype).at[-1].set(1.0)
        system = jnp.concatenate([critical, self.left[:, None]], axis=1)
        system = jnp.concatenate([system, jnp.append(jnp.conj(self.right), 0.0)[None]])
        ahead = solve(system, last)
        back = solve(jnp.conj(system.T), last)
        return ahead[:-1], back[:-1], ahead[-1]

    def _pushed(self, of: Array, v: Array) -> Array:
        """Return P_x v. Pure."""
        # the map of the state alone, at fixed parameters
        flow = lambda x: self.motions.mapped(jnp.concatenate([x, of[self.size :]]))
        push = lambda t: jax.jvp(flow, (of[: self.size],), (t,))[1]
        if not self.angled:
            return push(v)
        # in one, because that is half the program
        real, imaginary = jax.vmap(push)(jnp.stack([v.real, v.imag]))
        return real + 1j * imaginary


class CriticalMotion(Shot):
    """A periodic motion with a critical multiplier; `residual` is that of the extended equations."""

    value: Float[Array, ""]
    """The parameter's value at which it has it."""
    multiplier: Array


def critical_motion(
    motions: PeriodicMotions,
    label: str,
    state: Any,
    value: Any,
    *,
    angle: Any = 0.0,
    tolerance: float = 1e-10,
) -> CriticalMotion:
    """Return the fold, flip or Neimark-Sacker near a motion, by Newton's method on extended equations. Pure.

    The result has the derivatives of the exact one with respect to all numbers of `motions`, in both modes: of
    d(value)/d(number) the sensitivity of a bifurcation.

    **Arguments:** `motions`: of one parameter; `label`: "LP", "PD" or "NS"; `state`, `value`: near it; `angle`: of
    the multiplier in radians, for "NS".

    **Returns:** a `CriticalMotion`; look at its `residual`.

    **Raises:** `ValueError` for an unknown label.
    """
    one_of("label", label, tuple(CRITICAL_MULTIPLIERS))
    angles = [angle] if CRITICAL_MULTIPLIERS[label] is None else []
    z = motions.unknowns(state, value, *angles)
    static = label, is_transformed()
    z, residual, count, matrices, mu = call_compiled(_critical, motions, static, z, jnp.asarray(tolerance, float))
    return CriticalMotion(motions.state(z), residual, count, matrices, motions.values(z)[0], mu)


def _critical(exact: PeriodicMotions, static: tuple, z: Array, tolerance: Array) -> tuple:
    label, differentiable = static
    begin = CriticalMotions.of(without_derivatives(exact), label)
    guess = jax.lax.stop_gradient(z)
    root = newton(begin, guess, tolerance=tolerance, iterations=20, updates=BORDER_UPDATES)
    z = root.z
    now = root.linearisation
    equations = root.equations
    if differentiable:
        # one more step, of no length, with the derivatives of the exact solution
        miss = dataclasses.replace(equations, motions=exact).defect(z, now.null_vectors)
        z = z - solve(now.jacobian, miss - jax.lax.stop_gradient(miss))
    return z, root.residual, root.iterations, now.matrices, equations.multiplier(z)


class ConditionedMotions(AbstractEquations):
    """Periodic motions on which a function of state and parameters vanishes."""

    motions: PeriodicMotions
    condition: Callable[..., Array]
    """`condition(state, *values)`: a number, differentiable; a pytree as `PeriodicMotions.family`. Where it has a
    method `update(state, *values)`, that gives the condition for the neighbourhood of a point of the curve."""
    unit: Any
    """Value of the condition that counts as one."""

    def evaluate(self, z: Array) -> Linearisation:
        motion = self.motions.evaluate(z)
        # the condition, with its derivative along each unknown in turn
        condition = lambda z: self.condition(self.motions.state(z), *self.motions.values(z)) / self.unit
        value, slope = jax.vmap(lambda t: jax.jvp(condition, (z,), (t,)), out_axes=(None, 0))(jnp.eye(z.size))
        jacobian = jnp.concatenate([motion.jacobian, slope[None]])
        return motion._replace(residual=jnp.append(motion.residual, value), jacobian=jacobian)

    def weights(self, z: Array) -> tuple[Array, Array]:
        rows, columns = self.motions.weights(z)
        return jnp.append(rows, 1.0), columns

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        return self.motions.project(z, before, residual)

    def update(self, z: Any, null_vectors: Any) -> "ConditionedMotions":
        if not hasattr(self.condition, "update"):
            return self
        return dataclasses.replace(self, condition=call_compiled(_updated, self, (), jnp.asarray(z)))


def _updated(equations: ConditionedMotions, static: tuple, z: Array):
    motions = equations.motions
    return equations.condition.update(motions.state(z), *motions.values(z))  # type: ignore[attr-defined]


def continue_critical(
    equations: CriticalMotions | ConditionedMotions,
    state: Any,
    values: tuple[Any, Any],
    bounds: tuple[tuple[float, float], tuple[float, float]],
    *,
    angle: Any = 0.0,
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    **options: Any,
) -> Branch:
    """Follow folds, flips, Neimark-Sackers or motions with a condition through the plane of two parameters.

    **Arguments:** `equations`: of motions with two parameters, `CriticalMotions.of(motions, label)` for critical
    ones; `state`, `values`: near a motion of the curve, of which the second value is kept; `angle`: of the
    multiplier in radians, for "NS"; `bounds`: of both parameters; `tolerance`, `pace`: as for `continue_motion`;
    `options`: `points` and `on_point` of it.

    **Returns:** a `Branch` without bifurcations. One of Neimark-Sackers ends inside the bounds at the strong
    resonances 1:1 and 1:2, where the pair becomes real and curves of folds and flips pass; its reason is "strong
    resonance 1:1", for example.

    **Raises:** `ValueError` where there is no such motion near the start, or the bounds do not hold it.
    """
    size = equations.motions.size
    limits = [checked_bounds(pair) for pair in bounds]
    angles = [angle] if isinstance(equations, CriticalMotions) and equations.angled else []
    z = equations.motions.unknowns(state, *values, *angles)
    row = jnp.zeros(z.size).at[size + 1].set(1.0)
    # to null vectors of the start as borders, by the program that corrects, of which the equations are most
    for _ in range(BORDER_UPDATES):
        equations = equations.update(z, correct(equations, z, row, tolerance=tolerance, iterations=0).null_vectors)
    first = correct(equations, z, row, tolerance=tolerance, iterations=20)
    check_found("state", "a motion of the curve", first, tolerance)
    for value, pair in zip(first.z[size:], limits, strict=False):
        check_within("values", value, pair)
    if angles:
        # At 0 and pi the equations hold on whole curves of folds and flips. The parameters are off by the square of
        # the distance from there at which the curve ends.
        pair = np.pi * np.floor(first.z[-1] / np.pi) + [1e-3, np.pi - 1e-3]
        limits.append(tuple(pair))
    begin = begun(equations.update(first.z, first.null_vectors), observed(first, None), pace)
    curve = extend(begin, *limits, tolerance=tolerance, pace=pace, locate=False, **options)
    if not angles:
        return curve
    ends = []
    for end, node in zip(curve.ends, (curve.nodes[0], curve.nodes[-1]), strict=True):
        # a pair became real where the curve ends within the bounds of the parameters
        inside = all(low < value < high for value, (low, high) in zip(node.z[size:], bounds, strict=False))
        near_to = resonance(node.z[-1])
        became_real = inside and near_to and end.reason in ("bound", "no convergence")
        ends.append(end._replace(reason=f"strong resonance {near_to}") if became_real else end)
    return dataclasses.replace(curve, ends=tuple(ends))
