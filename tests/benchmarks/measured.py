"""Figures of docs/lab/gradients.md beside its first table.

python -m tests.benchmarks.measured chaos flips restitution
"""

import dataclasses
import sys
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import gmean

import slipperjax as sj
from slipperjax.analysis import PeriodicMotions
from slipperjax.analysis.arclength import Pace
from slipperjax.analysis.critical import CriticalMotions, continue_critical
from slipperjax.model.kinematics import MOTION_SCALES

from ..analysis.systems import TABLE_BOUNDS, TABLE_START, on_table, table_flip
from ..systems.fields import rebound
from .timing import show

Rows = Iterator[dict[str, str]]
STARTS, SETTLING, HORIZON = 64, 200, 1000
"""Motions, forcing periods before the first derivative, and periods that give the exponent."""


def one_period(scene: sj.Scene, state: sj.State, tangent: sj.State) -> tuple[sj.State, sj.State]:
    """Return a state and the derivative of it, a period later."""
    return jax.jvp(lambda s: sj.period_map(scene, s, steps_per_period=50), (state,), (tangent,))


def chaos() -> Rows:
    """Growth of the derivative of the state by the state, beside exp(exponent times periods)."""
    length = lambda tangent: np.sqrt(
        sum(
            np.square(v / size)
            for v, size in zip(*map(jax.tree.leaves, (tangent.motion, MOTION_SCALES)), strict=True)
        )
    )
    step = jax.jit(jax.vmap(one_period, (None, 0, 0)))
    for speed in (1250.0, 2300.0):
        scene = sj.paper_scene(speed)
        start = sj.initial_state(scene, sj.table_2_start())
        states = jax.tree.map(lambda v: jnp.broadcast_to(v, (STARTS, *v.shape)), start)
        # starts that differ, and tangents along their height
        states = sj.State(dataclasses.replace(states.motion, v_y=jnp.linspace(0.4, 0.6, STARTS)), states.memory)
        along = jax.tree.map(jnp.zeros_like, states)
        along = sj.State(dataclasses.replace(along.motion, z=jnp.full(STARTS, 1e-3)), along.memory)
        for _ in range(SETTLING):
            states, _ = step(scene, states, along)
        growth, logarithm, tangent = {}, np.zeros(STARTS), along
        for period in range(1, HORIZON + 1):
            states, tangent = step(scene, states, tangent)
            size = length(tangent)
            logarithm += np.log(size)
            tangent = jax.vmap(lambda tree, size: jax.tree.map(lambda v: v / size, tree))(tangent, size)
            growth[period] = np.exp(logarithm)
        exponent = np.mean(logarithm) / HORIZON
        for period in (10, 20, 40, 80):
            low, high = np.quantile(growth[period], (0.05, 0.95))
            yield {
                "speed [m/s]": f"{speed:.0f}",
                "periods": str(period),
                "derivative, geometric mean": f"{gmean(growth[period]):.2g}",
                "90 % of 64 motions": f"{low:.1g} to {high:.1g}",
                "exp(exponent * periods)": f"{np.exp(exponent * period):.2g}",
            }


def flips() -> Rows:
    """Flips of a ball on a table over acceleration and restitution, beside their closed form."""
    equations = CriticalMotions.of(PeriodicMotions(on_table, jnp.zeros(3), jnp.ones(2)), "PD")
    found = continue_critical(equations, jnp.array(TABLE_START), (1.53, 0.5), TABLE_BOUNDS, pace=Pace(most=0.3))
    order = np.argsort(found.parameters[:, 1])
    chosen = order[np.linspace(0, len(order) - 1, 5).round().astype(int)]
    for amplitude, restitution in found.parameters[chosen]:
        yield {
            "restitution": f"{restitution:.6f}",
            "acceleration / g": f"{amplitude:.11f}",
            "closed form": f"{table_flip(restitution):.11f}",
        }
    worst = np.max(np.abs(found.parameters[:, 0] - table_flip(found.parameters[:, 1])))
    yield {"restitution": f"all {len(order)} points", "acceleration / g": "", "closed form": f"within {worst:.0e}"}


STIFFNESS, RESTITUTION, APPROACHES = 1e8, 0.7, (0.01, 0.1, 1.0, 5.0)
LAWS = {
    "Flores": sj.model.Flores(STIFFNESS, RESTITUTION),
    "HuntCrossley": sj.model.HuntCrossley(STIFFNESS, RESTITUTION),
    "LankaraniNikravesh": sj.model.LankaraniNikravesh(STIFFNESS, RESTITUTION),
    "HertzSpring": sj.model.HertzSpring(STIFFNESS),
    "ConstantDamping": sj.model.ConstantDamping(STIFFNESS, sj.model.HuntCrossley(STIFFNESS, RESTITUTION).factor),
}
"""Contact laws; the hysteresis of the last one is that of Hunt and Crossley's law at 1 m/s."""


def dropped(law: sj.model.AbstractContactLaw, approach: float) -> float:
    """Speed [m/s] with which a slipper leaves a straight rail that it meets flat."""
    plain = sj.paper_scene()
    # four points carry it; the upper side of the play is a millimetre away
    depth = (1.25 * 14.0 * approach**2 / (4 * STIFFNESS)) ** 0.4
    lasts = (1e-3 + 4 * depth) / approach
    scene = sj.Scene(1 / lasts, plain.slipper, plain.section, sj.model.StraightTrack(), law, window=1.0)
    run = sj.simulate(scene, 1, steps_per_period=800, saves_per_period=800, start=sj.Motion(v_z=-approach))
    return float(jnp.max(run.state.motion.v_z))


def restitution() -> Rows:
    """Restitution in an impact of a slipper, over that of the law, or over one for laws without."""
    for name, law in LAWS.items():
        inside = float(getattr(law, "restitution", 1.0))
        ratios = {v: dropped(law, v) / v / inside for v in APPROACHES}
        factors = [float(getattr(law, "factor", getattr(law, "hysteresis", 0.0) * v)) for v in APPROACHES]
        wrong = max(abs(ratio - rebound(c) / inside) for ratio, c in zip(ratios.values(), factors, strict=True))
        yield {
            "law": f"`{name}`",
            **{f"{v:g} m/s": f"{ratio:.4f}" for v, ratio in ratios.items()},
            "from the integral": f"{wrong:.0e}",
        }


def main(*names: str) -> None:
    """Print tables."""
    for name in names:
        show(globals()[name]())


if __name__ == "__main__":
    main(*sys.argv[1:])
