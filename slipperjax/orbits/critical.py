"""Orbits at which something happens: exact and differentiable, and followed through the plane of two parameters."""

import dataclasses
from pathlib import Path
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..analysis.critical import ConditionedMotions, CriticalMotions, continue_critical, critical_motion
from ..analysis.curves import Curve, Pace
from ..analysis.events import Node
from ..analysis.floquet import multipliers
from ..flow.datasets import run_attributes, scene_attributes
from ..flow.load import load_call, varied_names
from ..flow.period_map import PeriodMap
from ..flow.record import RecordSet
from ..flow.simulate import dynamic_steps, static_steps
from ..flow.status import Interrupted
from ..model.dynamics import State
from ..model.paths import parameter
from ..model.quantities import Parameter
from ..model.scene import Scene, check_scene
from ..solvers.named import resolve_solver
from ..tools.checks import one_of, require, shown_number, whole
from ..tools.compile import is_traced
from ..tools.files import write_whole
from .branch_data import BranchEvent
from .branches import Bar, OrbitBranch, bounds_of
from .motions import EventMotions, SlipperMotions, slipper_motions
from .periodic import TOLERANCE, PeriodicOrbit
from .signature import GapSamples, Grazing

CURVES = ("LP", "PD", "NS", "GR")
"""Events that can be followed through the plane of two parameters."""
GAP_UNIT = 1e-5
"""Gap that counts as one beside the other equations of a grazing [m]."""
ROUGH = {"LP": 1e-3, "PD": 1e-4, "NS": 1e-4}
"""Distances of a multiplier from its critical value that are accepted along curves [1]. The derivatives of the period
map jump where a touchdown passes from one integration step to the next. A fold's place depends on it to second
order."""
EASE = {"LP": 1e-2, "PD": 1e-3, "NS": 1e-3}
"""Such distances at single points of a curve, where there is no other way on [1]."""
PACE = Pace(first=0.02, least=1e-4, most=0.2)
"""Steps along a curve: 1 is the whole range of a parameter; the state counts less, see `EventMotions`."""
PACE_OF_FOLDS = Pace(first=0.02, least=2e-3, most=0.2)
"""Likewise for folds, which feel the jumps of derivatives most: short steps there are of no use."""
CRITICAL = 1e-6
"""Distance from the unit circle within which a multiplier is critical [1]."""


class CriticalOrbit(eqx.Module):
    """An orbit with a critical multiplier, and the parameter's value at which it has it."""

    scene: Scene
    """With that value."""
    value: Float[Array, ""]
    """The parameter's value [its SI unit]."""
    state: State
    multiplier: Array
    """The critical multiplier [1]: +1, -1, or exp(i angle)."""
    residual: Float[Array, ""]
    """Greatest scaled component of what the extended equations miss [1]."""
    name: str = eqx.field(static=True)
    label: str = eqx.field(static=True)
    period: int = eqx.field(static=True)

    def __repr__(self) -> str:
        known = parameter(self.name, self.scene)
        return (
            f"CriticalOrbit({self.label} of period {self.period} at {self.name} = {shown_number(self.value)} "
            f"{known.unit}, residual {shown_number(self.residual)})"
        )


def critical_orbit(
    scene: Scene,
    name: str,
    label: str,
    start: PeriodicOrbit,
    *,
    angle: float | None = None,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    tolerance: float = TOLERANCE,
) -> CriticalOrbit:
    """The fold, flip or Neimark-Sacker of orbits over a parameter, from an orbit near it, by Newton's method.

    `value` and `state` have the derivatives of the exact ones with respect to all numbers of `scene`, in both modes:
    how fast a flip's speed changes with the clearance, for example. The scene's own value of the parameter is without
    effect.

    **Arguments:**

    - `name`: of the parameter, or its path; `label`: "LP", "PD" or "NS".
    - `start`: near it, as `OrbitBranch.orbit(event)` gives it; its scene has the parameter's value that is tried
        first.
    - `angle`: of the multiplier [rad], for "NS"; default that of the multiplier of `start` nearest to the unit
        circle.
    - `steps_per_period`, `solver`: default those of `start`. `tolerance`: scaled residual [1].

    **Returns:** a `CriticalOrbit`; look at its `residual`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    check_scene(scene)
    one_of("label", label, ("LP", "PD", "NS"))
    known = parameter(name, scene)
    given = steps_per_period is not None
    steps = whole("steps_per_period", steps_per_period, 1) if given else int(start.steps_per_period)
    solver = start.solver if solver is None else resolve_solver(scene, solver)
    value = jax.lax.stop_gradient(known.of(start.scene))
    # differentiated in both modes, or by one program for all numbers of steps
    stepping = static_steps(steps) if is_traced(scene) else dynamic_steps(steps)
    how = dict(stepping=stepping, solver=solver, period=start.period)
    motions = slipper_motions(scene, (name,), (jnp.abs(value),), start.state, **how)
    if angle is None:
        angle = _angle(start.multipliers)
    found = critical_motion(motions, label, start.state, value, angle=angle, tolerance=tolerance)
    at = known.replaced(scene, found.value)
    return CriticalOrbit(at, found.value, found.state, found.multiplier, found.residual, name, label, start.period)


def _angle(found: Any) -> float:
    """The angle of the complex multiplier nearest to the unit circle [rad]."""
    upper = np.asarray(found)[np.asarray(found).imag > 0]
    if len(upper) == 0:
        return 0.0
    return float(np.angle(upper[np.argmin(np.abs(np.abs(upper) - 1))]))


class GapExtreme(eqx.Module):
    """The extreme of one point's gap near a time, of an orbit of a scene with two parameters."""

    family: Any
    point: Array
    """Which point, the front ones first."""
    time: Array
    """When [forcing periods]."""
    greatest: Array
    """Whether it is a greatest gap, or a least one."""
    period: int = eqx.field(static=True)
    """Forcing periods after which the orbit recurs [1]."""

    def __call__(self, state: State, *values: Any) -> Array:
        """The gap [m]."""
        return self._extreme(state, *values)[0]

    def renewed(self, state: State, *values: Any) -> "GapExtreme":
        """With the time of the extreme of this orbit."""
        return dataclasses.replace(self, time=self._extreme(state, *values)[1])

    def _extreme(self, state: State, *values: Any) -> tuple[Array, Array]:
        step: PeriodMap = self.family(*values)
        kept = step.run(state, periods=self.period, records=RecordSet((GapSamples(),))).samples[0]
        steps = step.stepping.number
        of_point = lambda a: jax.lax.dynamic_index_in_dim(a, self.point, 2, False)
        gap, slope = of_point(kept[0]), of_point(kept[1]) * step.scene.period / steps
        # the step nearest to the time in which the slope changes its sign
        sign = jnp.where(self.greatest, -1.0, 1.0)
        place = jnp.arange(gap.shape[1] - 1)
        turns = (sign * slope[:, :-1] < 0) & (sign * slope[:, 1:] >= 0) & (place < steps)[None]
        middle = jnp.arange(self.period)[:, None] + ((place + 0.5) / steps)[None]
        away = jnp.abs((middle - self.time + self.period / 2) % self.period - self.period / 2)
        k, n = jnp.unravel_index(jnp.argmin(jnp.where(turns, away, jnp.inf)), turns.shape)
        g0, g1, d0, d1 = gap[k, n], gap[k, n + 1], slope[k, n], slope[k, n + 1]
        a, b = 2 * (g0 - g1) + d0 + d1, 3 * (g1 - g0) - 2 * d0 - d1

        def newton(_: Any, x: Array) -> Array:
            rise = (3 * a * x + 2 * b) * x + d0
            return jnp.clip(x - rise / (6 * a * x + 2 * b), 0.0, 1.0)

        # the value does not depend on the place to first order
        x = jax.lax.stop_gradient(jax.lax.fori_loop(0, 6, newton, d0 / (d0 - d1)))
        return ((a * x + b) * x + d0) * x + g0, k + (n + x) / steps


@dataclasses.dataclass(frozen=True)
class OrbitCurve:
    """Orbits with one event along a curve in the plane of two parameters."""

    points: Any
    """An `xarray.Dataset` along `point`: both parameters, `state`, `multiplier_real` and `multiplier_imag` [1], and
    `outside`, the multipliers outside the unit circle without the critical ones."""

    @property
    def label(self) -> str:
        """The event: "LP", "PD", "NS" or "GR"."""
        return self.points.attrs["label"]

    @property
    def names(self) -> tuple[str, str]:
        """The parameters."""
        first, second = varied_names(self.points)
        return first, second

    def __repr__(self) -> str:
        ds, ends = self.points, self.points.attrs["ended"]
        at = lambda k: ", ".join(f"{ds[name].values[k]:.6g}" for name in self.names)
        first, last = (f"({at(k)}: {ends[k] or 'start'})" for k in (0, -1))
        return (
            f"OrbitCurve({self.label} of period {ds.attrs['orbit_period']} over {' and '.join(self.names)}: "
            f"{ds.sizes['point']} points,\n  from {first} to {last})"
        )

    def to_netcdf(self, path: Any) -> None:
        """Writes `points`, whole or not at all."""
        write_whole(Path(path), self.points.to_netcdf(engine="h5netcdf"))


def continue_event(
    branch: OrbitBranch,
    event: BranchEvent,
    name: str,
    bounds: tuple[float, float],
    *,
    first_bounds: tuple[float, float] | None = None,
    points: int = 200,
    progress: bool = False,
) -> OrbitCurve:
    """Follows an event of a branch through the plane of the branch's parameter and another one.

    **Arguments:**

    - `event`: one of `branch.events`: a fold, flip, Neimark-Sacker or grazing.
    - `name`: of the other parameter, or its path; `bounds`: of its values [SI unit]; `first_bounds`: of the branch's
        own parameter, default those of the branch.
    - `points`: most points of each way. `progress`: shows a bar.

    **Returns:** an `OrbitCurve`. It ends where it meets a bound, or where no step converges, also with `EASE`: at a
    grazing the multipliers' second derivatives jump.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C,
    with the curve until then as its `result`.
    """
    one_of("event", event.label, CURVES)
    scene, call = branch.scene, load_call(branch.points)
    own, other = branch.parameter, parameter(name, scene)
    require(other.name != own.name, "name", "be another parameter than the branch's", name)
    limits = (bounds_of(own, call["bounds"] if first_bounds is None else first_bounds), bounds_of(other, bounds))
    value = float(scene.value(name))
    if not limits[1][0] <= value <= limits[1][1]:
        raise ValueError(
            f"Argument `bounds` must hold the scene's {name}, {shown_number(value)} {other.unit}, but is "
            f"{shown_number(limits[1][0])} to {shown_number(limits[1][1])}."
        )
    orbit, node = branch.orbit(event), branch.branch.nodes[event.point]
    stepping = dynamic_steps(call["steps_per_period"])
    how = dict(solver=call["solver"], period=branch.period)
    reach = [high - low for low, high in limits]
    motions = slipper_motions(scene, (own.name, name), reach, orbit.state, stepping=stepping, of=EventMotions, **how)
    if event.label == "GR":
        equations = ConditionedMotions(motions, _extreme_at(motions, branch, node, call), GAP_UNIT)
    else:
        equations = CriticalMotions.of(
            motions, event.label, call["tolerance"] / ROUGH[event.label], EASE[event.label]
        )
    pace = PACE_OF_FOLDS if event.label == "LP" else PACE
    options = dict(tolerance=call["tolerance"], pace=pace, points=points, secant=True)
    with Bar(progress, f"{event.label} over {own.name} and {name}", own) as bar:
        show = lambda spot: bar.show(spot.z[motions.size])
        angle = abs(float(np.angle(event.multiplier)))
        start = orbit.state, (event.value, value)
        found = continue_critical(equations, *start, limits, angle=angle, on_point=show, **options)
    result = OrbitCurve(_curve_dataset(found, motions, scene, (own, other), event.label))
    if "interrupted" in found.ended:
        raise Interrupted(result, result.points.sizes["point"], unit="points")
    return result


def _extreme_at(motions: SlipperMotions, branch: OrbitBranch, node: Node, call: Any) -> GapExtreme:
    """The extreme that is zero at a grazing."""
    near: Grazing = node.seen.data.grazing
    point = int(np.argmin(near.margin))
    inside = dynamic_steps(call["steps_per_period"], inside=True)
    family = dataclasses.replace(motions.family, stepping=inside)  # type: ignore[type-var]
    time, greatest = jnp.asarray(near.time[point]), jnp.asarray(near.opening[point])
    return GapExtreme(family, jnp.asarray(point), time, greatest, branch.period)


def _outside(mu: np.ndarray, label: str) -> int:
    """How many multipliers of an orbit lie outside the unit circle, without the critical ones.

    A critical one lies beside its value, see `ROUGH`, and is left out on either side.
    """
    if label == "NS":
        upper = np.flatnonzero(mu.imag >= 0)
        pair = mu[upper[np.argmin(np.abs(np.abs(mu[upper]) - 1))]]
        near = [int(np.argmin(np.abs(mu - one))) for one in (pair, np.conj(pair))]
    elif label in ("LP", "PD"):
        near = [int(np.argmin(np.abs(mu - (1 if label == "LP" else -1))))]
    else:
        near = []
    return int(np.sum(np.abs(np.delete(mu, near)) > 1 + CRITICAL))


def _curve_dataset(
    found: Curve, motions: SlipperMotions, scene: Scene, known: tuple[Parameter, Parameter], label: str
) -> Any:
    import xarray as xr

    names, size = [q.name for q in known], motions.size
    z = np.array([spot.z for spot in found.spots])
    mu = np.array([multipliers(np.asarray(spot.extra.matrices)) for spot in found.spots])
    states = jax.vmap(motions.state)(jnp.asarray(z))
    words = lambda text, unit="1": {"units": unit, "long_name": text}
    data = {
        "state": (("point", "number"), z[:, :size], words("all numbers of the state, as in slipperjax.State")),
        "multiplier_real": (("point", "multiplier"), mu.real, words("Floquet multipliers, real parts")),
        "multiplier_imag": (("point", "multiplier"), mu.imag, words("Floquet multipliers, imaginary parts")),
        "outside": (
            "point",
            [_outside(one, label) for one in mu],
            words("other multipliers outside the circle"),
        ),
        "residual": ("point", [float(spot.residual) for spot in found.spots], words("scaled residual")),
    }
    coords = {q.name: ("point", z[:, size + k], q.attributes) for k, q in enumerate(known)}
    start = jax.tree.map(lambda a: np.asarray(a)[0], states)
    call = {"function": "continue_event", "label": label}
    attrs = scene_attributes(scene, without=names) | run_attributes(scene, start, call, names)
    attrs |= {"label": label, "orbit_period": motions.intervals, "ended": list(found.ended)}
    return xr.Dataset(data, coords, attrs)
