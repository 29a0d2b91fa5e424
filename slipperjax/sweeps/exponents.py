"""Lyapunov exponents of many cases: a record that continues the motions, with a certificate for each case.

After the recorded periods, periodic cases get the exponents of their orbits. Other cases are measured, and chaotic
cases among them run for longer. Each of these groups is divided into new chunks.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..analysis.floquet import largest_exponent
from ..analysis.kinds import Regime, lasting
from ..analysis.lyapunov import (
    dimension_standard_error,
    is_chaotic,
    kaplan_yorke,
    one_motion_standard_error,
    pooled_standard_error,
    regime,
    standard_error,
    weighted_mean,
)
from ..flow.period_map import advance_tangents, initial_tangents
from ..flow.record import Labelled
from ..flow.status import Status, first_problem
from ..model.dynamics import State
from ..model.layout import coordinates
from ..orbits.exponents import check_count
from ..orbits.simulate import dynamic_steps
from ..tools.checks import whole, yes_or_no
from ..tools.columns import column
from .attractors import LAST, classify_motions
from .engine import run_cases, run_part
from .orbits import Maps, rows_of
from .plan import AbstractStage, Part, Plan
from .reached import ReachedOrbits, reached_orbits

BLOCK = 20
"""Forcing periods in one call; the first such block aligns the tangents with their directions and does not count."""


# --- measuring ------------------------------------------------------------------------------------------------------


def counted_periods(periods: int | None, recorded: int) -> int:
    """Return the periods that count, `periods` rounded up to whole blocks; with None the number `recorded`.

    A measurement takes one more block.
    """
    return -(-(recorded if periods is None else periods) // BLOCK) * BLOCK


class LocalExponents(NamedTuple):
    """Local Lyapunov exponents of a chunk, the logarithms of growth in each period [1/period]."""

    history: Float[np.ndarray, "cases periods count"]
    status: Int[np.ndarray, " cases"]
    # States once per period in the last `LAST` counted periods, or in all if they are fewer.
    strobe: Float[np.ndarray, "cases last 10"]
    state: State  # the states at the end


def measure(part: Part, states: State, epoch: float, counted: int, count: int, finer: int = 1) -> LocalExponents:
    """Measure local exponents of a chunk from its states, `epoch` forcing periods after distance zero.

    **Arguments:** `counted`: periods that count; `finer`: 2 for half the step.
    """
    tangents = initial_tangents(part.scenes, states, count)
    stepping = dynamic_steps(finer * part.steps)
    status = np.zeros(len(states.motion.y), int)
    rows = []
    strobes = []
    for passed in range(0, counted + BLOCK, BLOCK):
        at = epoch + passed
        states, tangents, history, strobe, codes = advance_tangents(
            part.scenes, states, tangents, at, stepping, solver=part.plan.solver, periods=BLOCK
        )
        status = first_problem(status, codes)
        if passed:  # the first block aligns the tangents with their directions
            rows.append(np.asarray(history))
            strobes = [*strobes, np.asarray(strobe)][-LAST // BLOCK :]  # blocks with the last `LAST` periods
        part.on_progress(BLOCK)
    return LocalExponents(np.concatenate(rows, axis=1), status, np.concatenate(strobes, axis=1), states)


# --- whether chaos lasts --------------------------------------------------------------------------------------------

# While a chaotic transient lasts, no measurement can distinguish it from chaos. Therefore some motions begin close to
# its last state. Within tens of periods they no longer depend on each other, so that each motion is a further trial
# of how long the transient may last. Because their records are independent, the scatter of their exponents shows
# correlations that are longer than a record.

MOTIONS = 4
"""Motions for each case."""
HOLD = 2000
"""Forcing periods that they run before their exponents are measured."""


class LongerMotions(NamedTuple):
    """Longer motions of some cases."""

    chosen: Int[np.ndarray, " cases"]  # indices of the cases into the list of all
    history: Float[np.ndarray, "cases motions periods count"]  # their local exponents [1/period]
    escapes: Int[np.ndarray, " cases"]  # number of motions that became regular, or have no positive exponent
    # A `Status` code of the motions, 0 where nothing is wrong with any; `NOT_RUN` where one motion was not finished.
    status: Int[np.ndarray, " cases"]

    @classmethod
    def not_run(cls, chosen: Int[np.ndarray, " cases"], count: int) -> "LongerMotions":
        """Return the longer motions of cases where no motion was finished."""
        history = np.full((len(chosen), MOTIONS, BLOCK, count), np.nan)
        return cls(chosen, history, 0 * chosen, np.full(len(chosen), int(Status.NOT_RUN)))


def run_longer_motions(
    plan: Plan,
    chosen: Int[np.ndarray, " cases"],
    states: State,
    epoch: int,
    counted: int,
    count: int,
    options: Mapping[str, object],
) -> tuple[LongerMotions, bool]:
    """Run `MOTIONS` motions of each chosen case, for `HOLD` periods, and then measure their exponents.

    **Arguments:** `plan`: of the sweep; `chosen`: indices of the cases; `states`: of all cases at the start of the
    period `epoch`; `counted`, `count`: of the measurement, see `measure`; `options`: for `run_cases`.

    **Returns:** the longer motions, and whether the run was interrupted.
    """
    plan = plan.strobes(HOLD - LAST, LAST)

    def work(part: Part) -> LocalExponents:
        begin = jax.tree.map(lambda a: a[part.index], states)
        # the motions of a case follow each other in the list; their lateral velocities differ [m/s]
        apart = 1e-6 * (part.row % MOTIONS)
        begin = eqx.tree_at(lambda s: s.motion.v_y, begin, begin.motion.v_y + apart)
        run = run_part(part, begin, epoch)
        local = measure(part, run.state, plan.epoch + epoch + plan.periods, counted, count)
        return local._replace(status=first_problem(run.status, local.status), strobe=run.record[0])

    run = run_cases(
        plan,
        work,
        periods=HOLD + counted + BLOCK,
        index=np.repeat(chosen, MOTIONS),
        tangents=True,
        name=f"longer motions of {len(chosen)} chaotic cases",
        **options,
    )
    if run.results is None:
        return LongerMotions.not_run(chosen, count), True
    history, status, strobe, _ = run.results
    # from a list of motions to an array of cases and motions
    by_case = lambda a: a.reshape(len(chosen), MOTIONS, *a.shape[1:])
    codes = by_case(status)
    unfinished = np.any(codes == Status.NOT_RUN, axis=1)
    # a motion may leave chaos during the measurement, possibly to a torus; an exponent below 0.01 is no chaos
    late = history[:, history.shape[1] // 2 :, 0].mean(axis=1)
    regular = (classify_motions(strobe, status).kind == Regime.PERIODIC) | (late <= 0.01)
    return LongerMotions(
        chosen,
        by_case(history),
        np.sum(by_case(regular), axis=1),
        np.where(unfinished, int(Status.NOT_RUN), codes.max(axis=1)),
    ), run.interrupted


def least_mean_life(measured: int) -> float:
    """Return the least mean life of chaos with 95 % confidence [forcing periods], if no longer motion became regular.

    If chaos ended at a constant rate, one of the motions would have become regular with a chance of 95 % when the
    motions' durations add up to three mean lives.

    **Arguments:** `measured`: forcing periods over which each motion was measured.
    """
    return MOTIONS * (HOLD + measured + BLOCK) / -np.log(0.05)


# --- the certificate ------------------------------------------------------------------------------------------------

AGREE = 1e-3
"""Differences between exponents [1/period] that are accepted for all standard errors."""
STEADY = 1e-2
"""Differences between the halves of a record [1/period] that are accepted for all standard errors."""


class Checks(NamedTuple):
    """Other estimates of the largest exponents, which certify the cases."""

    half_step: Float[np.ndarray, "cases periods 1"]
    half_step_status: Int[np.ndarray, " cases"]
    # ln |largest multiplier| per forcing period of periodic motions [1/period], NaN for other motions.
    floquet: Float[np.ndarray, " cases"]


class CaseExponents(NamedTuple):
    """Exponents of cases."""

    status: Int[np.ndarray, " cases"]
    kind: Int[np.ndarray, " cases"]  # numbers of `slipperjax.analysis.Regime`
    period: Int[np.ndarray, " cases"]  # forcing periods of a periodic motion, 0 for others
    history: Float[np.ndarray, "cases periods count"]
    state: State
    checks: Checks | None


def exponent_variables(
    passed: int,
    measured: CaseExponents,
    reached: ReachedOrbits,
    by_orbit: Bool[np.ndarray, " cases"],
    longer: LongerMotions,
) -> dict[str, np.ndarray]:
    """Return the variables of `LyapunovExponents` by name, with the certificate where checks were made.

    **Arguments:** `passed`: forcing periods before the measurement; `by_orbit`: whether a case gets the exponents of
    its orbit, and was not measured; `longer`: finished longer motions of chaotic cases.
    """
    good = measured.status == Status.FINITE
    chosen = longer.chosen
    history = measured.history
    exponent = history.mean(axis=1)
    error = standard_error(history)
    weighted = weighted_mean(history)
    alone = is_chaotic(exponent[:, 0], error[:, 0])  # cases with longer motions use those
    error[alone] = one_motion_standard_error(history[alone])
    stayed = longer.escapes == 0
    pooled = chosen[stayed]
    motions = longer.history[stayed]
    exponent[pooled] = motions.mean(axis=(1, 2))
    error[pooled] = pooled_standard_error(motions)
    dimension = dimension_standard_error(history)
    # the motions of a case are independent
    each = dimension_standard_error(motions)
    dimension[pooled] = np.sqrt(np.mean(each**2, axis=-1) / MOTIONS)
    # the exponents of an orbit are exact
    exponent[by_orbit] = weighted[by_orbit] = reached.exponents[by_orbit]
    error[by_orbit] = 0.0
    escapes = np.zeros(len(good), int)
    escapes[chosen] = longer.escapes
    # chaos that stayed has lasted through both measurements, and the periods between them
    stretch = history.shape[1] + BLOCK
    chaotic_for = np.zeros(len(good), int)
    chaotic_for[chosen] = passed + stretch + stayed * (HOLD + stretch)
    life = np.full(len(good), np.nan)
    life[pooled] = least_mean_life(history.shape[1])
    kind = np.where(good, Regime.kind_names(measured.kind), Regime.UNRESOLVED.kind_name)
    variables: dict[str, np.ndarray] = {}
    if measured.checks is not None:
        variables = _checked(measured, measured.checks, longer, exponent[:, 0], error[:, 0])
        half_step = reached.half_step[by_orbit]
        variables["half_step"][by_orbit] = half_step
        variables["half_step_stderr"][by_orbit] = 0.0
        variables["floquet"][by_orbit] = exponent[by_orbit, 0]
        variables["resolved"][by_orbit] = np.abs(half_step - exponent[by_orbit, 0]) <= STEADY
    return variables | {
        "exponent": exponent,
        "stderr": error,
        "weighted_exponent": weighted,
        "by_orbit": by_orbit,
        "kind": kind,
        "period": np.where(good, measured.period, 0),
        "regime": regime(exponent[:, 0], error[:, 0], kind, variables.get("resolved", good), escapes),
        "escapes": escapes,
        "chaotic_for": chaotic_for,
        "least_mean_life": life,
        "kaplan_yorke": kaplan_yorke(exponent),
        "kaplan_yorke_stderr": np.where(by_orbit, 0.0, dimension),
    }


def _checked(
    measured: CaseExponents,
    checks: Checks,
    longer: LongerMotions,
    exponent: np.ndarray,
    error: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return the other estimates, and whether they agree with the largest exponents within their standard errors.

    `slipperjax.lyapunov_sweep` states the conditions.
    """
    good = measured.status == Status.FINITE
    agree = good & (checks.half_step_status == Status.FINITE)
    agree[longer.chosen] &= longer.status == Status.FINITE
    # the scatter of the longer motions shows long correlations, which one record does not show
    of_one = np.zeros_like(error)
    of_one[longer.chosen] = np.sqrt(MOTIONS) * error[longer.chosen] * (longer.escapes == 0)
    half = checks.half_step.mean(axis=1)[:, 0]
    half_error = np.maximum(standard_error(checks.half_step)[:, 0], of_one)
    agree &= np.abs(half - exponent) <= np.maximum(3 * np.hypot(error, half_error), AGREE)
    rows = measured.history[..., 0]
    middle = rows.shape[1] // 2
    first = rows[:, :middle].mean(axis=1)
    second = rows[:, middle:].mean(axis=1)
    # each half has twice the variance of the whole
    of_record = np.maximum(standard_error(measured.history)[:, 0], of_one)
    agree &= np.abs(first - second) <= np.maximum(3 * 2 * of_record, STEADY)
    periodic = (measured.period > 0) & good
    agree &= ~periodic | (np.abs(checks.floquet - weighted_mean(measured.history)[:, 0]) <= AGREE)
    floquet = np.where(good, checks.floquet, np.nan)
    return {"half_step": half, "half_step_stderr": half_error, "floquet": floquet, "resolved": agree}


# --- the record -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LyapunovExponents(AbstractStage):
    """The largest Lyapunov exponents of each case, with a certificate, see `slipperjax.lyapunov_sweep`.

    Exponents come from the orbit that a case has reached at the end of the recorded periods, or from a measurement.
    """

    count: int = 1
    """Number of exponents, the largest first."""
    periods: int | None = None
    """Forcing periods of the measurement, rounded up to multiples of `BLOCK`; None: as many as are recorded."""
    certify: bool = True
    """Whether each case is checked."""
    orbits: bool = True
    """Whether exponents come from orbits where possible; otherwise all cases are measured."""

    def __post_init__(self):
        whole("count", self.count, 1)
        if self.periods is not None:
            whole("periods", self.periods, 1)
        yes_or_no("certify", self.certify)
        yes_or_no("orbits", self.orbits)

    name = "exponents"
    least_settled = BLOCK

    @property
    def measured(self) -> int:
        """Forcing periods over which each case is measured."""
        return counted_periods(self.periods, 0)

    def over(self, periods: int) -> "LyapunovExponents":
        """Return the same stage, measured over `periods` unless it has its own number of periods."""
        return replace(self, periods=periods) if self.periods is None else self

    @property
    def labels(self) -> dict[str, tuple[str, str]]:
        """Unit and description of each variable, by name."""
        labels = {
            "exponent": ("1/period", "Lyapunov exponents"),
            "stderr": ("1/period", "standard error of the exponents"),
            "weighted_exponent": ("1/period", "Lyapunov exponents by a smoothly weighted mean"),
            "by_orbit": ("", "whether the exponents are those of the periodic orbit that was reached"),
            "kind": ("", "kind of motion, by recurrence"),
            "period": ("1", "forcing periods of a periodic motion, 0 for others"),
            "regime": ("", "periodic, regular (neither periodic nor chaotic), chaotic, transient or unresolved"),
        }
        if self.count > 1:
            labels["kaplan_yorke"] = ("1", "Kaplan-Yorke dimension")
            labels["kaplan_yorke_stderr"] = ("1", "standard error of the Kaplan-Yorke dimension")
        if self.certify:
            regular = f"motions of {MOTIONS} that became regular within {HOLD} more forcing periods"
            labels |= {
                "half_step": ("1/period", "largest exponent with half the step"),
                "half_step_stderr": ("1/period", "standard error of the largest exponent with half the step"),
                "floquet": ("1/period", "ln of the largest Floquet multiplier's modulus, per forcing period"),
                "resolved": ("", "whether the other estimates agree"),
                "escapes": ("1", regular),
                "chaotic_for": ("1", "forcing periods for which chaos lasted at least, 0 for other motions"),
                "least_mean_life": ("1", "least mean life of chaos in forcing periods, with 95 % confidence"),
            }
        return labels

    @property
    def variables(self):
        return tuple(self.labels)

    def values(self, scene, periods):
        measured = counted_periods(self.periods, periods) + BLOCK
        return measured * (self.count + self.certify)

    def check(self, scene, periods, steps):
        check_count(scene, self.count)
        whole("periods", periods, BLOCK)

    def periods_after(self, periods):
        measured = counted_periods(self.periods, periods) + BLOCK
        return measured + (HOLD + measured) * self.certify

    def of_chunk(self, part, states, epoch, status, strobe):
        """Return the states of a chunk, and the orbits that they have reached."""
        states = jax.tree.map(np.asarray, states)
        maps = Maps.of(part, (part.good(status) & self.orbits).astype(int))
        reached = reached_orbits(
            maps, states, coordinates(State(strobe, None)), count=self.count, half_step=self.certify
        )
        periodic = np.flatnonzero(reached.period)
        if len(periodic):
            maps = Maps.of(part, reached.period, epoch)
            codes = maps.contact_status(periodic, rows_of(reached.state)[periodic], part.capacity)
            # a case whose contacts give a bad status is measured, because the measurement shows the reason
            reached.period[periodic[codes != Status.FINITE]] = 0
        return (states, reached), status

    def of_all(self, values, status, plan, how, interrupted):
        """Measure the cases that have not reached an orbit; with `certify`, run chaotic cases for longer."""
        after, reached = values
        no_orbit = status == Status.NO_ORBIT  # another stage found no orbit; the motion itself may be good
        status = np.where(no_orbit, int(Status.FINITE), status)
        by_orbit = (reached.period > 0) & (status == Status.FINITE)
        counted = counted_periods(self.periods, plan.recorded)
        measured = self._unmeasured(after, counted)
        measured.status[by_orbit] = Status.FINITE
        measured.kind[by_orbit] = Regime.PERIODIC
        measured.period[by_orbit] = reached.period[by_orbit]

        def work(part: Part) -> CaseExponents:
            states = jax.tree.map(lambda a: a[part.index], after)
            return self._measured(part, states, counted, status[part.index])

        index = np.flatnonzero(~by_orbit)
        if len(index) and not interrupted:
            run = run_cases(
                plan,
                work,
                periods=(counted + BLOCK) * (1 + self.certify),
                index=index,
                tangents=True,
                name=f"exponents of {len(index)} cases",
                **how,
            )
            interrupted = run.interrupted
            if run.results is not None:  # put in place, leaf by leaf
                for mine, found in zip(jax.tree.leaves(measured), jax.tree.leaves(run.results), strict=True):
                    mine[index] = found
        longer = LongerMotions.not_run(np.zeros(0, int), self.count)
        exponent = measured.history.mean(axis=1)[:, 0]
        chaotic = is_chaotic(exponent, standard_error(measured.history)[:, 0])
        chosen = np.flatnonzero(chaotic & (measured.status == Status.FINITE))
        if self.certify and not interrupted and len(chosen):
            epoch = plan.periods + counted + BLOCK
            longer, interrupted = run_longer_motions(plan, chosen, measured.state, epoch, counted, self.count, how)
            unfinished = longer.status == Status.NOT_RUN
            measured.status[chosen[unfinished]] = Status.NOT_RUN
            longer = LongerMotions(*(array[~unfinished] for array in longer))
        good = measured.status == Status.FINITE
        status = np.where(good & no_orbit, int(Status.NO_ORBIT), measured.status)
        return exponent_variables(plan.periods, measured, reached, by_orbit, longer), status, interrupted

    def _unmeasured(self, states: State, counted: int) -> CaseExponents:
        """Return the exponents of cases before they are measured: NaN, unresolved, `Status.NOT_RUN`."""
        cases = len(states.motion.y)
        unknown = np.full((cases, counted, self.count), np.nan)
        not_run = np.full(cases, int(Status.NOT_RUN))
        kind = np.full(cases, int(Regime.UNRESOLVED))
        checks = None
        if self.certify:
            checks = Checks(unknown[..., :1].copy(), not_run.copy(), np.full(cases, np.nan))
        return CaseExponents(not_run, kind, np.zeros(cases, int), unknown, states, checks)

    def _measured(self, part: Part, states: State, counted: int, status: Int[np.ndarray, " lanes"]) -> CaseExponents:
        """Measure a chunk of cases from its states. **Arguments:** `status`: the chunk's `Status` codes so far."""
        start = part.plan.epoch + part.plan.periods
        local = measure(part, states, start, counted, self.count)
        end = jax.tree.map(np.asarray, local.state)
        rows = rows_of(end)
        maps = Maps.of(part, np.zeros(len(status), int), start + counted + BLOCK)
        pressed = maps.contact_status(np.arange(len(rows)), rows, part.capacity)
        status = first_problem(first_problem(status, local.status), pressed)
        motion = classify_motions(local.strobe, status)
        checks = None
        if self.certify:
            half = measure(part, states, start, counted, 1, finer=2)
            floquet = np.full(len(rows), np.nan)
            periodic = np.flatnonzero(motion.period)
            matrices = maps._replace(periods=motion.period).jacobians(periodic, rows[periodic])
            floquet[periodic] = [largest_exponent(of_case, len(of_case)) for of_case in matrices]
            checks = Checks(half.history, half.status, floquet)
        return CaseExponents(status, motion.kind, motion.period, local.history, end, checks)

    def label(self, scene, dims, values: dict[str, np.ndarray]) -> Labelled:
        data = {}
        for name, words in self.labels.items():
            several = values[name].ndim > len(dims)
            data[name] = column((*dims, "count") if several else dims, values[name], *words)
        if self.periods is not None and self.certify:
            data["regime"][2]["chaotic"] = lasting("chaotic", least_mean_life(self.measured))
        return data, {}
