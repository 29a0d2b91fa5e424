"""The method of the paper, Eqs. (15)-(20) of Dang et al. 2024 (MBDyn's "ms"), with the event latch.

An implicit two-step method of second order, A-stable; each step multiplies infinitely stiff components by |rho_inf|.
The first step is Crank-Nicolson. Newton's method uses the exact Jacobian in each iteration.

With variable steps, h in Eq. (15) is the PREVIOUS step. With alpha = h_k / h_(k-1) the weights of (19) sum to
alpha + beta, so that they are consistent only in this unit. Here the weights are divided by alpha.
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from diffrax import RESULTS

from ..model.dynamics import State
from ..model.kinematics import scaled_size
from ..model.linearised import LinearSystem
from ..tools.checks import number, positive, require, whole
from ..tools.types import Real
from .latching import AbstractLatchingSolver, dense_info, field_of


def two_step_weights(rho_inf: float, alpha: Real) -> tuple[Real, ...]:
    """Return a_1, a_2, b_0, b_1, b_2 of Eqs. (19)-(20), the last three per present step.

    **Arguments:** `rho_inf`: see `TwoStep`; `alpha`: the present step over the previous one.
    """
    damped = (1 - abs(rho_inf)) ** 2
    bottom = 2 * (1 + alpha) - damped
    beta = alpha * ((2 + alpha) * damped + 2 * (1 + alpha) * (2 * abs(rho_inf) - 1)) / bottom
    chi = alpha**2 * damped / (2 * bottom)
    b_0 = chi / alpha + alpha / 2
    b_1 = beta / 2 + alpha / 2 - (1 + alpha) * chi / alpha
    b_2 = beta / 2 + chi
    return 1 - beta, beta, b_0 / alpha, b_1 / alpha, b_2 / alpha


class TwoStep(AbstractLatchingSolver, diffrax.AbstractAdaptiveSolver):
    """The paper's method, with its settings as defaults.

    The latch does not change the derivative stored from the previous step: a touchdown changes only the derivative at
    the present step's start. The error estimate is the distance from the explicit two-step predictor, so that
    adaptive steps are possible, but not efficient.
    """

    rho_inf: float = eqx.field(static=True, default=0.6)
    """Factor of infinitely stiff components per step [1], from 0 (full damping) to 1 (none)."""
    tolerance: float = eqx.field(static=True, default=1e-6)
    """Newton's method ends one iteration after a correction below this, in multiples of
    `slipperjax.model.MOTION_SCALES`.
    """
    iterations: int = eqx.field(static=True, default=10)
    """Newton iterations after which a step has failed."""

    def __check_init__(self):
        is_share = isinstance(self.rho_inf, float | int) and 0 <= self.rho_inf <= 1
        require(is_share, "rho_inf", "be from 0 to 1", self.rho_inf)
        number(positive, "tolerance", self.tolerance)
        whole("iterations", self.iterations, 1)

    def order(self, terms):
        return 2

    def error_order(self, terms):
        return 3.0

    def init(self, terms, t0, t1, y0, args):
        field = field_of(terms)
        rates = field.evaluate(t0, y0, args)
        if rates.memory is not None:
            raise ValueError(
                "Argument `solver` must be another one than TwoStep for a scene with memory=SmoothSwitch(): it "
                "integrates the motion alone. RK4 and ROS34PW2 integrate the memory too."
            )
        # an infinite previous step marks the first step
        return rates, field.open_step(t0, y0, args), (y0.motion, rates.motion, jnp.asarray(jnp.inf))

    @jax.jit  # diffrax traces it more than once
    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        field = field_of(terms)
        h = t1 - t0
        rates, before, (earlier, earlier_rates, earlier_step) = solver_state
        first = jnp.isinf(earlier_step)
        alpha = jnp.where(first, 1.0, h / jnp.where(first, 1.0, earlier_step))
        crank_nicolson = (1.0, 0.0, 0.5, 0.5, 0.0)
        weights = two_step_weights(self.rho_inf, alpha)
        choose = lambda c, w: jnp.where(first, c, w)
        a1, a2, b0, b1, b2 = map(choose, crank_nicolson, weights)
        of_two_steps = lambda x1, x2, f1, f2: a1 * x1 + a2 * x2 + h * (b1 * f1 + b2 * f2)
        explicit = jax.tree.map(of_two_steps, y0.motion, earlier, rates.motion, earlier_rates)
        # in the first step there is no earlier derivative
        bend = jnp.where(first, 0.0, 0.5 * alpha)
        predictor = lambda x, f1, f2: x + h * (f1 + bend * (f1 - f2))
        guess = jax.tree.map(predictor, y0.motion, rates.motion, earlier_rates)

        still = lambda tree: jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_inexact_array(a) else a, tree)

        def correction(x, explicit, args, memory):
            """Return Newton's correction at x."""
            at = State(x, memory)
            f = field.evaluate(t1, at, args).motion
            residual = jax.tree.map(lambda k, x, f: k + h * b0 * f - x, explicit, x, f)
            return LinearSystem(still(field.linearised(t1, at, args)), still(h * b0)).solve(residual)

        fixed = still((explicit, args, y0.memory))
        again = lambda carry: (carry[1] > self.tolerance) & (carry[2] < self.iterations)

        def iterate(carry):
            x, _, count = carry
            dx = correction(x, *fixed)
            return jax.tree.map(jnp.add, x, dx), scaled_size(dx), count + 1

        x, size, _ = jax.lax.while_loop(again, iterate, (still(guess), jnp.asarray(jnp.inf), 0))
        # One more iteration adds the derivatives of the implicit function, because x itself has none.
        x = jax.tree.map(jnp.add, x, correction(still(x), explicit, args, y0.memory))
        # in this form NaN does not count as convergence
        result = RESULTS.where(
            size <= self.tolerance,
            RESULTS.successful,
            RESULTS.nonlinear_max_steps_reached,
        )
        y1, rates1, after = field.close_step(before, t0, t1, State(x, y0.memory), args)
        apart = jax.tree.map(lambda a, b: jnp.abs(a - b) / 6, x, guess)
        error = State(apart, jax.tree.map(jnp.zeros_like, y0.memory))
        dense = dense_info(h, y0, y1, rates, rates1)
        return y1, error, dense, (rates1, after, (y0.motion, rates.motion, jnp.asarray(h, float))), result
