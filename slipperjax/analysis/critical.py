"""Folds, flips and Neimark-Sackers as solutions of extended equations: exact, differentiable, and as curves.

One or two further equations for the multiplier mu = exp(i angle) complete the equations of a motion. The number g of

    (P_x - mu) v + left g = 0,    right^H v = 1

is zero where mu is a multiplier, an eigenvalue of the Jacobian P_x (Govaerts, Numerical Methods for Bifurcations of
Dynamical Equilibria, doi:10.1137/1.9780898719543). The derivative of g is the derivative of w^H P_x v for two fixed
vectors, so that second derivatives of the map are needed along only one direction v.
"""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..tools.checks import instance, one_of, require
from ..tools.compile import call_compiled
from ..tools.tracing import is_transformed
from ..tools.types import Real
from .arclength import Node, Pace, check_within, checked_bounds, correct
from .continuation import Branch, check_found, followed
from .degenerate import PointSearch, resonant_end
from .events import NoSearch, resonance
from .floquet import product, solve
from .newton import AbstractEquations, Linearisation, NullVectors, constant, exact_zero, newton
from .shooting import PeriodicMotions, Shot

CRITICAL_MULTIPLIERS = {"LP": 1.0, "PD": -1.0, "NS": None}
"""Critical multiplier by label; None for a complex pair whose angle is unknown."""
BORDER_UPDATES = 3
"""Number of updates of the borders before Newton's method begins."""


class AbstractExtended(AbstractEquations):
    """Equations of periodic motions, with further equations and unknowns behind those of the motions.

    There is one equation more than there are unknowns of these.
    """

    motions: PeriodicMotions

    @property
    def further(self) -> int:
        """Number of unknowns behind those of the motions, by default none."""
        return 0

    def of_motion(self, z: Array) -> Array:
        """Return the unknowns of the motions."""
        return z[: z.size - self.further]

    def weights(self, z: Array) -> tuple[Array, Array]:
        rows, columns = self.motions.weights(self.of_motion(z))
        return jnp.append(rows, jnp.ones(self.further + 1)), jnp.append(columns, jnp.zeros(self.further))

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        of = self.of_motion(z)
        consistent = self.motions.project(of, self.of_motion(before), residual)
        return jnp.append(consistent, z[of.size :])


class CriticalMotions(AbstractExtended):
    """Periodic motions with a critical multiplier. The unknowns are state, parameters, and for "NS" the angle.

    `null_vectors` of its linearisations are the left and right null vectors of P_x - mu, of weighted length one.
    """

    left: Array
    """Left border of the system of equations, of shape (size,), near the left null vector; `right` likewise."""
    right: Array
    label: str = eqx.field(static=True)
    """One of `CRITICAL_MULTIPLIERS`."""

    @classmethod
    def of(cls, motions: PeriodicMotions, label: str) -> "CriticalMotions":
        """Return the equations with arbitrary borders; `update` replaces these by null vectors."""
        dtype = complex if CRITICAL_MULTIPLIERS[label] is None else float
        one = jnp.asarray(np.random.default_rng(0).standard_normal(motions.size), dtype)
        return cls(motions, one, one, label)

    @property
    def further(self) -> int:
        # the angle of a complex pair
        return int(CRITICAL_MULTIPLIERS[self.label] is None)

    @property
    def size(self) -> int:
        """Number of numbers in a state."""
        return self.motions.size

    def multiplier(self, z: Array) -> Array:
        """Return the critical multiplier."""
        return jnp.exp(1j * z[-1]) if self.further else jnp.asarray(CRITICAL_MULTIPLIERS[self.label])

    def evaluate(self, z: Array) -> Linearisation:
        of = self.of_motion(z)
        mu = self.multiplier(z)
        scale = self._scale(of)
        motion = self.motions.evaluate(of)
        v, w, g = self._null(product(motion.matrices), mu, scale)
        # the derivative of g follows from the derivative of P_x v, along each unknown in turn
        along = lambda t: jax.jvp(lambda of: self._pushed(of, v / scale), (of,), (t,))[1]
        slope = -jax.vmap(along)(jnp.eye(of.size)) @ jnp.conj(w * scale)
        jacobian = motion.jacobian
        if self.further:
            slope = jnp.append(slope, 1j * mu * jnp.vdot(w, v))
            jacobian = jnp.concatenate([jacobian, jnp.zeros((self.size, 1))], axis=1)
        # v and w are weighted components, so that these are weighted lengths of one
        unit = lambda a: a / jnp.linalg.norm(a)
        return Linearisation(
            jnp.concatenate([motion.residual, self._parts(g)]),
            jnp.concatenate([jacobian, self._parts(slope)]),
            motion.matrices,
            (unit(w), unit(v)),
        )

    def update(self, z: Array | np.ndarray, null_vectors: NullVectors) -> "CriticalMotions":
        """Return the equations with the null vectors of a point as borders."""
        left, right = map(jnp.asarray, null_vectors)  # type: ignore[arg-type]
        return dataclasses.replace(self, left=left, right=right)

    def _parts(self, value: Array) -> Array:
        """Return an equation as rows of real equations: two rows for a complex equation."""
        return jnp.stack([value.real, value.imag]) if self.further else value[None].real

    def _scale(self, of: Array) -> Array:
        """Return the weights of the state, with one in place of zero."""
        weights = self.motions.weights(of)[0]
        return jax.lax.stop_gradient(jnp.where(weights > 0, weights, 1.0))

    def _null(self, matrix: Array, mu: Array, scale: Array) -> tuple[Array, Array, Array]:
        """Return the solutions v and w of the bordered system and its adjoint, in scaled components, and g."""
        # the matrix of the module's first equation, bordered by a column and a row
        critical = scale[:, None] * matrix / scale[None] - mu * jnp.eye(self.size)
        last = jnp.zeros(self.size + 1, critical.dtype).at[-1].set(1.0)
        system = jnp.concatenate([critical, self.left[:, None]], axis=1)
        system = jnp.concatenate([system, jnp.append(jnp.conj(self.right), 0.0)[None]])
        ahead = solve(system, last)
        back = solve(jnp.conj(system.T), last)
        return ahead[:-1], back[:-1], ahead[-1]

    def _pushed(self, of: Array, v: Array) -> Array:
        """Return P_x v, the Jacobian times a vector. Pure."""
        # the map of the state only, with fixed parameters
        flow = lambda x: self.motions.mapped(jnp.concatenate([x, of[self.size :]]))
        push = lambda t: jax.jvp(flow, (of[: self.size],), (t,))[1]
        if not self.further:
            return push(v)
        # both parts in one call of the map, which halves the program
        real, imaginary = jax.vmap(push)(jnp.stack([v.real, v.imag]))
        return real + 1j * imaginary


class CriticalMotion(Shot):
    """A periodic motion with a critical multiplier; `residual` is the residual of the extended equations."""

    value: Float[Array, ""]
    """Critical value of the parameter."""
    multiplier: Array


def critical_motion(
    motions: PeriodicMotions,
    label: str,
    state: PyTree,
    value: Real,
    *,
    angle: Real = 0.0,
    tolerance: float = 1e-10,
) -> CriticalMotion:
    """Return the fold, flip or Neimark-Sacker near a motion, by Newton's method on extended equations. Pure.

    The result has the derivatives of the exact solution with respect to all numbers of `motions`, of any order, in
    forward and reverse mode: d(value)/d(number) is the sensitivity of the bifurcation.

    **Arguments:** `motions`: of one parameter; `label`: "LP", "PD" or "NS"; `state`, `value`: first guess of the
    motion and the parameter; `angle`: first guess of the multiplier's angle [rad], for "NS".

    **Returns:** a `CriticalMotion`; check its `residual`.

    **Raises:** `ValueError` for an unknown label.
    """
    one_of("label", label, tuple(CRITICAL_MULTIPLIERS))
    angles = [angle] * CriticalMotions.of(motions, label).further
    z = motions.unknowns(state, value, *angles)
    static = label, is_transformed()
    z, residual, count, matrices, mu = call_compiled(_critical, motions, static, z, jnp.asarray(tolerance, float))
    return CriticalMotion(motions.state(z), residual, count, matrices, motions.values(z)[0], mu)


def _critical(exact: PeriodicMotions, static: tuple, z: Array, tolerance: Array) -> tuple:
    label, differentiable = static
    begin = CriticalMotions.of(exact, label)
    root = constant(lambda: newton(begin, z, tolerance=tolerance, iterations=20, updates=BORDER_UPDATES))
    z = root.z
    now = root.linearisation
    equations = root.equations
    if differentiable:
        equations = dataclasses.replace(equations, motions=exact)
        z = exact_zero(lambda z: equations.evaluate(z).residual, z, now.jacobian)
    return z, root.residual, root.iterations, now.matrices, equations.multiplier(z)


class ConditionedMotions(AbstractExtended):
    """Periodic motions for which a function of state and parameters is zero."""

    condition: Callable[..., Array]
    """`condition(state, *values)`: a differentiable number; a pytree as `PeriodicMotions.family`. A method
    `update(state, *values)`, if any, returns the condition to use near a point of the curve."""
    unit: Real
    """Value of the condition that counts as one in the residual."""

    def evaluate(self, z: Array) -> Linearisation:
        motion = self.motions.evaluate(z)
        # the condition, with its derivative along each unknown in turn
        condition = lambda z: self.condition(self.motions.state(z), *self.motions.values(z)) / self.unit
        value, slope = jax.vmap(lambda t: jax.jvp(condition, (z,), (t,)), out_axes=(None, 0))(jnp.eye(z.size))
        jacobian = jnp.concatenate([motion.jacobian, slope[None]])
        return motion._replace(residual=jnp.append(motion.residual, value), jacobian=jacobian)

    def update(self, z: Array | np.ndarray, null_vectors: NullVectors) -> "ConditionedMotions":
        if not hasattr(self.condition, "update"):
            return self
        return dataclasses.replace(self, condition=call_compiled(_updated, self, (), jnp.asarray(z)))


def _updated(equations: ConditionedMotions, static: tuple, z: Array):
    motions = equations.motions
    return equations.condition.update(motions.state(z), *motions.values(z))  # type: ignore[attr-defined]


def continue_critical(
    equations: CriticalMotions | ConditionedMotions,
    state: PyTree | Node,
    values: tuple[Real, Real] | None,
    bounds: tuple[tuple[float, float], tuple[float, float]],
    *,
    angle: Real = 0.0,
    ways: Sequence[int] = (1, -1),
    tolerance: float = 1e-10,
    pace: Pace = Pace(),
    **options: object,
) -> Branch:
    """Follow folds, flips, Neimark-Sackers or motions with a condition in the plane of two parameters.

    **Arguments:** `equations`: of motions with two parameters, for critical motions
    `CriticalMotions.of(motions, label)`; `state`, `values`: first guess of a motion of the curve, whose second value
    is kept fixed, or a point of `switch_critical` and None; `angle`: first guess of the multiplier's angle [rad], for
    "NS"; `bounds`: of both parameters; `ways`, `tolerance`, `pace`: as for `continue_motion`; `options`: `points`,
    `until` and `on_point` of `extend`.

    **Returns:** a `Branch`. The `events` of critical motions are the points of codimension two, with their `values`,
    `state` and `coefficients`, see `normal_form`. A curve of Neimark-Sackers ends inside the bounds at the strong
    resonances 1:1 and 1:2, where the complex pair becomes real and curves of folds and flips pass. The reason of this
    end is "strong resonance 1:1", for example.

    **Raises:** `ValueError` where there is no such motion near the start, or where the bounds do not contain it.
    """
    instance("equations", equations, (CriticalMotions, ConditionedMotions), "CriticalMotions or ConditionedMotions")
    size = equations.motions.size
    limits = [checked_bounds(pair) for pair in bounds]
    if isinstance(state, Node):
        first = state
    else:
        require(values is not None, "values", "be the values of both parameters", values)
        assert values is not None
        z = equations.motions.unknowns(state, *values, *[angle] * equations.further)
        first = located(equations, z, jnp.zeros(z.size).at[size + 1].set(1.0), tolerance=tolerance)
    check_found("state", "a motion of the curve", first, tolerance)
    for value, pair in zip(first.z[size:], limits, strict=False):
        check_within("values", value, pair)
    if equations.further:
        # At the angles 0 and pi the equations hold on whole curves of folds and flips. Therefore the curve ends 1e-3
        # before these angles; the error of the parameters there is the square of this distance.
        pair = np.pi * np.floor(first.z[-1] / np.pi) + [1e-3, np.pi - 1e-3]
        limits.append(tuple(pair))
    options |= dict(search=PointSearch if isinstance(equations, CriticalMotions) else NoSearch)
    near = equations.update(first.z, first.null_vectors)
    curve = followed(near, first, *limits, ways=ways, tolerance=tolerance, pace=pace, **options)
    # both ends in turn
    for _ in range(2):
        curve = _resonant(curve, bounds, tolerance).turned() if equations.further else curve
    return curve


def located(equations: CriticalMotions | ConditionedMotions, z: Array, row: Array, **options: float) -> Node:
    """Return the point of a curve near `z` on the plane across `row`; equations with arbitrary borders converge, too.

    **Arguments:** `options`: as for `correct`.
    """
    # The borders become null vectors at the start. With zero iterations `correct` only evaluates the equations; its
    # program is needed later in any case.
    for _ in range(BORDER_UPDATES):
        equations = equations.update(z, correct(equations, z, row, iterations=0, **options).null_vectors)
    return correct(equations, z, row, iterations=20, **options)


def _resonant(curve: Branch, bounds: tuple[tuple[float, float], tuple[float, float]], tolerance: float) -> Branch:
    """Return a curve of Neimark-Sackers with its last point at the strong resonance where the pair becomes real."""
    *nodes, last = curve.nodes
    back, end = curve.ends
    # the curve ends within the parameters' bounds, at the bound of the angle
    inside = all(low < value < high for value, (low, high) in zip(curve.parameters[-1], bounds, strict=True))
    near_to = resonance(last.z[-1])
    if not (inside and near_to in ("1:1", "1:2") and end.reason in ("bound", "no convergence")):
        return curve
    event = resonant_end(curve.equations, last, tolerance)
    # in place of the end at the bound
    events = *curve.events[:-1], event
    ends = back, end._replace(reason=f"strong resonance {near_to}")
    return dataclasses.replace(curve, nodes=(*nodes, event.node), events=events, ends=ends)
