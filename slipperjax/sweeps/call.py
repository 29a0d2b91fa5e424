"""Arguments of a sweep as one frozen object, kept with its results and compared before a store continues."""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from diffrax import AbstractSolver

from ..flow.record import History, RecordSet
from ..flow.status import MEANINGS
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..orbits.simulate import beginning_of, check_rail, step_plan
from ..results.result import Result
from ..solvers.named import resolve_solver
from ..tools.checks import known, require, whole, yes_or_no
from ..tools.columns import column
from .engine import PartRun, run_plan
from .estimate import Estimate
from .exponents import LyapunovExponents
from .grid import Cases, Grid
from .orbits import NearestOrbit
from .plan import AbstractStage, Plan
from .records import resolved_record
from .schedule import Schedule


@dataclass(frozen=True, kw_only=True)
class AbstractCall(abc.ABC):
    """Arguments that sweeps and runs have in common, in the form that a user gives."""

    record: object = ()
    steps_per_period: int | Sequence[int] | np.ndarray | None = None
    refine: int = 1
    """Factor of the default steps [1]."""
    solver: AbstractSolver | str | None = None
    product: bool = True
    """Whether the grid is a product of its axes; False: one case for each place in the lists."""
    function: str = "sweep"
    """Name of the function that was called."""

    def __post_init__(self):
        refined(self.refine, self.steps_per_period)

    @abc.abstractmethod
    def plan(self, cases: Cases, *outputs: RecordSet | tuple[AbstractStage, ...]) -> Plan:
        """Return the plan of some cases, all of a grid or a sample.

        **Arguments:** `outputs`: records and stages in place of the call's.

        **Raises:** `ValueError` that names the wrong argument.
        """

    def estimate(self, grid: Grid, start: Motion | State) -> Estimate:
        """Return the estimate of all cases of a grid, before anything is compiled."""
        return self.plan(grid.sample(start)).estimate(grid.count)

    @abc.abstractmethod
    def dataset(self, plan: Plan, results: PartRun) -> xr.Dataset:
        """Return the results of a run as a dataset."""

    def compute(self, scene: Scene, grid: Mapping[str, object], start: Motion | State, **how: object) -> Result:
        """Return the results of all cases of a grid. **Arguments:** `how`: of `run_cases`.

        **Raises:** as `make_plan`; `Interrupted` after Ctrl-C.
        """
        plan = make_plan(Grid(scene, grid, product=self.product), start, self)
        run = run_plan(plan, how)
        return run.checked(lambda: Result(self.dataset(plan, run.results)))


def make_plan(
    grid: Grid, start: Motion | State, call: AbstractCall, *outputs: RecordSet | tuple[AbstractStage, ...]
) -> Plan:
    """Return the plan of all cases of a grid. **Arguments:** `outputs`: records and stages in place of the call's.

    **Raises:** `ValueError` that names the wrong argument, or memory and time of an impossible run.
    """
    cases = grid.sample(start)  # first, so that warnings of implausible values come first
    grid.check_steps(call.steps_per_period)
    plan = call.plan(cases, *outputs)
    plan.estimate(grid.count).check()  # before all cases are made, because they may not fit into memory
    if cases.count < grid.count:
        plan = call.plan(grid.sample(start, grid.count), *outputs)
    plan.check()
    plan.cases.warn_of_excitation()
    return plan


@dataclass(frozen=True)
class Call(AbstractCall):
    """Lengths, records and numerics of a sweep in the form that a user gives, see `slipperjax.sweep`."""

    settled: int
    """Forcing periods before the measurement."""
    measured: int
    """Forcing periods that are recorded, or over which exponents are measured."""
    saves_per_period: int | None = None
    begin: float | None = None
    """Place where the run begins [m]; None for the beginning of its rail."""
    loads: bool | None = None
    probe: bool | None = None

    def __post_init__(self):
        # errors name the arguments as in `sweep`
        whole("transient", self.settled, 0)
        whole("periods", self.measured, 1)
        super().__post_init__()

    def plan(self, cases: Cases, records: RecordSet | None = None, stages: tuple[AbstractStage, ...] = ()) -> Plan:
        call = self
        if records is None:
            call, records, stages = self._asked()
        scene = cases.scene
        default = lambda: self.refine * cases.default_steps()
        steps, saves = step_plan(default, self.steps_per_period, self.saves_per_period)
        solver = resolve_solver(scene, self.solver)
        # histories get their saves from the run
        kept = tuple(History(saves) if one == History() else one for one in records.records)
        begin = beginning_of(scene, known("begin", self.begin))
        epoch = 0.0
        if begin:
            # a batch begins at one number of periods
            lengths = np.unique(cases.wavelengths())
            need = "be zero where cases differ in the length of their forcing periods"
            require(len(lengths) == 1, "begin", need, begin)
            epoch = begin / float(lengths[0])
        different, which = np.unique(np.broadcast_to(steps, np.shape(steps) or cases.count), return_inverse=True)
        of_steps = lambda number: Schedule.of(call.settled, call.measured, number, int(call.probe or 0))
        schedules = tuple(map(of_steps, different.tolist()))
        plan = Plan(cases, solver, RecordSet(kept), schedules, which, stages, epoch)
        # stages travel further along the rail than the plan itself
        check_rail(scene, plan.periods, begin, plan.settled, plan.periods_after)
        return plan

    def _asked(self) -> tuple["Call", RecordSet, tuple[AbstractStage, ...]]:
        """Return the call with the lengths of its transient and recorded span and whether errors are measured, its
        records and its stages.

        Where the call asks only for exponents and orbits, the transient becomes the recorded span, at whose end these
        begin.
        """
        records, stages = resolved_record(self.record, self.loads)
        settled = self.settled
        measured = self.measured
        # records without variables, such as the last strobes, only serve the stages
        kept = any(one.variables for one in records.records)
        if not kept and all(isinstance(one, LyapunovExponents | NearestOrbit) for one in stages):
            measured = whole("transient", settled, max(one.least_settled for one in stages))
            settled = 0
            stages = tuple(one.over(self.measured) for one in stages)
        # a measured error takes as long as three periods without a record, and records inside double a period's time
        lasts = settled + (2 if records.inside else 1) * measured
        little = settled > 0 and lasts >= 30
        probe = little if self.probe is None else yes_or_no("probe", self.probe)
        return replace(self, settled=settled, measured=measured, probe=probe), records, stages

    def dataset(self, plan: Plan, results: PartRun, first: Mapping[str, list] = {}, **more: object) -> xr.Dataset:
        """Return the results of a run as a dataset.

        **Arguments:** `first`: coordinates of dimensions before those of the grid, by name; `more`: further arguments
        of the call, for the attribute `call`.
        """
        cases = plan.cases
        dims = (*first, *cases.dims)
        # the flat list of cases becomes the grid again
        shape = (*map(len, first.values()), *cases.shape)
        results = results.over(shape)
        data, coords = plan.label(dims, results.record)
        data["status"] = column(dims, results.status, "", "status", meaning=MEANINGS)
        if results.probe.size:
            text = "what half the step changes in a forcing period, in scales"
            data["probe_error"] = column(dims, results.probe[..., 0], "1", text)
        steps = np.broadcast_to(plan.steps.reshape(cases.shape), shape)
        data["steps_per_period"] = column(dims, steps, "1", "integration steps per forcing period")
        if "time" in [dim for dim, *_ in coords.values()]:  # of histories
            seconds = cases.forcing_periods().reshape(*cases.shape, 1) * coords["period"][1]
            coords["seconds"] = column((*cases.dims, "time"), seconds, "s", "time")
        facts = {"settled": self.settled, "measured": plan.recorded}
        if plan.settled != self.settled:  # the recorded span was the transient, see `_asked`
            facts["measured"] = max(one.measured for one in plan.stages)
        # the steps of each case are a variable
        asked = replace(self, steps_per_period=None, refine=1)
        return plan.dataset(data, {**coords, **first}, vars(asked) | more, facts)


def refined(refine: int, steps_per_period: object) -> int:
    """Return the factor of the default steps [1].

    **Raises:** `ValueError` where it is no whole number from 1 to 1000, or is not 1 together with given steps.
    """
    refine = whole("refine", refine, 1, 1000)
    good = refine == 1 or steps_per_period is None
    require(good, "refine", "be 1 where steps_per_period is given", refine)
    return refine
