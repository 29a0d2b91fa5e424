"""Branches of orbits over a parameter, through stable and unstable ones, with named and located events."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..analysis.continuation import Branch, End, continue_motion, extend_motion, switch
from ..analysis.curves import Pace, Spot, correct
from ..analysis.events import MEANINGS, Event, Node, Observation, as_node
from ..flow.datasets import dataset_of, load_base, load_call
from ..flow.period_map import PeriodMap
from ..flow.record import RecordedSpan, RecordSet, Sections
from ..flow.simulate import Trajectory, default_steps, dynamic_steps
from ..flow.status import ASKED, Interrupted
from ..model.dynamics import State, initial_state
from ..model.kinematics import Motion
from ..model.paths import parameter
from ..model.quantities import Parameter
from ..model.scene import Scene, check_scene
from ..solvers.named import resolve_solver
from ..tools.checks import brief, number, positive, shown_number, whole
from ..tools.compile import call_compiled
from ..tools.files import write_whole
from .branch_data import BranchEvent, OrbitView, branch_dataset, events_from
from .motions import SlipperMotions, check_forcing, slipper_motions
from .periodic import TOLERANCE, PeriodicOrbit, periodic_orbit
from .signature import Gaps, GapSamples, grazing, signature

BRANCH_PACE = Pace(first=0.02, least=1e-6, most=0.3)
"""Steps along a branch: 1 is the whole range of the parameter, or 1 mm, 10 mrad, 1 m/s, 10 rad/s of the state."""

FINER = 4
"""Default steps per period over those of a simulation: multipliers jump a little where a touchdown passes from one
step to the next. With 50 steps there were four folds at 2235 m/s; with 100 and more there is one."""


@dataclasses.dataclass(frozen=True)
class OrbitBranch:
    """Orbits along a curve over one parameter."""

    points: Any
    """An `xarray.Dataset` along `point`: the parameter, `state`, `multiplier_real` and `multiplier_imag` [1],
    `stable`, `signature`, `touchdowns`, `slowest_touchdown` [m/s], `grazing_gap` [m], `residual`, `label`, and the
    Poincare sections of `slipperjax.sweep`; and along `event` the table of events."""
    _branch: Branch | None = dataclasses.field(default=None, repr=False, compare=False)

    @property
    def scene(self) -> Scene:
        """Scene whose parameter varies."""
        return load_base(self.points)[0]

    @property
    def parameter(self) -> Parameter:
        """Parameter that varies."""
        return parameter(load_call(self.points)["parameter"], self.scene)

    @property
    def period(self) -> int:
        """Forcing periods after which the orbits recur [1]."""
        return int(self.points.attrs["orbit_period"])

    @property
    def events(self) -> tuple[BranchEvent, ...]:
        """Events of the branch, in the order of its points."""
        return events_from(self.points)

    def events_named(self, label: str) -> tuple[BranchEvent, ...]:
        """Gives the events with a label such as "PD"."""
        return tuple(event for event in self.events if event.label == label)

    def __repr__(self) -> str:
        return self.summary()

    def summary(self) -> str:
        """Gives the branch in words, with a table of its events."""
        varied, ds = self.parameter, self.points
        values = ds[varied.name].values
        shown = lambda value: f"{varied.shown(value):.8g}"
        reasons = [reason or "start" for reason in ds.attrs["ended"]]
        ends = [f"{shown(values[k])} ({reason})" for k, reason in zip((0, -1), reasons, strict=True)]
        title = f"{varied.name} [{varied.display_unit}]"
        lines = [
            f"OrbitBranch of period {self.period} over {varied.name}: {len(values)} points, "
            f"{int(np.sum(ds['stable'].values))} stable, from {ends[0]} to {ends[1]} {varied.display_unit}",
            f"  {'label':5}  {title:>20}  {'+-':>7}  {'multiplier':>22}  outside",
        ]
        outside = ds["outside"].values
        for event in self.events:
            mu, error = event.multiplier, varied.shown(event.high - event.low) / 2
            critical = "" if np.isnan(mu.real) else f"{mu.real:.5f}" + (f"{mu.imag:+.5f}i" if mu.imag else "")
            sure = f"{error:.0e}" if event.converged else "unsure"
            lines.append(
                f"  {event.label:5}  {shown(event.value):>20}  {sure:>7}  {critical:>22}  {outside[event.point]:>7}"
                f"  {event.note}".rstrip()
            )
        return "\n".join(lines)

    def to_netcdf(self, path: Any) -> None:
        """Writes `points`, whole or not at all; `load_branch` reads it."""
        write_whole(Path(path), self.points.to_netcdf(engine="h5netcdf"))

    def orbit(self, point: int | BranchEvent) -> PeriodicOrbit:
        """Gives the orbit at a point, or at an event."""
        ds = self.points.isel(point=point.point if isinstance(point, BranchEvent) else point)
        run = _Run.again(self, None)
        return PeriodicOrbit(
            scene=self.parameter.replaced(self.scene, ds[self.parameter.name].values),
            state=run.equations.state(jnp.asarray(ds["state"].values)),
            multipliers=jnp.asarray(ds["multiplier_real"].values + 1j * ds["multiplier_imag"].values),
            residual=jnp.asarray(ds["residual"].values),
            iterations=jnp.asarray(ds["iterations"].values),
            status=jnp.asarray(0),
            period=self.period,
            steps_per_period=run.steps,
            solver=run.solver,
        )

    def extended(self, bounds: tuple[float, float] | None = None, **options: Any) -> "OrbitBranch":
        """Follows the branch further: where it was interrupted, met an event of `until`, ended for the number of its
        points, or met a bound.

        **Arguments:** `bounds`: of the parameter, default as before; `options`: `points`, `until` and `progress` of
        `continue_orbit`.
        """
        run = _Run.again(self, bounds)
        return run.follow(lambda **how: extend_motion(self.branch, run.bounds, **how), **options)

    def switched(
        self, event: BranchEvent, *, bounds: tuple[float, float] | None = None, **options: Any
    ) -> "OrbitBranch":
        """Follows the branch that leaves at a flip, of twice the period, or at a branch point.

        **Arguments:** as for `extended`.

        **Raises:** `ValueError` for other events, or where no orbit is found off this branch.
        """
        run = _Run.again(self, bounds)
        node = self.branch.nodes[event.point]
        equations, spot = switch(self.branch, _analysed(event, node))
        run = dataclasses.replace(run, equations=equations)
        walk = lambda **settings: continue_motion(equations, spot, run.bounds, ways=(1,), **settings)
        return run.follow(walk, **options)

    @property
    def branch(self) -> Branch:
        """Branch as `slipperjax.analysis` has it; that of a file is computed once more at its points."""
        if self._branch is not None:
            return self._branch
        run, ds = _Run.again(self, None), self.points
        z = np.column_stack([ds["state"].values, ds[self.parameter.name].values])
        weights = np.array([np.asarray(run.equations.weights(jnp.asarray(unknowns))[1]) for unknowns in z])
        rows = weights**2 * ds["tangent"].values
        nodes = []
        for unknowns, row, label in zip(z, rows, ds["label"].values, strict=True):
            spot = jax.device_get(correct(run.equations, unknowns, row, tolerance=1.0))
            nodes.append(as_node(spot, run.observe)._replace(label=str(label)))
        events = tuple(_analysed(event, nodes[event.point]) for event in self.events)
        ends = tuple(map(End, ds.attrs["ended"], np.asarray(ds.attrs["next_steps"], float).tolist()))
        branch = Branch(run.equations, tuple(nodes), events, (ends[0], ends[1]))
        object.__setattr__(self, "_branch", branch)  # a cache in a frozen dataclass
        return branch


def _analysed(event: BranchEvent, node: Node) -> Event:
    """Gives an event as `slipperjax.analysis` has it."""
    return Event(event.label, node, event.low, event.high, event.multiplier, event.converged, event.note)


def load_branch(source: Any) -> OrbitBranch:
    """Loads a branch from a netCDF file, or from the dataset of one.

    **Raises:** `ValueError` for other files and datasets; `OSError` for a file that cannot be read.
    """
    ds = dataset_of(source)
    if "call" not in ds.attrs or load_call(ds)["function"] != "continue_orbit":
        raise ValueError(f"Argument `source` must be a result of continue_orbit, but is {brief(source)}.")
    return OrbitBranch(ds)


@dataclasses.dataclass(frozen=True)
class _Run:
    """Settings with which a branch is computed."""

    scene: Scene
    name: str
    equations: SlipperMotions
    bounds: tuple[float, float]
    steps: int
    solver: Any
    tolerance: float

    @classmethod
    def new(cls, scene, name, bounds, period, steps, solver, tolerance, like) -> "_Run":
        """Makes those of a new branch."""
        stepping = dynamic_steps(steps)
        reach = (bounds[1] - bounds[0],)
        equations = slipper_motions(scene, (name,), reach, like, stepping=stepping, solver=solver, period=period)
        return cls(scene, name, equations, bounds, steps, solver, tolerance)

    @classmethod
    def again(cls, branch: OrbitBranch, bounds: tuple[float, float] | None) -> "_Run":
        """Makes those of a branch, with other bounds. Lengths along the branch stay those of the first bounds."""
        call, (scene, start) = load_call(branch.points), load_base(branch.points)
        settings = call["steps_per_period"], call["solver"], call["tolerance"]
        first = tuple(call["bounds"])
        run = cls.new(scene, call["parameter"], first, branch.period, *settings, initial_state(scene, start))
        return run if bounds is None else dataclasses.replace(run, bounds=bounds_of(branch.parameter, bounds))

    def observe(self, spot: Spot) -> Observation:
        """Observes the contacts and sections of an orbit."""
        # the same equations with samples inside the periods, as one program for all points
        stepping = dynamic_steps(self.steps, inside=True)
        equations = dataclasses.replace(
            self.equations, family=dataclasses.replace(self.equations.family, stepping=stepping)
        )
        sections = Sections()
        records = RecordSet((GapSamples(), sections))
        ((gap, rate), crossed), period = call_compiled(_samples, equations, (records,), jnp.asarray(spot.z))
        one_case = jax.tree.map(lambda a: np.asarray(a)[None], crossed)
        span = RecordedSpan(self.equations.intervals, self.steps, 0.0, np.zeros(1, int))
        crossings = jax.tree.map(lambda a: a[0], sections.finish(None, one_case, span))
        gaps = Gaps.of(gap, rate, self.steps, float(period))
        touches = grazing(gaps)
        view = OrbitView(touches, signature(self.scene, gaps), crossings)
        return Observation(tuple(touches.touchdowns.tolist()), tuple(touches.margin.tolist()), view)

    def follow(
        self, walk: Any, *, points: int = 400, until: Sequence[str] = (), progress: bool = False
    ) -> OrbitBranch:
        """Gives the branch that `walk` makes as a result; after Ctrl-C raises `Interrupted` with it."""
        varied, until = parameter(self.name, self.scene), labels(until)
        with Bar(progress, f"branch over {varied.name}", varied) as bar:
            show = lambda node: bar.show(node.spot.z[-1])
            settings: dict[str, Any] = dict(tolerance=self.tolerance, pace=BRANCH_PACE, points=points, until=until)
            branch = walk(observe=self.observe, on_point=show, **settings)
        states = jax.vmap(self.equations.state)(jnp.asarray(np.array([node.spot.z for node in branch.nodes])))
        call = dict(
            bounds=list(self.bounds),
            period=branch.equations.intervals,
            steps_per_period=self.steps,
            solver=self.solver,
            tolerance=self.tolerance,
        )
        return finished(OrbitBranch(branch_dataset(branch, self.scene, self.name, states, call), branch))


def _samples(equations: SlipperMotions, static: tuple, z: Any) -> tuple:
    """Gives the samples of records along an orbit, and the length of a period [s]."""
    step: PeriodMap = equations.step(z)  # type: ignore[assignment]
    passage = step.run(equations.state(z), periods=equations.intervals, records=static[0])
    return passage.samples, step.scene.period


def finished(result: Any) -> Any:
    """Gives a branch or curve back; raises `Interrupted` with it where it ended by Ctrl-C."""
    if "interrupted" in result.points.attrs["ended"]:
        raise Interrupted(result, result.points.sizes["point"], unit="points")
    return result


class Bar:
    """Progress bar of points, at each of which Ctrl-C of a command is polled."""

    def __init__(self, shown: bool, text: str, varied: Parameter):
        self.varied, self.bar = varied, None
        if shown:  # in a notebook without widgets the import alone gives a warning
            from tqdm.auto import tqdm

            self.bar = tqdm(desc=text, unit=" points")

    def __enter__(self):
        return self

    def __exit__(self, *_: Any) -> None:
        if self.bar is not None:
            self.bar.close()

    def show(self, value: Any) -> None:
        """Counts one more point, with this value of the parameter [SI unit]."""
        if ASKED.is_set():
            raise KeyboardInterrupt
        if self.bar is None:
            return
        self.bar.set_postfix_str(f"{self.varied.shown(float(value)):.6g} {self.varied.display_unit}", refresh=False)
        self.bar.update()


def bounds_of(varied: Parameter, bounds: Any) -> tuple[float, float]:
    """Gives two values of a parameter, the smaller first; raises `ValueError` for others."""
    if not (isinstance(bounds, Sequence | np.ndarray) and len(bounds) == 2 and float(bounds[0]) < float(bounds[1])):
        raise ValueError(
            f"Argument `bounds` must be two values of {varied.name} [{varied.unit}], the smaller first, but is "
            f"{bounds!r}."
        )
    low, high = (float(varied.checked(value)) for value in bounds)
    return low, high


def value_within(scene: Scene, name: str, varied: Parameter, bounds: tuple[float, float]) -> float:
    """Gives the scene's value of a parameter; raises `ValueError` where it lies outside the bounds."""
    value = float(scene.value(name))
    if not bounds[0] <= value <= bounds[1]:
        raise ValueError(
            f"Argument `bounds` must hold the scene's {name}, {shown_number(value)} {varied.unit}, but is "
            f"{shown_number(bounds[0])} to {shown_number(bounds[1])}."
        )
    return value


def labels(until: Any) -> tuple[str, ...]:
    """Gives labels of events; raises `ValueError` for others."""
    choices = tuple(label for label in MEANINGS if label not in ("EP", "MX"))
    if isinstance(until, str) or not all(label in choices for label in until):
        raise ValueError(f"Argument `until` must be a tuple of labels of {', '.join(choices)}, but is {until!r}.")
    return tuple(until)


def steps_of_branch(scene: Scene, varied: Parameter, bounds: tuple[float, float], steps: int | None) -> int:
    """Gives the integration steps per forcing period of a branch, as given or by default, see `continue_orbit`."""
    if steps is not None:
        return whole("steps_per_period", steps, 1)
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
    progress: bool = False,
) -> OrbitBranch:
    """Follows an orbit through a parameter both ways, stable or not, past folds, and names and locates events.

    Folds (LP), flips (PD), Neimark-Sackers (NS) and branch points (BP) are detected by the multipliers, grazings (GR)
    by the touchdowns of each contact point and by extremes of its gap within steps; all are located, and no grazing
    is stepped over silently.

    **Arguments:**

    - `scene`: with the parameter's value at which the branch begins. `name`: of the parameter, or its path; `bounds`:
        of its values [SI unit].
    - `start`, `period`: as for `periodic_orbit`, or an orbit that it found.
    - `steps_per_period`: default `FINER` times that of the more demanding bound; `solver`: as for `simulate`, steps
        being constant.
    - `tolerance`: scaled residual of the orbits [1]. `points`: most points of each way. `progress`: shows a bar.
    - `until`: labels of events after which a way is not followed further, such as ("LP", "PD"); default none.

    **Returns:** an `OrbitBranch`.

    **Raises:** `ValueError` that names the argument which is wrong, also where there is no orbit near the start;
    `Interrupted` after Ctrl-C, with the branch until then as its `result`, whose method `extended` goes on.
    """
    check_scene(scene)
    check_forcing(scene)
    varied = parameter(name, scene)
    bounds, until = bounds_of(varied, bounds), labels(until)
    tolerance, points = number(positive, "tolerance", tolerance), whole("points", points, 1)
    value, solver = value_within(scene, name, varied, bounds), resolve_solver(scene, solver)
    steps = steps_of_branch(scene, varied, bounds, steps_per_period)
    if not isinstance(start, PeriodicOrbit):
        start = periodic_orbit(scene, period, start=start, steps_per_period=steps, solver=solver, tolerance=tolerance)
        if int(start.status):
            raise ValueError(f"Argument `start` must be near a periodic orbit, but: {start!r}")
    run = _Run.new(scene, name, bounds, start.period, steps, solver, tolerance, start.state)
    walk = lambda **settings: continue_motion(run.equations, (start.state, value), bounds, **settings)
    return run.follow(walk, points=points, until=until, progress=progress)
