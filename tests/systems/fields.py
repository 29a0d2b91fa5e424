"""Right-hand sides of slippers with solutions in closed form, for solvers: a smooth one, and a ball's impact."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import slipperjax as sj
from slipperjax.model.contact import Before
from slipperjax.model.dynamics import VectorField, contact_forces
from slipperjax.model.kinematics import Contacts, attitude_rates
from slipperjax.model.linearised import Linearised

SPIN = np.array([0.4, -0.3, 0.2])


class Smooth(VectorField):
    """y = sin t, forced and damped; z = 1 / (2 - t), which solves z'' = 2 z^3; a constant spin."""

    scene = sj.paper_scene(speed=8.0)  # a forcing period of one second

    def evaluate(self, t, state, args, frame=None):
        m = state.motion
        a_y = -9 * m.y - 0.5 * m.v_y + 8 * jnp.sin(t) + 0.5 * jnp.cos(t)
        zero = 0 * m.y
        return sj.State(sj.Motion(m.v_y, m.v_z, *attitude_rates(m), a_y, 2 * m.z**3, zero, zero, zero), None)

    def open_step(self, t0, state, args):
        return None  # there is no contact

    def linearised(self, t, state, args):
        stiffness = {(0, 0): -9.0, (1, 1): 6 * state.motion.z**2}
        return _linearised(stiffness, {(0, 0): -0.5}, state, args)

    @staticmethod
    def exact(t):
        rate = np.linalg.norm(SPIN)
        q = np.sin(rate * t / 2) * SPIN / rate
        return np.array([np.sin(t), 1 / (2 - t), *q, np.cos(t), 1 / (2 - t) ** 2, *SPIN])


class Ball(VectorField):
    """A ball that falls on a plane: its gap is z, law and memory of the contact are the scene's, there is no weight.

    It touches down at an instant within a step, like a slipper, and its rebound follows from `rebound`.
    """

    def evaluate(self, t, state, args, frame=None):
        m, scene = state.motion, args.scene
        force = contact_forces(scene, Contacts(m.z[None], m.v_z[None], ()), state.memory)[0]
        zero = 0 * m.y
        rates = sj.Motion(m.v_y, m.v_z, zero, zero, zero, zero, force / scene.slipper.mass, zero, zero, zero)
        return sj.State(jax.tree.map(lambda rate: scene.period * rate, rates), None)

    def linearised(self, t, state, args):
        force = lambda z, v: contact_forces(args.scene, Contacts(z[None], v[None], ()), state.memory)[0]
        share = args.scene.period / args.scene.slipper.mass
        by_gap, by_rate = jax.grad(force, (0, 1))(state.motion.z, state.motion.v_z)
        return _linearised({(1, 1): share * by_gap}, {(1, 1): share * by_rate}, state, args)

    def open_step(self, t0, state, args):
        gap, rate = state.motion.z[None], state.motion.v_z[None]
        return Before(gap, rate, rate, jnp.asarray(jnp.inf))

    def close_step(self, before, t0, t1, state, args, frame=None):
        step = t1 - t0
        gap, rate = state.motion.z[None], state.motion.v_z[None]
        latched = args.scene.contact_memory.latch(
            state.memory, before, gap, rate, step * args.scene.period, step / before.step
        )
        state = sj.State(state.motion, latched)
        return state, self.evaluate(t1, state, args), Before(gap, rate, before.rate, step)


def _linearised(stiffness, damping, state, args):
    """From the entries that are not zero."""
    rows = lambda entries: [[entries.get((i, k), 0.0) for k in range(5)] for i in range(5)]
    return Linearised(rows(stiffness), rows(damping), state.motion, args.scene.period)


def rebound(factor, stored=0.0):
    """Rebound over approach speed e of F = K d^1.5 (1 + c v/v0), from a depth that stores `stored` times m v0^2 / 2.

    m v dv = -K d^1.5 (1 + c v/v0) dd gives: integral of u / (1 + c u) from -e to 1 is -stored / 2.
    """
    if factor == 0:
        return math.sqrt(1 + stored)
    return brentq(lambda e: _missed(e, factor, np.log1p) + stored / 2, 0.0, min(9.0, (1 - 1e-12) / factor))


def _missed(e, factor, log1p):
    primitive = lambda u: u / factor - log1p(factor * u) / factor**2
    return primitive(1.0) - primitive(-e)


def rebound_slope(factor):
    """Derivative of `rebound` with respect to the factor c > 0."""
    missed = lambda e, factor: _missed(e, factor, jnp.log1p)
    by_e, by_factor = jax.grad(missed, (0, 1))(rebound(factor), float(factor))
    return -float(by_factor / by_e)


def depth(factor, mass, approach, stiffness):
    """Greatest penetration [m] of an impact with the law of `rebound`."""
    share = (1 - np.log1p(factor) / factor) / factor if factor > 0 else 0.5
    return (2.5 * mass * approach**2 * share / stiffness) ** 0.4
