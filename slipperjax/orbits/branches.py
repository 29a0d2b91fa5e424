"""Branches of stable and unstable orbits over a parameter, with labelled and located events."""

import contextlib
import dataclasses
import functools
import json
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..analysis.arclength import Node, Observation, Pace, check_within, checked_bounds, correct
from ..analysis.continuation import Branch, End, continue_motion, extend, switch
from ..analysis.events import MEANINGS, Event, observed
from ..analysis.shooting import PeriodicMotions
from ..flow.datasets import (
    load_base,
    load_call,
    result_dataset,
    run_attributes,
    scene_attributes,
    scene_of,
)
from ..flow.period_map import PeriodMap
from ..flow.record import PoincareSections, RecordedSpan, RecordSet, SectionPoints, Strobe
from ..flow.status import Interrupted, Stop
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import coordinates
from ..model.parameters import Parameter, parameter
from ..model.scene import Scene, check_scene
from ..model.starts import initial_state
from ..model.step_size import given_steps
from ..results.result import Result
from ..solvers.named import resolve_solver
from ..tools.checks import known, number, positive, require, tuple_of, whole
from ..tools.columns import column
from ..tools.compile import call_compiled
from ..tools.progress import bar as progress_bar
from ..tools.types import Real
from .motions import check_forcing, slipper_motions, with_steps
from .periodic import TOLERANCE, PeriodicOrbit, periodic_orbit
from .signature import Gaps, GapSamples, Grazing, Signature, grazing, signature
from .simulate import Trajectory, default_steps, dynamic_steps

if TYPE_CHECKING:
    import xarray as xr

FINER = 4
"""Factor on the default steps per period of a simulation. Multipliers jump slightly where a touchdown passes from one
step to the next: with 50 steps there were four folds at 2235 m/s; with 100 and more there is one."""


class BranchEvent(NamedTuple):
    """A bifurcation, grazing or end point of a branch."""

    label: str
    """One of `slipperjax.analysis.events.MEANINGS`."""
    value: float
    """Value of the parameter [its SI unit]."""
    low: float
    """Lower bound of the value."""
    high: float
    """Upper bound of the value."""
    multiplier: complex
    """Critical multiplier [1]; NaN where there is none."""
    converged: bool
    """Whether the event is located."""
    note: str
    point: int
    """Index of the event among the points of the branch."""


EVENT_COLUMNS: dict[str, tuple[type, str]] = {
    "label": (str, "event: " + "; ".join(f"{label}: {meaning}" for label, meaning in MEANINGS.items())),
    "value": (float, "parameter's value at the event"),
    "low": (float, "lower bound of it"),
    "high": (float, "upper bound of it"),
    "converged": (bool, "whether the event is located"),
    "note": (str, "more about the event"),
    "point": (int, "place of the event among the points"),
    "multiplier_real": (float, "critical multiplier, real part"),
    "multiplier_imag": (float, "critical multiplier, imaginary part"),
}
"""Types and descriptions of a dataset's variables for events; complex numbers are split, because netCDF has none."""


class OrbitView(NamedTuple):
    """Contacts and Poincare section of one orbit of a branch."""

    grazing: Grazing
    signature: Signature
    crossed: SectionPoints
    """Samples of `PoincareSections` in each period."""


class OrbitBranch(Result):
    """Orbits along a curve over one parameter: a dataset along `point` with the parameter, `state`, `multiplier_real`
    and `multiplier_imag` [1], `stable`, `signature`, `touchdowns`, `slowest_touchdown` [m/s], `grazing_gap` [m],
    `residual`, `label`, and the Poincare sections of `slipperjax.sweep`; along `event`, the table of events."""

    @property
    def scene(self) -> Scene:
        """Scene in which the parameter varies."""
        # a part with one point has the scene of that point
        return load_base(self.ds)[0] if self.ds.sizes.get("point", 1) > 1 else scene_of(self.ds)

    @property
    def parameter(self) -> Parameter:
        """Parameter that varies."""
        return parameter(load_call(self.ds)["parameter"], self.scene)

    @property
    def equations(self) -> PeriodicMotions:
        """Equations of the orbits."""
        return _Settings.of(self).equations

    @property
    def period(self) -> int:
        """Forcing periods after which the orbits recur [1]."""
        return int(self.ds.attrs["orbit_period"])

    @property
    def events(self) -> tuple[BranchEvent, ...]:
        """Events of the branch, in the order of its points."""
        ds = self.ds
        columns = {name: ds[f"event_{name}"].values.tolist() for name in EVENT_COLUMNS}
        columns["multiplier"] = map(complex, columns["multiplier_real"], columns["multiplier_imag"])
        return tuple(map(BranchEvent, *(columns[name] for name in BranchEvent._fields)))

    def events_named(self, label: str) -> tuple[BranchEvent, ...]:
        """Return the events with a label such as "PD"."""
        return tuple(event for event in self.events if event.label == label)

    def orbit(self, point: int | BranchEvent) -> PeriodicOrbit:
        """Return the orbit at a point, by its index, or at an event."""
        ds = self.ds.isel(point=point.point if isinstance(point, BranchEvent) else point)
        settings = _Settings.of(self)
        call = settings.call
        return PeriodicOrbit(
            scene=settings.varied.replaced(settings.scene, ds[call["parameter"]].values),
            state=settings.equations.state(jnp.asarray(ds["state"].values)),
            multipliers=jnp.asarray(ds["multiplier_real"].values + 1j * ds["multiplier_imag"].values),
            residual=jnp.asarray(ds["residual"].values),
            iterations=jnp.asarray(ds["iterations"].values),
            status=jnp.asarray(0),
            period=call["period"],
            steps_per_period=call["steps_per_period"],
            solver=call["solver"],
        )

    def extended(
        self,
        bounds: tuple[float, float] | None = None,
        **options: object,
    ) -> "OrbitBranch":
        """Follow the branch further, from ends by interrupt, event of `until`, number of points, or bound.

        **Arguments:** `bounds`: of the parameter, default as before; `options`: `points`, `until` and `progress` of
        `continue_orbit`.
        """
        return _Settings.of(self, bounds).follow(extend, self.branch, **options)

    def switched(
        self,
        event: BranchEvent,
        *,
        bounds: tuple[float, float] | None = None,
        **options: object,
    ) -> "OrbitBranch":
        """Follow another branch from an event: twice the period at a flip, the crossing branch at a branch point.

        **Arguments:** as for `extended`.

        **Raises:** `ValueError` for other events, or where no orbit outside this branch is found.
        """
        # after a flip the equations have twice the period
        equations, first = switch(self.branch, _analysed(event, self.branch.nodes))
        settings = dataclasses.replace(_Settings.of(self, bounds), equations=equations)
        return settings.follow(functools.partial(continue_motion, ways=(1,)), equations, first, **options)

    @functools.cached_property
    def branch(self) -> Branch:
        """The branch as a `slipperjax.analysis.Branch`; the points of a branch from a file are evaluated again."""
        settings = _Settings.of(self)
        ds = self.ds
        z = np.column_stack([ds["state"].values, ds[settings.call["parameter"]].values])
        nodes = []
        # all points meet a tolerance of 1 at once, so that Newton's method does not move them
        for unknowns, tangent, label in zip(z, ds["tangent"].values, ds["label"].values, strict=True):
            weights = np.asarray(settings.equations.weights(jnp.asarray(unknowns))[1])
            node = correct(settings.equations, unknowns, weights**2 * tangent, tolerance=1.0)
            nodes.append(observed(node, settings.observe)._replace(label=str(label)))
        events = tuple(_analysed(event, nodes) for event in self.events)
        first, last = map(End, ds.attrs["ended"], np.asarray(ds.attrs["next_steps"], float).tolist())
        return Branch(settings.equations, tuple(nodes), events, (first, last))


def _analysed(event: BranchEvent, nodes: Sequence[Node]) -> Event:
    """Return an event as a `slipperjax.analysis.Event`."""
    label, _, low, high, multiplier, converged, note, point = event
    return Event(label, nodes[point], low, high, converged, multiplier, note)


@dataclasses.dataclass(frozen=True)
class _Settings:
    """Settings with which a branch is followed."""

    scene: Scene
    call: dict[str, Any]
    """The call in the branch's dataset, with parameter, bounds, period, steps, solver and tolerance."""
    equations: PeriodicMotions

    @classmethod
    def new(cls, scene: Scene, call: dict[str, Any], like: State) -> "_Settings":
        """Return the settings of a new branch, with its equations."""
        low, high = call["bounds"]
        # dynamic, so that one program serves all numbers of steps
        stepping = dynamic_steps(call["steps_per_period"])
        options = dict(stepping=stepping, solver=call["solver"], period=call["period"])
        return cls(scene, call, slipper_motions(scene, (call["parameter"],), (high - low,), like, **options))

    @classmethod
    def of(cls, branch: OrbitBranch, bounds: tuple[float, float] | None = None) -> "_Settings":
        """Return the settings of a branch, or with other bounds. The scale of lengths still follows from the first
        bounds."""
        scene, start = load_base(branch.ds)
        first = cls.new(scene, load_call(branch.ds), initial_state(scene, start))
        if bounds is None:
            return first
        return dataclasses.replace(first, call=first.call | {"bounds": list(bounds_of(first.varied, bounds))})

    @property
    def varied(self) -> Parameter:
        """Parameter that varies."""
        return parameter(self.call["parameter"], self.scene)

    def observe(self, node: Node) -> Observation:
        """Return the touchdowns and margins of an orbit for the search of grazings, with an `OrbitView` as data."""
        # a second program of the equations, which keeps samples inside the periods
        steps = self.call["steps_per_period"]
        equations = with_steps(self.equations, steps, most=steps)
        records = RecordSet((GapSamples(), PoincareSections()))
        ((gap, rate), crossed), period = call_compiled(_samples, equations, (records,), jnp.asarray(node.z))
        gaps = Gaps.of(gap, rate, steps, float(period))
        touches = grazing(gaps)
        view = OrbitView(touches, signature(self.scene, gaps), crossed)
        return Observation(tuple(touches.touchdowns.tolist()), tuple(touches.margin.tolist()), view)

    def follow(
        self,
        walk: Callable[..., Branch],
        *start,
        points: int = 400,
        until: Sequence[str] = (),
        progress: bool | None = None,
    ) -> OrbitBranch:
        """Return the branch that `walk` makes from a start, with a progress bar, or after Ctrl-C in `Interrupted`."""
        varied = self.varied
        with counted(progress, f"branch over {varied.name}", varied) as count:
            branch = walk(
                *start,
                self.call["bounds"],
                observe=self.observe,
                on_point=lambda node: count(node.z[-1]),
                tolerance=self.call["tolerance"],
                # a length of 1 is the whole range of the parameter, or 1 mm, 10 mrad, 1 m/s, 10 rad/s of the state
                pace=Pace(most=0.3),
                points=points,
                until=labels(until),
            )
        found = OrbitBranch(self.dataset(branch))
        found.branch = branch  # fills the cached property, so that points are not evaluated again
        return finished(found)

    def dataset(self, branch: Branch):
        """Return an `xarray.Dataset` of a branch, from which the branch can be made again."""
        nodes = branch.nodes
        scene = self.scene
        varied = self.varied
        views: list[OrbitView] = [node.view.data for node in nodes]
        # a bifurcation, with a multiplier on the unit circle, counts as unstable
        stable = [not node.outside and not node.critical for node in nodes]
        # after a flip the equations have twice the period
        call = self.call | {"period": branch.equations.intervals}
        ds, states = orbits_dataset(nodes, branch.equations, scene, [varied], call)
        # contact points are called `contact`, because `point` means the points of the branch
        labels = {name.replace("point", "contact"): of for name, of in scene.point_labels.items()}
        touchdowns = np.array([view.grazing.touchdowns for view in views]).reshape(len(nodes), *scene.point_shape)
        signatures = [view.signature for view in views]
        data = {
            "tangent": column(
                ("point", "number_and_parameter"), [node.tangent for node in nodes], "1", "direction of the branch"
            ),
            "stable": column("point", stable, "1", "whether no multiplier lies outside the unit circle"),
            "iterations": column(
                "point", [int(node.iterations) for node in nodes], "1", "iterations of Newton's method"
            ),
            "label": column("point", [node.label for node in nodes], "1", EVENT_COLUMNS["label"][1]),
            "signature": column("point", [" ".join(s.points) for s in signatures], "1", "touchdowns in their order"),
            "slowest_touchdown": column("point", [s.slowest for s in signatures], "m/s", "slowest touchdown"),
            "grazing_gap": column(
                "point", [s.nearest for s in signatures], "m", "least magnitude of a gap's extreme"
            ),
            "touchdowns": column(("point", *labels), touchdowns, "1", "touchdowns in a period of the orbit"),
        }
        # the record finishes a batch of cases, here the orbits of all points
        crossed = jax.tree.map(lambda *parts: np.stack(parts), *(view.crossed for view in views))
        record = PoincareSections()
        span = RecordedSpan(call["period"], call["steps_per_period"], 0.0, np.zeros(len(nodes), int))
        sections, _ = record.label(scene, ("point",), record.finish(None, crossed, span))
        # the state at the start of the orbit is its one strobe state
        strobe, coords = Strobe().label(scene, ("point",), coordinates(states)[:, None])
        coords |= labels
        note = functools.partial(_note, names=scene.point_names)
        ds = ds.assign(data | sections | strobe | event_columns(branch, varied.unit, note))
        # the steps with which `extended` continues
        next_steps = [end.step for end in branch.ends]
        return ds.assign_coords(coords).assign_attrs(ended=list(branch.ended), next_steps=next_steps)


def _samples(equations: PeriodicMotions, static: tuple, z) -> tuple:
    """Return the samples of records along an orbit, and the length of a period [s]."""
    step: PeriodMap = equations.step(z)  # type: ignore[assignment]
    passage = step.run(equations.state(z), periods=equations.intervals, records=static[0])
    return passage.samples, step.scene.period


def orbits_dataset(
    nodes: Sequence[Node],
    motions: PeriodicMotions,
    scene: Scene,
    varied: Sequence[Parameter],
    call: dict[str, object],
) -> "tuple[xr.Dataset, State]":
    """Return a dataset of the orbits at points of a curve, and their states, with a leading axis.

    `load_base` and `load_call` read scene and call from the dataset.
    """
    z = np.array([node.z for node in nodes])
    size = motions.size
    names = [quantity.name for quantity in varied]
    # the unknowns are the numbers of the state, then the parameters
    states = jax.vmap(motions.state)(jnp.asarray(z))
    data = {
        "state": column(("point", "number"), z[:, :size], "1", "all numbers of the state, as in slipperjax.State")
    }
    coords = {quantity.name: ("point", z[:, size + k], quantity.attributes) for k, quantity in enumerate(varied)}
    # the first orbit represents the start of a run
    start = jax.tree.map(lambda a: np.asarray(a)[0], states)
    attrs = scene_attributes(scene, without=names) | run_attributes(scene, start, call, names)
    attrs |= {"orbit_period": motions.intervals}
    return result_dataset(data | point_columns(nodes), coords, attrs), states


def point_columns(nodes: Sequence[Node]) -> dict[str, tuple]:
    """Return a dataset's variables along `point` that branches and curves of all systems have."""
    multipliers = np.array([node.multipliers for node in nodes])
    outside = "multipliers outside the unit circle, without critical ones"
    each = ("point", "multiplier")
    return {
        "multiplier_real": column(each, multipliers.real, "1", "Floquet multipliers, real parts"),
        "multiplier_imag": column(each, multipliers.imag, "1", "Floquet multipliers, imaginary parts"),
        "outside": column("point", [node.outside for node in nodes], "1", outside),
        "residual": column("point", [float(node.residual) for node in nodes], "1", "scaled residual"),
    }


def event_columns(
    branch: Branch, unit: str, note: Callable[[Event], str] = lambda event: event.note
) -> dict[str, tuple]:
    """Return a dataset's variables along `event`; `unit`: of the parameter; `note`: makes the text of an event."""
    # by identity, because two points may have the same value, such as a bound and a grazing
    index = {id(node.z): k for k, node in enumerate(branch.nodes)}
    rows = []
    for event in branch.events:
        mu = event.multiplier
        place = event.value, event.low, event.high, event.converged
        rows.append((event.label, *place, note(event), index[id(event.node.z)], mu.real, mu.imag))
    data = {}
    for k, (name, (kind, text)) in enumerate(EVENT_COLUMNS.items()):
        own = unit if name in ("value", "low", "high") else "1"
        data[f"event_{name}"] = column("event", np.array([row[k] for row in rows], kind), own, text)
    return data


def curve_columns(curve: Branch, unit: str) -> dict[str, tuple]:
    """Return the variables of `event_columns` and the coefficients of normal forms, each with its error, as JSON."""
    texts = []
    for event in curve.events:
        numbers = {name: complex(number) for name, number in event.coefficients.items()}
        parts = {name: (at.real, at.imag, event.stderr.get(name, 0.0)) for name, at in numbers.items()}
        texts.append(json.dumps(parts))
    text = "coefficients of the normal form: real part, imaginary part and error, by name"
    errors = [json.dumps(dict(event.stderr)) for event in curve.events]
    return event_columns(curve, unit) | {
        "event_coefficients": column("event", texts, "1", text),
        "event_stderr": column("event", errors, "1", "errors by the steps: of both parameters and the coefficients"),
    }


def _note(event: Event, names: Sequence[str]) -> str:
    """Return the note of an event, with the changes of touchdowns at a grazing, along the branch."""
    opening = event.node.view.data.grazing.opening
    notes = []
    for k, change in enumerate(event.change):
        if change:
            happens = "opens" if opening[k] else "touches"
            notes.append(f"{names[k]} {happens} once {'more' if change > 0 else 'less'}")
    return "; ".join([*notes, event.note] if event.note else notes)


Followed = TypeVar("Followed", bound=Result)


def finished(result: Followed) -> Followed:
    """Return a branch or curve unchanged; raise `Interrupted` with it if it ended by Ctrl-C."""
    if "interrupted" in result.ds.attrs["ended"]:
        raise Interrupted(result, result.ds.sizes["point"], unit="points")
    return result


@contextlib.contextmanager
def counted(
    shown: bool | None,
    text: str,
    varied: Parameter,
    programs: int = 3,
) -> Iterator[Callable[[Real], None]]:
    """Yield a function that counts a point in a progress bar, from its value of a parameter [SI unit].

    The function raises `KeyboardInterrupt` where this run is asked to end.

    **Arguments:** `shown`, `programs`: of `slipperjax.tools.progress.bar`; a branch compiles three.
    """
    with progress_bar(shown, programs=programs, desc=text, unit=" points") as bar:

        def count(value) -> None:
            # here, between points, because a compiled program cannot be stopped
            if Stop.here().is_set():
                raise KeyboardInterrupt
            bar.set_postfix_str(f"{varied.shown(float(value)):.6g} {varied.display_unit}", refresh=False)
            bar.update()

        yield count


def bounds_of(varied: Parameter, bounds: object) -> tuple[float, float]:
    """Return bounds of a parameter [SI unit]; raise `ValueError` unless they are two of its values, the smaller
    first."""
    low, high = checked_bounds(bounds, f"values of {varied.name} [{varied.unit}]")
    return float(varied.check(low)), float(varied.check(high))


def labels(until: Sequence[str]) -> tuple[str, ...]:
    """Return `until` as a tuple; raise `ValueError` unless all are labels of events."""
    # the walk ends in any case at two other events, and slippers have no impacts that act at once
    choices = [label for label in MEANINGS if label not in ("EP", "MX", "ST")]
    need = f"a tuple of labels of {', '.join(choices)}"
    given = tuple_of("until", until, str, need)
    require(set(given) <= set(choices), "until", f"be {need}", until)
    return given


def steps_of_branch(
    scene: Scene,
    varied: Parameter,
    bounds: tuple[float, float],
    steps: int | None,
) -> int:
    """Return the steps per forcing period of a branch, given or by default, see `continue_orbit`."""
    if steps is not None:
        return given_steps(steps)
    # enough for the most demanding scene along the branch
    at = (scene, *(varied.replaced(scene, value) for value in bounds))
    return FINER * max(default_steps(one, None) for one in at)


def continue_orbit(
    scene: Scene,
    name: str,
    bounds: tuple[float, float],
    *,
    start: PeriodicOrbit | Motion | State | Trajectory | None = None,
    period: int = 1,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    tolerance: float = TOLERANCE,
    points: int = 400,
    until: Sequence[str] = (),
    progress: bool | None = None,
) -> OrbitBranch:
    """Follow an orbit in both directions of a parameter, stable or not, past folds; locate and label the events.

    The multipliers show folds (LP), flips (PD), Neimark-Sackers (NS) and branch points (BP). Touchdowns of each
    contact point, and extremes of its gap within steps, show grazings (GR), so that none is missed.

    **Arguments:**

    - `scene`: the branch begins at the scene's value of the parameter. `name`: of the parameter, or its path;
        `bounds`: of the parameter's values [SI unit].
    - `start`, `period`: as for `periodic_orbit`; `start` may also be an orbit of `periodic_orbit`.
    - `steps_per_period`: default `FINER` times the default steps of the bound that needs more; `solver`: as for
        `simulate`, with constant steps.
    - `tolerance`: scaled residual of the orbits [1]. `points`: most points in each direction. `progress`: whether a
        bar is shown, by default on terminals and in notebooks.
    - `until`: labels of events at which a direction ends, such as ("LP", "PD"); default none.

    **Returns:** an `OrbitBranch`.

    **Raises:** `ValueError` that names the wrong argument, also where there is no orbit near the start; `Interrupted`
    after Ctrl-C, with the branch so far as its `result`, whose method `extended` continues.
    """
    scene = known("scene", check_scene(scene))
    check_forcing(scene)
    varied = parameter(name, scene)
    bounds = bounds_of(varied, bounds)
    until = labels(until)
    tolerance = number(positive, "tolerance", tolerance)
    points = whole("points", points, 1)
    value = float(scene.value(name))
    check_within(varied.name, value, bounds)
    solver = resolve_solver(scene, solver)
    steps = steps_of_branch(scene, varied, bounds, steps_per_period)
    if not isinstance(start, PeriodicOrbit):
        options = dict(steps_per_period=steps, solver=solver, tolerance=tolerance)
        start = periodic_orbit(scene, period, start=start, **options)
        if int(start.status):
            raise ValueError(f"Argument `start` must be near a periodic orbit, but: {start!r}")
    call = {
        "function": "continue_orbit",
        "parameter": varied.name,
        "bounds": list(bounds),
        "period": start.period,
        "steps_per_period": steps,
        "solver": solver,
        "tolerance": tolerance,
    }
    settings = _Settings.new(scene, call, start.state)
    at = start.state, value
    return settings.follow(continue_motion, settings.equations, at, points=points, until=until, progress=progress)
