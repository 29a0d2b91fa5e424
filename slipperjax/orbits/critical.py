"""Orbits at events, such as folds and flips: exact, differentiable, and followed in the plane of two parameters."""

import dataclasses
import functools
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..analysis.arclength import Pace, check_within
from ..analysis.continuation import Branch
from ..analysis.critical import (
    CRITICAL_MULTIPLIERS,
    ConditionedMotions,
    CriticalMotion,
    CriticalMotions,
    continue_critical,
    critical_motion,
    located,
)
from ..analysis.degenerate import POINTS, PointSearch
from ..analysis.events import Event, observed
from ..analysis.normal_forms import normal_form
from ..analysis.shooting import PeriodicMotions
from ..analysis.step_error import with_step_error
from ..flow.datasets import load_call, scene_attributes, varied_names
from ..flow.period_map import PeriodMap
from ..flow.record import RecordSet
from ..flow.stepping import AbstractStepping
from ..model.dynamics import State
from ..model.parameters import at_values, checked_parameters, parameter, values_of
from ..model.scene import Scene, check_scene
from ..results.result import Result
from ..tools.checks import one_of, require, shown_number
from ..tools.columns import column
from ..tools.compile import jit
from ..tools.hermite import Cubic
from ..tools.types import Real
from .branches import (
    BranchEvent,
    OrbitBranch,
    bounds_of,
    counted,
    curve_columns,
    finished,
    orbits_dataset,
)
from .motions import WIDTH, ScenePath, slipper_motions, with_steps
from .periodic import TOLERANCE, PeriodicOrbit
from .signature import GapSamples, Grazing
from .simulate import dynamic_steps, steps_of_call

if TYPE_CHECKING:
    import xarray as xr


AROUND = 0.02
"""Length along a curve, to both sides of a point of codimension two, in which it is sought with more steps."""


FORM_FINER = 12, 24, 48
"""Multiples of a branch's steps with which the coefficients of normal forms are computed."""
STEPS = 2400
"""Steps per forcing period at which differences have the width `slipperjax.orbits.motions.WIDTH`."""


def critical_orbit(
    scene: Scene,
    name: str,
    label: str,
    start: PeriodicOrbit,
    *,
    tolerance: float = TOLERANCE,
) -> CriticalMotion:
    """Find the fold, flip or Neimark-Sacker of orbits over a parameter by Newton's method, from an orbit near it.

    `value` and `state` have the derivatives of the exact solution with respect to all numbers of `scene`, in forward
    and reverse mode; for example, how the speed of a flip changes with the clearance. The scene's own value of the
    parameter has no effect.

    **Arguments:**

    - `name`: of the parameter, or its path; `label`: "LP", "PD" or "NS".
    - `start`: an orbit near the event, such as `OrbitBranch.orbit(event)`. Its scene has the first guess of the
        parameter; its complex multiplier nearest to the unit circle has the first guess of the angle, for "NS".
    - `tolerance`: scaled residual [1].

    **Returns:** the orbit with the parameter's `value` [its SI unit]; check its `residual`.

    **Raises:** `ValueError` that names the wrong argument.
    """
    scene = check_scene(scene)
    one_of("label", label, tuple(CRITICAL_MULTIPLIERS))
    stepping = steps_of_call(int(start.steps_per_period), scene)
    return _critical_orbit(scene, start, stepping, _angle(start), tolerance, name, label)


def _critical_orbit(
    scene: Scene,
    start: PeriodicOrbit,
    stepping: AbstractStepping,
    angle,
    tolerance,
    name: str,
    label: str,
) -> CriticalMotion:
    """Return the orbit of `critical_orbit`, without checks."""
    # neither the result nor its derivatives depend on the first guess
    value = jax.lax.stop_gradient(parameter(name, scene).of(start.scene))
    options = dict(stepping=stepping, solver=start.solver, period=start.period)
    motions = slipper_motions(scene, (name,), (jnp.abs(value),), start.state, **options)
    return critical_motion(motions, label, start.state, value, angle=angle, tolerance=tolerance)


def _angle(orbit: PeriodicOrbit) -> float:
    """Return the angle of an orbit's complex multiplier nearest to the unit circle [rad], 0 where all are real."""
    mu = np.asarray(orbit.multipliers)
    # one multiplier of each complex pair
    upper = mu[mu.imag > 0]
    return float(np.angle(min(upper, key=lambda mu: abs(abs(mu) - 1)))) if len(upper) else 0.0


def event_sensitivities(
    branch: OrbitBranch,
    event: BranchEvent,
    names: Sequence[str],
) -> "xr.Dataset":
    """Differentiate the parameter's value at a fold, flip or Neimark-Sacker with respect to other parameters.

    **Arguments:** `event`: one of `branch.events`; `names`: of parameters, or paths.

    **Returns:** an `xarray.Dataset` with `value`, the event's value of the branch's parameter [its SI unit], and
    along `parameter` `gradient` and `gradient_stderr` [unit of the branch's parameter per the parameter's unit], and
    `relative`, the relative change of the value per relative change of the parameter [1]. They are computed with
    three, six and twelve times the steps of the branch; the differences give the errors, see
    `slipperjax.analysis.with_step_error`.

    **Raises:** `ValueError` that names the wrong argument, also where the event is not found with more
    steps.
    """
    one_of("event", event.label, tuple(CRITICAL_MULTIPLIERS))
    scene = branch.scene
    call = load_call(branch.ds)
    tolerance = call["tolerance"]
    own = branch.parameter
    start = branch.orbit(event)
    parameters = checked_parameters(names, scene)
    names = tuple(one.name for one in parameters)
    require(own.name not in names, "names", "be of other parameters than the branch's", names)
    values = values_of(scene, names)
    angle = _angle(start)

    # the event's value and its derivatives with a number of steps
    def located(steps: int) -> tuple[np.ndarray, np.ndarray]:
        numbers = scene, start, values, dynamic_steps(steps), angle, tolerance
        value, slope, residual = _place(*numbers, own.name, event.label, names)
        if not float(residual) <= tolerance:
            raise ValueError(
                f"Argument `event` must be found with {steps} steps per period, too, but Newton's method ended with "
                f"a residual of {shown_number(residual)}."
            )
        return np.asarray(value), np.asarray(slope)

    (value, gradient), (stderr, gradient_stderr) = with_step_error(located, call["steps_per_period"])
    units = [f"{own.unit} per {one.unit}" for one in parameters]
    # change of the value per relative change of each parameter
    relative = gradient * np.asarray(values) / value
    error = "its error by the steps"
    data = {
        "value": column((), value, own.unit, f"{own.name} at the event"),
        "stderr": column((), stderr, own.unit, error),
        "gradient": column("parameter", gradient, "", "derivative by the parameter"),
        "gradient_stderr": column("parameter", gradient_stderr, "", error),
        "relative": column("parameter", relative, "", "relative change per relative change"),
    }
    coords = {"parameter": list(names), "gradient_unit": ("parameter", units)}
    import xarray as xr  # here, because importing it takes long

    return xr.Dataset(
        data,
        coords,
        scene_attributes(scene) | {"label": event.label, "varied": own.name},
    )


@functools.partial(jit, static_argnums=(6, 7, 8))
def _place(
    scene: Scene,
    start: PeriodicOrbit,
    values: Array,
    stepping: AbstractStepping,
    angle,
    tolerance,
    name: str,
    label: str,
    names: tuple[str, ...],
) -> tuple[Array, Array, Array]:
    """Return the parameter's value at an event, its derivatives by the parameters `names` at `values`, and the
    residual."""

    # jacfwd does not return the value that it differentiates, so that the value is returned again with the residual
    def place(values: Array) -> tuple[Array, tuple[Array, Array]]:
        at = at_values(scene, names, values)
        orbit = _critical_orbit(at, start, stepping, angle, tolerance, name, label)
        return orbit.value, (orbit.value, orbit.residual)

    slope, (value, residual) = jax.jacfwd(place, has_aux=True)(values)
    return value, slope, residual


class GapExtreme(eqx.Module):
    """Function that returns the extreme of a contact point's gap near some time, on orbits over parameters."""

    family: ScenePath
    point: Array
    """Index of the contact point, front points first."""
    time: Array
    """Instant near which the extreme is sought [forcing periods]."""
    greatest: Array
    """Whether it is a maximum of the gap, not a minimum."""
    period: int = eqx.field(static=True)
    """Forcing periods after which the orbit recurs [1]."""

    def __call__(self, state: State, *values: Real) -> Array:
        """Return the gap at the extreme [m]."""
        return self._extreme(state, *values)[0]

    def update(self, state: State, *values: Real) -> "GapExtreme":
        """Return the function for orbits near this orbit, where the extreme has another time."""
        return dataclasses.replace(self, time=self._extreme(state, *values)[1])

    def _extreme(self, state: State, *values) -> tuple[Array, Array]:
        """Return the gap at the extreme [m], and the time [forcing periods]."""
        # the gap at both ends of every step along the orbit
        step: PeriodMap = self.family(*values)
        samples = step.run(state, periods=self.period, records=RecordSet((GapSamples(),))).samples[0]
        steps = step.stepping.number
        of_point = lambda a: jax.lax.dynamic_index_in_dim(a, self.point, 2, False)
        gap = of_point(samples[0])
        slope = of_point(samples[1]) * step.scene.period / steps
        # of the steps in which the slope changes its sign, the step nearest to the time; the last steps may be unused
        sign = jnp.where(self.greatest, 1.0, -1.0)
        index = jnp.arange(gap.shape[1] - 1)
        turns = (sign * slope[:, :-1] > 0) & (sign * slope[:, 1:] <= 0) & (index < steps)[None]
        middle = jnp.arange(self.period)[:, None] + ((index + 0.5) / steps)[None]
        # distance in time around the orbit, whose end is its start
        away = jnp.abs((middle - self.time + self.period / 2) % self.period - self.period / 2)
        k, n = jnp.unravel_index(jnp.argmin(jnp.where(turns, away, jnp.inf)), turns.shape)
        cubic = Cubic.through(gap[k, n], slope[k, n], gap[k, n + 1], slope[k, n + 1])
        # at an extreme the value does not depend on the instant to first order
        x = jax.lax.stop_gradient(cubic.turn(sign))
        return cubic.value(x), k + (n + x) / steps


class CurvePoint(NamedTuple):
    """A point of codimension two, or an end, of a curve of orbits."""

    label: str
    """One of `slipperjax.analysis.degenerate.POINTS`, or "EP" or "MX" at an end."""
    values: tuple[float, ...]
    """Values of both parameters [their SI units]."""
    state: np.ndarray
    """All numbers of the state."""
    coefficients: dict[str, complex]
    """Coefficients of the normal form, see `slipperjax.analysis.normal_form`; empty where there are none."""
    stderr: dict[str, float]
    """Errors by the steps, of both values by the names of the parameters, and of the coefficients."""
    note: str
    """Reason why there are no coefficients."""


class OrbitCurve(Result):
    """Orbits with one event, along a curve in the plane of two parameters: a dataset along `point` with both
    parameters, `state`, `multiplier_real` and `multiplier_imag` [1], and `outside`, the number of multipliers outside
    the unit circle without the critical ones."""

    @property
    def label(self) -> str:
        """Event: "LP", "PD", "NS" or "GR"."""
        return self.ds.attrs["label"]

    @property
    def parameters(self) -> np.ndarray:
        """Values of both parameters [their SI units], of shape (points, 2)."""
        return np.column_stack([self.ds[name].values for name in self.names])

    @property
    def events(self) -> tuple[CurvePoint, ...]:
        """Ends and points of codimension two, in the order of the curve's points."""
        found = []
        names = "label", "point", "coefficients", "stderr", "note"
        columns = (self.ds[f"event_{name}"].values.tolist() for name in names)
        for label, point, texts, errors, note in zip(*columns, strict=True):
            numbers = {name: complex(*parts[:2]) for name, parts in json.loads(texts).items()}
            values = tuple(self.parameters[point].tolist())
            found.append(CurvePoint(label, values, self.ds["state"].values[point], numbers, json.loads(errors), note))
        return tuple(found)

    @property
    def names(self) -> tuple[str, str]:
        """Names of both parameters."""
        first, second = varied_names(self.ds)
        return first, second


def continue_event(
    branch: OrbitBranch,
    event: BranchEvent,
    name: str,
    bounds: tuple[float, float],
    *,
    first_bounds: tuple[float, float] | None = None,
    points: int = 200,
    progress: bool | None = None,
) -> OrbitCurve:
    """Follow an event of a branch in the plane of the branch's parameter and another parameter.

    **Arguments:**

    - `event`: one of `branch.events`: a fold, flip, Neimark-Sacker or grazing.
    - `name`: of the other parameter, or its path; `bounds`: of its values [SI unit]; `first_bounds`: of the branch's
        own parameter, default the bounds of the branch.
    - `points`: most points in each direction. `progress`: whether a bar is shown, by default on terminals and in
        notebooks.

    **Returns:** an `OrbitCurve`. It ends at a bound, where the complex pair of a Neimark-Sacker becomes real ("strong
    resonance 1:1" or 1:2), or where no step converges, for example at a grazing, where derivatives of multipliers
    jump.

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C, with the curve so far as its
    `result`.
    """
    one_of("event", event.label, (*CRITICAL_MULTIPLIERS, "GR"))
    scene = branch.scene
    call = load_call(branch.ds)
    own = branch.parameter
    other = parameter(name, scene)
    require(other.name != own.name, "name", "be another parameter than the branch's", name)
    # the curve may leave the range of its branch if the caller allows this
    own_bounds = bounds_of(own, call["bounds"] if first_bounds is None else first_bounds)
    limits = (own_bounds, bounds_of(other, bounds))
    value = float(scene.value(name))
    check_within(other.name, value, limits[1])
    orbit = branch.orbit(event)
    # lengths along the curve are shares of both ranges
    reach = [high - low for low, high in limits]
    stepping = dynamic_steps(call["steps_per_period"])
    settings = dict(stepping=stepping, solver=call["solver"], period=branch.period, share=0.1)
    motions = slipper_motions(scene, (own.name, name), reach, orbit.state, **settings)
    if event.label == "GR":
        # a gap of 0.01 mm counts as a residual of one
        equations = ConditionedMotions(motions, _extreme_at(motions, branch, event, call), 1e-5)
    else:
        equations = CriticalMotions.of(motions, event.label)
    with counted(progress, f"{event.label} over {own.name} and {name}", own, programs=1) as count:
        curve = continue_critical(
            equations,
            orbit.state,
            (event.value, value),
            limits,
            angle=abs(float(np.angle(event.multiplier))),
            tolerance=call["tolerance"],
            # a length of 1 is the whole range of a parameter
            pace=Pace(least=1e-4, most=0.2),
            points=points,
            on_point=lambda node: count(node.z[motions.size]),
        )
    measured = lambda one: _with_errors(one, curve, motions, call)
    curve = dataclasses.replace(curve, events=tuple(map(measured, curve.events)))
    # all points are at the event: the label marks their critical multipliers
    nodes = [node._replace(label=event.label) for node in curve.nodes]
    call = {"function": "continue_event", "label": event.label}
    ds, _ = orbits_dataset(nodes, motions, scene, (own, other), call)
    ds = ds.assign(curve_columns(curve, other.unit))
    return finished(OrbitCurve(ds.assign_attrs(label=event.label, ended=list(curve.ended))))


def _with_errors(event: Event, curve: Branch, motions: PeriodicMotions, call: dict) -> Event:
    """Return a point of codimension two with the errors of its place, and the coefficients from more steps."""
    if event.label not in POINTS:
        return event
    steps = call["steps_per_period"]
    place, errors = with_step_error(lambda steps: _place_of(event, curve, steps, call["tolerance"]), steps)
    # the point itself has the steps of the curve
    errors = errors + np.abs(place - event.values)
    stderr = dict(zip(curve.names, errors.tolist(), strict=True))
    coefficients = event.coefficients
    if coefficients:
        state = motions.state(jnp.asarray(event.node.z))
        coefficients, of_form = _form(motions, state, event.values, event.label, steps)
        stderr |= jax.tree.map(float, of_form)
    return event._replace(coefficients=coefficients, stderr=stderr)


def _place_of(event: Event, curve: Branch, steps: int, tolerance: float) -> np.ndarray:
    """Return both parameters at a point of codimension two with a number of steps; NaN where it is not found."""
    equations = curve.equations
    assert isinstance(equations, CriticalMotions)
    equations = dataclasses.replace(equations, motions=with_steps(equations.motions, steps))
    z, tangent = event.node.z, event.node.tangent
    # on both sides of the point, along the curve
    ends = [
        located(equations, jnp.asarray(z + way * tangent), event.node.row, tolerance=tolerance)
        for way in (-AROUND, AROUND)
    ]
    search = PointSearch(equations, None, tolerance)
    found = [one.values for one in search.between(*(observed(end, None) for end in ends)) if one.label == event.label]
    return np.array(found[0] if found else [np.nan, np.nan])


def _form(
    motions: PeriodicMotions, state: State, values: Sequence[Real], label: str, steps: int
) -> tuple[dict, dict]:
    """Return the coefficients of a normal form with many steps, and their errors."""

    def coefficients(steps: int) -> dict[str, complex | float]:
        # narrower differences with more steps, so that the errors of both fall
        finer = dataclasses.replace(with_steps(motions, steps), width=jnp.asarray(WIDTH * np.sqrt(STEPS / steps)))
        return normal_form(finer, state, values, label)

    return with_step_error(coefficients, steps, FORM_FINER)


def orbit_form(branch: OrbitBranch, event: BranchEvent) -> tuple[dict[str, complex | float], dict[str, float]]:
    """Return the coefficients of the normal form at a fold, flip or Neimark-Sacker of a branch, and their errors.

    They are those of `slipperjax.analysis.normal_form`, at the event's orbit with 12, 24 and 48 times the steps of
    the branch. Second and third derivatives are differences of first ones, narrower with more steps, so that the
    stated errors are those of steps and widths.

    **Arguments:** `event`: one of `branch.events`.

    **Raises:** `ValueError` for other events.
    """
    one_of("event", event.label, tuple(CRITICAL_MULTIPLIERS))
    orbit = branch.orbit(event)
    steps = load_call(branch.ds)["steps_per_period"]
    return _form(branch.equations, orbit.state, (event.value,), event.label, steps)


def _extreme_at(
    motions: PeriodicMotions,
    branch: OrbitBranch,
    event: BranchEvent,
    call,
) -> GapExtreme:
    """Return the extreme that is zero at a grazing."""
    touches: Grazing = branch.branch.nodes[event.point].view.data.grazing
    # the contact point with the extreme nearest to zero grazes
    point = int(np.argmin(touches.margin))
    steps = call["steps_per_period"]
    # the most steps are fixed, for arrays of samples inside the periods
    family = with_steps(motions, steps, most=steps).family
    time = jnp.asarray(touches.time[point])
    greatest = jnp.asarray(touches.opening[point])
    return GapExtreme(family, jnp.asarray(point), time, greatest, branch.period)
