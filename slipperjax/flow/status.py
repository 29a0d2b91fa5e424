"""Statuses of cases, which every result has, and interrupts: how runs are asked to end, and what they return."""

import dataclasses
import enum
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextvars import ContextVar, copy_context

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, PyTree

from ..model.dynamics import State
from ..model.kinematics import share_of_scale
from ..model.scene import Scene, travel_unit
from ..model.step_size import contact_duration
from ..model.travel import LEAST_SPEED
from ..solvers.latching import is_explicit
from ..tools.types import AnyArray, Numbers, Real

LEAST_PER_CONTACT = 3
"""Steps of a typical impact below which a case is not trusted. The default is 10; at K = 1e12 a case stayed finite
with 5 steps, and did not with 1.3."""
FASTEST_GROWTH = 30.0
"""Logarithm of a tangent's growth in a period above which steps are too long for a contact's damping. The greatest is
about 10 at 100 m/s, where chaos is strongest."""
MOST_DAMPED = 3.0
"""Damping force over elastic force above which a force on a rough rail is doubtful."""
INACCURATE = 0.1
"""Change of a period's end by half the step, in multiples of `accuracy_scales`, above which a run is not trusted."""


class Status(enum.IntEnum):
    """Outcome of a case, and how to react to it. Datasets hold the code, which is 0 where nothing is wrong."""

    meaning: str
    """What has happened."""
    remedy: str
    """How to react; empty where nothing is wrong."""

    FINITE = 0, "finite", ""
    NOT_FINITE = (
        1,
        "not finite: the steps are too long for this case, or the solver gave up",
        "raise steps_per_period; check the units of start and stiffness; loosen the tolerance of a solver that "
        "iterates or adapts its steps",
    )
    DERAILED = (
        2,
        "derailed: the slipper turned by more than 90 degrees, where the contact model has no meaning",
        "check the units of start and clearance; reduce the clearance or the initial spin",
    )
    TOO_FEW_STEPS = (
        3,
        f"too few steps: a typical impact takes less than {LEAST_PER_CONTACT}, or a contact's damping is too fast "
        "for them",
        "raise steps_per_period, or take an implicit solver such as ROS34PW2",
    )
    PRESSED_IN = (
        4,
        "pressed in: a point penetrates by more than half the section's height or width, where the contact model has "
        "no meaning",
        "check the units of section, stiffness and start, and the order of the section's points",
    )
    NO_CONTACT = (
        5,
        "no contact: slipper and rail never touched",
        "check the units of clearance and section; go farther",
    )
    INACCURATE = (
        6,
        f"inaccurate: half the step changes the motion by more than {INACCURATE:g} (unit: 1 mm, 10 mrad, 1 m/s, "
        "10 rad/s; with less play than 1 mm the first two in proportion)",
        "raise steps_per_period, or take a solver of higher order",
    )
    NOT_RUN = 7, "not run: the sweep was interrupted before this case was finished", "run this case again"
    NO_ORBIT = (
        8,
        "no orbit: Newton's iterations ended without a periodic motion",
        "start nearer to one, by a longer transient or another start; try another period",
    )
    POINTS_DROPPED = (
        9,
        "points dropped: a coordinate crossed zero upwards more often in a forcing period than points are kept",
        "keep more, by slipperjax.flow.PoincareSections(capacity)",
    )
    TOO_SLOW = (
        10,
        f"too slow: in this window the sled stands or is slower than {LEAST_SPEED:g} m/s, at which the run passes",
        "judge the other windows",
    )

    DAMPED = (
        11,
        f"damped: a contact's damping force is more than {MOST_DAMPED:g} times its elastic force",
        "take the memory PeakRateLatch, or a higher restitution",
    )

    # the member itself is the code, with the texts as attributes
    def __new__(cls, code: int, meaning: str, remedy: str):
        member = int.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        member.remedy = remedy
        return member

    def __str__(self) -> str:
        return self.meaning + (f"; {self.remedy}" if self.remedy else "")


DOUBTFUL = (Status.NO_CONTACT, Status.INACCURATE, Status.POINTS_DROPPED, Status.TOO_SLOW, Status.DAMPED)
"""Statuses of cases whose numbers were computed, but are doubtful; with other statuses numbers mean nothing."""


def is_lost(codes: AnyArray) -> np.ndarray | np.bool:
    """Return for one or several `Status` codes whether numbers of such a case mean nothing."""
    return ~np.isin(codes, (Status.FINITE, *DOUBTFUL))


def counted(codes: AnyArray) -> "dict[Status, int]":
    """Return the number of cases with each status other than `FINITE`."""
    found, counts = np.unique(np.asarray(codes)[codes != Status.FINITE], return_counts=True)
    return {Status(int(code)): int(n) for code, n in zip(found, counts, strict=True)}


def texts_of_status(codes: AnyArray) -> list[str]:
    """Return a text for each status other than `FINITE`, with the number of runs that have it."""
    total = np.size(codes)
    of = f"{total} run{'s' * (total > 1)}"
    return [f"status of {n} of {of}: {status}" for status, n in counted(codes).items()]


LOST_MOTIONS = (Status.NOT_FINITE, Status.DERAILED, Status.TOO_FEW_STEPS, Status.PRESSED_IN)
"""Statuses of cases without a known motion: all variables of results are NaN."""


def without_lost(values: PyTree, status: np.ndarray) -> PyTree:
    """Return arrays (cases, ...) of results, with NaN for all of `LOST_MOTIONS` where numbers are real.

    A maximum ignores NaN, and without a touch the force is zero: such numbers would look like valid ones.
    """
    lost = np.isin(status, LOST_MOTIONS)
    if not lost.any():
        return values

    def of(leaf: np.ndarray) -> np.ndarray:
        at = lost.reshape(-1, *[1] * (leaf.ndim - 1))
        return np.where(at, np.nan, leaf) if leaf.dtype.kind in "fc" else leaf

    return jax.tree.map(of, values)


MEANINGS = "; ".join(f"{int(s)}: {s}" for s in Status)
"""All codes with meaning and reaction, for the attributes of datasets."""


def judge_states(states: State) -> Int[Array, ""]:
    """Return the `Status` code of a case from its states: `FINITE`, `NOT_FINITE` or `DERAILED`.

    Leading axes of `states` are instants, and all instants count.
    """
    m = states.motion
    # a lost motion makes the modes NaN, and lost modes make the motion NaN
    leaves = jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(dataclasses.replace(m, modes=None))])
    turned = jnp.any(m.q_x**2 + m.q_y**2 + m.q_z**2 > 0.5)  # half the angle's sine is sqrt(1/2) at 90 degrees
    good = jnp.where(turned, int(Status.DERAILED), int(Status.FINITE))
    return jnp.where(jnp.all(jnp.isfinite(leaves)), good, int(Status.NOT_FINITE))


def with_resolution(code: Array, scene: Scene, steps: Array, begin: Real = 0.0) -> Int[Array, ""]:
    """Return `code`, from `judge_states`, or `TOO_FEW_STEPS` where the steps of a period are too few for its impacts.

    `TOO_FEW_STEPS` replaces `DERAILED`, because too few steps can cause a derailment.

    **Arguments:** `steps`: in each forcing period, from the period number `begin` on.
    """

    def too_few(steps, epoch):
        slowest = scene.slowest_between(epoch, epoch + 1)
        return contact_duration(scene, slowest) * steps < LEAST_PER_CONTACT * slowest.period

    # each period at its least speed
    steps = jnp.atleast_1d(steps)
    return _too_few_where(jnp.any(jax.vmap(too_few)(steps, begin + jnp.arange(float(len(steps))))), code)


def _too_few_where(problem: Array, code: Array) -> Array:
    # lost numbers remain the first problem to report
    return jnp.where(problem & (code != int(Status.NOT_FINITE)), int(Status.TOO_FEW_STEPS), code)


def with_loads(
    code: Array,
    closed: Array,
    penetration: Array,
    stability_number: Array,
    damping_ratio: Array,
    scene: Scene,
    most: Real,
) -> Int[Array, ""]:
    """Return `code`, or `NO_CONTACT`, `PRESSED_IN`, `TOO_FEW_STEPS` or `DAMPED` by the loads of a whole run.

    **Arguments:** `closed`: sum of the points' contact fractions [1]; `penetration`: the greatest [m];
    `stability_number`: the greatest, see `Loads`; `most`: its limit for the solver [1]; `damping_ratio`: the highest
    [1], zero where it is not judged.
    """
    # the contact law is meaningful up to half the section's width or height, whichever is smaller
    points = scene.section.points
    extent = jnp.min(jnp.max(points, axis=0) - jnp.min(points, axis=0))
    # an earlier problem stays
    at = lambda problem, code, instead: jnp.where(problem & (code == int(Status.FINITE)), int(instead), code)
    code = at(closed == 0, code, Status.NO_CONTACT)
    code = at(penetration > 0.5 * extent, code, Status.PRESSED_IN)
    # this status replaces the two above, because too long steps can cause both
    code = _too_few_where(stability_number > most, code)
    law = scene.contact
    usual = jnp.asarray(law.damping(jnp.zeros(()), jnp.ones(()) if law.has_memory else None))
    # rounding is no excess
    return at(damping_ratio > 1.001 * jnp.maximum(usual, MOST_DAMPED), code, Status.DAMPED)


def with_growth(code: Array, history: Array) -> Int[Array, ""]:
    """Return `code`, or `TOO_FEW_STEPS` where a tangent grew faster in a period than is possible with enough steps.

    **Arguments:** `history`: logarithms of the growth per period, of shape (periods, count).
    """
    # a lost motion already has its status
    greatest = jnp.max(jnp.where(jnp.isfinite(history), history, -jnp.inf))
    return _too_few_where(greatest > FASTEST_GROWTH, code)


def most_stability_number(solver: diffrax.AbstractSolver, controller: object = None) -> float:
    """Return the greatest stability number of trusted runs: 5 for explicit solvers with constant steps.

    It is infinite for others. Of 200 random scenes, one of 58 with numbers of 2.5 to 5 had an error above 0.1 after a
    period, and 6 of 16 with numbers above 5.
    """
    return 5.0 if controller is None and is_explicit(solver) else np.inf


def first_problem(earlier: AnyArray, later: AnyArray) -> np.ndarray:
    """Return the codes of runs from the codes of two successive stretches: the earlier code unless it is `FINITE`.

    But `NOT_FINITE` replaces `TOO_FEW_STEPS`, as within a stretch.
    """
    earlier = np.asarray(earlier)
    later = np.asarray(later)
    lost = (earlier == Status.TOO_FEW_STEPS) & (later == Status.NOT_FINITE)
    return np.where((earlier == Status.FINITE) | lost, later, earlier)


class Stop(threading.Event):
    """A request to end the runs that were submitted with it: when set, they end as after Ctrl-C, within 0.25 s."""

    def __init__(self, outer: "Stop | None" = None):
        super().__init__()
        self.outer = outer
        """Another request, which also ends these runs."""

    def is_set(self) -> bool:
        return super().is_set() or (self.outer is not None and self.outer.is_set())

    @staticmethod
    def here() -> "Stop":
        """Return the request with which this thread's work was submitted, by default `ASKED`."""
        return _HERE.get()

    def submit(self, pool: Executor, call: Callable, *args: object) -> Future:
        """Submit a call to a pool of threads; runs in the call end when this request is set."""
        # a new thread has no context variables, so that it gets a copy of these with this request
        context = copy_context()
        context.run(_HERE.set, self)
        return pool.submit(context.run, call, *args)


ASKED = Stop()
"""The request to end all runs of the process, for programs that handle signals themselves.

An exception that a signal handler raises would be lost inside a callback, such as JAX's callback in the garbage
collector.
"""
_HERE = ContextVar("stop", default=ASKED)


def heed_interrupts(periods: float = 0.0) -> None:
    """Raise `KeyboardInterrupt` where this run is asked to end. Also serves as the report of progress in runs that
    show none."""
    if Stop.here().is_set():
        raise KeyboardInterrupt


class Interrupted(KeyboardInterrupt):
    """A Ctrl-C during a long computation, with the result as far as it was finished.

    Sweeps, branches, curves of events and designs raise it in place of a `KeyboardInterrupt`:

    ```python
    try:
        ds = sj.sweep(scene, grid)
    except sj.Interrupted as stop:
        ds = stop.result
    ```

    In an interactive session `sys.last_value.result` is the same. The run's threads have ended then. A warning says
    where a thread continues to the end of its present call, such as a compilation.
    """

    def __init__(self, result: object, finished: int, of: int | None = None, unit: str = "cases"):
        super().__init__(result, finished, of, unit)
        self.result = result
        """The result of the function so far: a dataset in which unfinished cases have `Status.NOT_RUN`, or a branch,
        a curve or a design. None where nothing was finished."""
        self.finished = finished
        """Number of finished cases, points or trials."""
        self.of = of
        """Number of all cases, points or trials; None where it is not known beforehand."""
        self.unit = unit
        """Name of the counted things, in the plural."""

    def __str__(self) -> str:
        total = "" if self.of is None else f" of {self.of}"
        kept = "" if self.result is None else ", see the attribute `result` of this exception"
        return f"{self.finished or 'none'}{total} {self.unit} were finished{kept}"


def blank(result, lanes: int):
    """Return a result for a chunk that was not run: NaN, zeros in place of whole numbers, and status `NOT_RUN`.

    **Arguments:** `result`: result of another chunk, a named tuple of arrays (lanes, ...) with a field `status`;
    `lanes`: number of cases in the chunk.
    """

    def empty(leaf):
        like = np.asarray(leaf)
        return np.full((lanes, *like.shape[1:]), np.nan if like.dtype.kind in "fc" else 0, like.dtype)

    return jax.tree.map(empty, result)._replace(status=np.full(lanes, int(Status.NOT_RUN)))


def with_accuracy(
    status: np.ndarray, error: np.ndarray, stderr: np.ndarray | float = 0.0
) -> Int[np.ndarray, "*cases"]:
    """Return statuses with `INACCURATE` where nothing else is wrong and half the step changes too much.

    **Arguments:** `error`: change by half the step, for a motion over a period in multiples of its scales, for
    another number relative to it [1], (*cases,); `stderr`: standard error of the change [1].
    """
    # Twice the standard error is allowed. In this form an error of NaN is inaccurate.
    inaccurate = (status == Status.FINITE) & ~(error - 2 * stderr <= INACCURATE)
    return np.where(inaccurate, int(Status.INACCURATE), status)


def step_error(scene: Scene, changes: Numbers, unit: str = "") -> str:
    """Return a text with the largest change by half the step over a forcing period, in units of `accuracy_scales`."""
    most = float(np.max(changes))
    share = float(share_of_scale(scene))
    if not np.isfinite(most):
        return "half the step does not stay finite"
    units = f"{share:g} mm, {10 * share:g} mrad, 1 m/s, 10 rad/s"
    return f"half the step changes the motion by {most:.1e} per {unit or travel_unit(scene)} (unit: {units})"
