"""Statuses of cases: one enumeration, carried by every result, and the exception of an interrupt."""

import enum
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextvars import ContextVar, copy_context

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ..model.dynamics import State
from ..model.scene import Scene
from ..model.step_size import contact_duration
from ..solvers.latching import is_explicit
from ..tools.types import AnyArray, Real

LEAST_PER_CONTACT = 3
"""Steps of a typical impact below which a case is not trusted. The default is 10; at K = 1e12 a case stayed finite
at 5 and did not at 1.3."""
FASTEST_GROWTH = 30.0
"""Logarithm of a tangent's growth in a period above which steps are too long for a contact's damping. At 100 m/s,
where chaos is strongest, about 10 is the greatest."""
INACCURATE = 0.1
"""Change of a period's end by half the step above which a run is not trusted, in multiples of `accuracy_scales`."""


class Status(enum.IntEnum):
    """How a case went. Datasets hold the number, 0 where nothing is wrong."""

    meaning: str
    remedy: str

    FINITE = 0, "finite", ""
    NOT_FINITE = (
        1,
        "not finite: the steps are too long for this case, or the solver gave up",
        "raise steps_per_period; loosen the tolerance of a solver that iterates or adapts its steps",
    )
    DERAILED = (
        2,
        "derailed: the slipper turned by more than 90 degrees, where the contact model has no meaning",
        "reduce the clearance or the initial spin",
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
        "check the units of clearance and section; raise the number of periods",
    )
    INACCURATE = (
        6,
        f"inaccurate: half the step changes a period by more than {INACCURATE:g} (unit: 1 mm, 10 mrad, 1 m/s, "
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

    def __new__(cls, code: int, meaning: str, remedy: str):
        member = int.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        member.remedy = remedy
        return member

    def __str__(self) -> str:
        return self.meaning + (f"; {self.remedy}" if self.remedy else "")


MEANINGS = "; ".join(f"{int(s)}: {s}" for s in Status)
"""All codes with meaning and remedy, for the attributes of datasets."""


def judge_states(states: State) -> Int[Array, ""]:
    """Judge a case by its states, over any leading axes: `Status` code `FINITE`, `NOT_FINITE` or `DERAILED`."""
    m = states.motion
    leaves = jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(m)])
    turned = jnp.any(m.q_x**2 + m.q_y**2 + m.q_z**2 > 0.5)  # half the angle's sine is sqrt(1/2) at 90 degrees
    good = jnp.where(turned, int(Status.DERAILED), int(Status.FINITE))
    return jnp.where(jnp.all(jnp.isfinite(leaves)), good, int(Status.NOT_FINITE))


def with_resolution(code: Array, scene: Scene, steps: Array, begin: Real = 0.0) -> Int[Array, ""]:
    """Return a code of `judge_states`, or `TOO_FEW_STEPS` where a period's steps are too few for its impacts.

    `TOO_FEW_STEPS` comes before `DERAILED`, which too few steps can bring about.

    **Arguments:** `steps`: of each period, from the period number `begin` on.
    """

    def too_few(steps, epoch):
        slowest = scene.slowest_between(epoch, epoch + 1)
        return contact_duration(scene, slowest) * steps < LEAST_PER_CONTACT * slowest.period

    # each period by the speed that it had
    steps = jnp.atleast_1d(steps)
    return _too_few_where(
        jnp.any(jax.vmap(too_few)(steps, begin + jnp.arange(float(len(steps))))),
        code,
    )


def _too_few_where(problem: Array, code: Array) -> Array:
    return jnp.where(problem & (code != int(Status.NOT_FINITE)), int(Status.TOO_FEW_STEPS), code)


def with_loads(
    code: Array,
    closed: Array,
    penetration: Array,
    stability_number: Array,
    scene: Scene,
    most: Real = jnp.inf,
    pressed: float = 0.5,
) -> Int[Array, ""]:
    """Return a code as `with_resolution` gives it, or that of a problem which the loads of a whole run show.

    **Arguments:** `closed`: sum of the points' contact fractions; `penetration`: the greatest; `stability_number`:
    the greatest, see `Loads`, and `most` that the solver bears; `pressed`: penetration over the section's smaller
    extent above which the contact law has no meaning.
    """
    # the smaller one of width and height
    points = scene.section.points
    extent = jnp.min(jnp.max(points, axis=0) - jnp.min(points, axis=0))
    # a problem that is known already stays
    at = lambda problem, code, instead: jnp.where(
        problem & (code == int(Status.FINITE)),
        int(instead),
        code,
    )
    code = at(closed == 0, code, Status.NO_CONTACT)
    code = at(penetration > pressed * extent, code, Status.PRESSED_IN)
    # before the two of above, which too long steps can bring about
    return _too_few_where(stability_number > most, code)


def with_growth(code: Array, history: Array) -> Int[Array, ""]:
    """Return a code, or `TOO_FEW_STEPS` where a tangent grew faster in some period than any motion's can.

    **Arguments:** `history`: logarithms of the growth per period, of shape (periods, count).
    """
    return _too_few_where(
        jnp.max(jnp.where(jnp.isfinite(history), history, -jnp.inf)) > FASTEST_GROWTH,
        code,
    )


def most_stability_number(
    solver: diffrax.AbstractSolver,
    controller: object = None,
    explicit: float = 5.0,
) -> float:
    """Return the greatest stability number of trusted runs: `explicit` for explicit solvers with constant steps.

    It is infinite for others. Of 200 random scenes one in 58 with numbers of 2.5 to 5 had an error above 0.1 after a
    period, and 6 of 16 above 5.
    """
    return explicit if controller is None and is_explicit(solver) else float("inf")


def first_problem(earlier: AnyArray, later: AnyArray) -> np.ndarray:
    """Return codes of two successive stretches of a run as one: the first that is not `FINITE`.

    `NOT_FINITE` comes before `TOO_FEW_STEPS`, as within a stretch.
    """
    earlier = np.asarray(earlier)
    later = np.asarray(later)
    lost = (earlier == Status.TOO_FEW_STEPS) & (later == Status.NOT_FINITE)
    return np.where((earlier == Status.FINITE) | lost, later, earlier)


class Stop(threading.Event):
    """Once set, the runs that it was submitted with end as by Ctrl-C, within a quarter of a second, and no others."""

    def __init__(self, outer: "Stop | None" = None):
        super().__init__()
        self.outer = outer
        """Which ends them, too."""

    def is_set(self) -> bool:
        return super().is_set() or (self.outer is not None and self.outer.is_set())

    @staticmethod
    def here() -> "Stop":
        """Return the one that this thread's runs were submitted with, by default `ASKED`."""
        return _HERE.get()

    def submit(self, pool: Executor, call: Callable, *args: object) -> Future:
        """Submit a call to threads; runs in it end with this one."""
        # threads start with an empty context of their own
        context = copy_context()
        context.run(_HERE.set, self)
        return pool.submit(context.run, call, *args)


ASKED = Stop()
"""Set by programs that catch signals themselves: all runs of the process end.

An exception that a signal's handler raises is lost where it meets a callback, such as JAX's in the garbage collector.
"""
_HERE = ContextVar("stop", default=ASKED)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a long computation, with what was finished.

    Sweeps, branches, curves of events and designs raise it instead of a `KeyboardInterrupt`:

    ```python
    try:
        ds = sj.sweep(scene, grid)
    except sj.Interrupted as stop:
        ds = stop.result
    ```

    In an interactive session `sys.last_value.result` is the same. The run's threads end after the call that they are
    in.
    """

    def __init__(self, result: object, finished: int, of: int | None = None, unit: str = "cases"):
        super().__init__(result, finished, of, unit)
        self.result = result
        """The finished part of the function's result: a dataset, where cases that were not finished have
        `Status.NOT_RUN`, or a branch, a curve or a design until then. None where nothing was finished."""
        self.finished = finished
        """How many cases, points or trials were."""
        self.of = of
        """How many there are; None where that is not known beforehand."""
        self.unit = unit
        """Plural of the things counted."""

    def __str__(self) -> str:
        total = "" if self.of is None else f" of {self.of}"
        kept = "" if self.result is None else ", see the attribute `result` of this exception"
        return f"{self.finished or 'none'}{total} {self.unit} were finished{kept}"


def blank(result, lanes: int):
    """Return the result of an unfinished chunk, in the shape of another chunk's: NaN and zeros, with its status.

    **Arguments:** `result`: a named tuple of arrays (lanes, ...) that has a field `status`; `lanes`: how many there
    are.
    """

    def empty(leaf):
        like = np.asarray(leaf)
        return np.full((lanes, *like.shape[1:]), np.nan if like.dtype.kind in "fc" else 0, like.dtype)

    return jax.tree.map(empty, result)._replace(status=np.full(lanes, int(Status.NOT_RUN)))


def with_accuracy(
    status: np.ndarray, error: np.ndarray, stderr: np.ndarray | float = 0.0
) -> Int[np.ndarray, "*cases"]:
    """Return statuses with `INACCURATE` where nothing else is wrong and half the step changes too much.

    **Arguments:** `error`: what half the step changes, over a period in scales, or relative [1], of shape (*cases,);
    `stderr`: its standard error, twice which is forgiven [1].
    """
    inaccurate = (status == Status.FINITE) & ~(error - 2 * stderr <= INACCURATE)
    return np.where(inaccurate, int(Status.INACCURATE), status)
