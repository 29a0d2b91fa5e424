"""Fits of trajectories: least squares of the differences from the samples, by exact derivatives, from many starts."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..model.kinematics import Motion
from ..model.step_size import default_steps_per_period
from ..solvers.explicit import RK4
from ..tools.checks import whole
from ..tools.limits import refuse_impossible
from .chain import LOST, Chain
from .course import SIZES, Course, Model, Windows
from .method import AbstractFitMethod, Problem
from .search import Found, search
from .signals import SignalPosterior
from .unknowns import spread

START_REACH = 3.0
"""How far starts are from those of the first guess, as standard deviation [scales of the motion]."""
ARRAYS = 6
"""Arrays of all rows by the unknowns of their windows that a search holds for each start; measured at 400 windows."""
CONTINUITY = (0.3, 0.03, 1e-3)
"""How far motions may jump where one window ends and the next begins, in one search after the other, as standard
deviation [scales]."""
FIRST_NOISE = 0.1
"""Noise over the RMS of a signal, of which nothing is known yet [1]."""
ROUGH = 0.01
"""Share of the sum of squares that is no gain in the first search [1]."""
AT_ONCE = 4
"""Searches that go on from where the first ones have led: they take as long as one."""
DRAWS = 15
"""Likely parameters whose signals are kept; with the estimate, two batches."""
ROUNDS = 6
"""Most searches, after each of which the noise is estimated anew, or steps are halved."""
NO_MATTER = 0.2
"""Change of an estimate by half the step, or by interpolation, that is no matter [standard errors]."""
LIKELY = 9.0
"""Sum of squares over the least of all up to which another minimum is likely, three standard deviations."""
CANDIDATES = 2
"""Points that are looked at for each start."""


@dataclass(frozen=True)
class Trajectories(AbstractFitMethod):
    """Fit the model's signals to the measured ones, sample by sample, along motions whose starts are found, too.

    For periodic motions and for short records. In chaos no motion stays near a record for long: see `Features`, or
    give a `window`.
    """

    starts: int = 16
    """Searches at once, from the points most like the record of a cover of the priors."""
    window: int | None = None
    """Forcing periods after which a motion begins anew, where the last one ended (multiple shooting). None: never."""
    transient: int = 100
    """Forcing periods after which a motion is taken as a first guess."""

    def __post_init__(self):
        whole("starts", self.starts, 1)
        whole("transient", self.transient, 0)
        if self.window is not None:
            whole("window", self.window, 1)

    def solver(self, scene):
        # which is the quickest to compile and to differentiate; where its steps matter, there will be more of them
        return RK4()

    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> SignalPosterior:
        windows = Windows.of(problem.runs, problem.scenes, problem.origin, self.window)
        rows = windows.count * (windows.known[0].size + 2 * len(SIZES))
        columns = 2 * len(SIZES) + len(problem.unknowns) + 1
        slopes = f"derivatives by the starts of {windows.count} windows (a larger `window` makes fewer)"
        refuse_impossible(slopes, float(ARRAYS * 8 * self.starts * rows * columns), 0.0)
        model = Model.of(problem, windows)
        given = np.array([np.nan if sensor.noise is None else sensor.noise for sensor in problem.rig.sensors])
        noise = np.where(np.isnan(given), FIRST_NOISE * _rms(model.windows), given)
        # the scene's own values, and others
        levels = np.vstack([problem.own, spread(problem.unknowns, CANDIDATES * self.starts - 1, problem.seed)])
        shown("first guesses")
        values = model.values(levels)
        model.compile_ahead(values)
        guess, far = model.guesses(values, self.transient, noise)
        best = np.argsort(far, kind="stable")[: self.starts]
        fit = Fitting(model, guess[best], noise, CONTINUITY[0])
        points = np.hstack([levels[best], guess[best].reshape(len(best), -1)])
        # roughly from all starts, then from the few minima that they have found
        found = search(fit.rows, points, shown, rough=ROUGH)
        if found.cost[found.lead] >= LOST:
            raise ValueError(
                "Argument `unknowns` must have values with which the motion stays on the rail, but all starts are "
                "lost: raise steps_per_period, check the units, or change the bounds."
            )
        kept = found.nearest(found.cost[found.lead], AT_ONCE)
        for jump in CONTINUITY[1:-1] if windows.count > 1 else ():
            fit = dataclasses.replace(fit, guess=fit.guess[kept], jump=jump)
            found = search(fit.rows, found.point[kept], shown, rough=ROUGH)
            kept = found.nearest(found.cost[found.lead], AT_ONCE)
        noise = np.where(np.isnan(given), fit.noise_left(found.point[found.lead]), given)
        model = model.with_steps(2 * model.steps)
        for _ in range(ROUNDS):
            model = model.with_steps(fit.needed(found.point[found.lead]))
            fit = Fitting(model, fit.guess[kept], noise)
            found = search(fit.rows, found.point[kept], shown)
            kept = found.distinct(LIKELY)
            shown("errors")
            now = fit.checked(found)
            # more steps and instants, until they are no matter
            if np.abs(now.by_step).max() > NO_MATTER:
                model = model.with_steps(2 * model.steps)
            if np.abs(now.by_instants).max() > NO_MATTER:
                model = model.with_samples(2 * model.samples)
            if model is fit.model and np.all(np.isfinite(given) | (np.abs(now.noise / noise - 1) < 0.02)):
                break
            noise = np.where(np.isnan(given), now.noise, given)
        return fit.posterior(found, kept, now.by_step)


class Checked(NamedTuple):
    """How exact an estimate is."""

    by_step: Float[np.ndarray, " parameters"]
    """What half the step changes [standard errors]."""
    by_instants: Float[np.ndarray, " parameters"]
    """What the interpolation of signals changes [standard errors]."""
    noise: Float[np.ndarray, " sensors"]
    """What the model leaves of each signal [its unit]."""


@dataclass(frozen=True)
class Fitting:
    """The least squares of a model, whose unknowns are levels of its parameters and numbers of its starts."""

    model: Model
    guess: Float[np.ndarray, "starts windows 10"]
    noise: Float[np.ndarray, " sensors"]
    jump: float = CONTINUITY[-1]
    """How far motions may jump from window to window, as standard deviation [scales]."""

    def split(self, points: Float[np.ndarray, "starts unknowns"]) -> tuple[np.ndarray, np.ndarray]:
        """Return levels (starts, parameters) and numbers of the starts (starts, windows, 10) [scales] of points."""
        count = len(self.model.problem.unknowns)
        return points[:, :count], points[:, count:].reshape(len(points), self.model.windows.count, len(SIZES))

    def course(self, points: Float[np.ndarray, "starts unknowns"]) -> Course:
        """Return the model's runs at some points."""
        levels, numbers = self.split(points)
        return self.model.course(self.model.values(levels), numbers)

    def rows(self, points: Float[np.ndarray, "starts unknowns"], index: np.ndarray) -> Chain:
        """Return all that is to be small, in standard deviations [1], and its derivatives, at points of the starts at
        `index`: differences from samples, jumps between windows, and what is known of the unknowns before."""
        levels, numbers = self.split(points)
        course = self.course(points)
        per_level = self._per_level(points)
        # columns: numbers of this window's start, of the next one's, levels, residual
        parts = [
            _banded(*self._weighted(course), per_level),
            self._jumps(course, numbers, per_level),
            self._reach(numbers - self.guess[index], levels.shape[1]),
        ]
        known = np.broadcast_to(np.eye(levels.shape[1]), (len(levels), levels.shape[1], levels.shape[1]))
        return Chain.of(np.concatenate(parts, axis=2), np.concatenate([known, levels[..., None]], axis=2))

    def _per_level(self, points: Float[np.ndarray, "starts unknowns"]) -> Float[np.ndarray, "starts parameters"]:
        """Return derivatives of the parameters by their levels."""
        return np.stack([one.slope(points[:, k]) for k, one in enumerate(self.model.problem.unknowns)], axis=1)

    def _weighted(self, course: Course) -> tuple[np.ndarray, np.ndarray]:
        """Return differences from samples (starts, windows, rows) and their slopes by a window's own directions."""
        windows = self.model.windows
        weight = windows.known / self.noise[:, None]
        difference = ((course.reading - windows.value) * weight).reshape(-1, windows.count, weight[0].size)
        return difference, (course.slope * weight[..., None]).reshape(*difference.shape, -1)

    def _jumps(self, course: Course, numbers: np.ndarray, per_level: np.ndarray) -> np.ndarray:
        run = self.model.windows.run
        # of the windows that are followed by one of the same run
        on = np.append(run[1:] == run[:-1], False)
        weight = on[:, None] / self.jump
        after = np.roll(numbers, -1, axis=1)
        rows = _banded((course.end - after) * weight, course.end_slope * weight[..., None], per_level)
        ten = np.arange(len(SIZES))
        rows[:, :, ten, len(SIZES) + ten] = -weight
        return rows

    def _reach(self, away: np.ndarray, levels: int) -> np.ndarray:
        """Return what is known of the starts before."""
        ten = len(SIZES)
        rows = np.zeros((*away.shape, 2 * ten + levels + 1))
        rows[..., :ten] = np.eye(ten) / START_REACH
        rows[..., -1] = away / START_REACH
        return rows

    def _along(self, change: np.ndarray, slope: np.ndarray, per_level: np.ndarray) -> Float[np.ndarray, " unknowns"]:
        """Return the sums of changes (windows, rows) times slopes by a window's own directions, by all unknowns."""
        sums = np.einsum("wr,wrd->wd", change, slope)
        own = per_level.size
        return np.concatenate([sums[:, :own].sum(axis=0) * per_level, sums[:, own:].ravel()])

    def noise_left(self, point: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " sensors"]:
        """Return the RMS of what the model leaves of each signal, by its samples less a part of the unknowns."""
        return self._noise_of(self.course(point[None]), point.size)

    def _noise_of(self, course: Course, unknowns: int) -> Float[np.ndarray, " sensors"]:
        windows = self.model.windows
        left = (course.reading[0] - windows.value) * windows.known
        count = windows.known.sum(axis=(0, 2))
        free = count - unknowns * count / count.sum()
        return np.sqrt(np.sum(left**2, axis=(0, 2)) / np.maximum(free, 1.0))

    def needed(self, point: Float[np.ndarray, " unknowns"]) -> int:
        """Return the steps per period that a point's parameters need."""
        values = self.model.values(self.split(point[None])[0])[0]
        own = dict(zip(self.model.problem.names, values, strict=False))
        return max(default_steps_per_period(scene.replace(**own)) for scene in self.model.problem.scenes)

    def checked(self, found: Found) -> "Checked":
        """Return what the best point leaves, and how exact it is."""
        point = found.point[[found.lead]]
        local = found.of_lead
        errors = np.sqrt(np.diag(_covariance(local)))
        course = self.course(point)
        (slopes,), (per_level,) = self._weighted(course)[1], self._per_level(point)

        def shift(other: Course) -> np.ndarray:
            change = (other.reading - course.reading) * self.model.windows.known / self.noise[:, None]
            along = self._along(change.reshape(slopes.shape[:2]), slopes, per_level)
            (moved,) = local.solve(local.solve_transposed(along[None]))
            return -moved[: len(errors)] / errors

        finer = dataclasses.replace(self, model=self.model.with_steps(2 * self.model.steps)).course(point)
        levels, numbers = self.split(point)
        fewer = self.model.course(self.model.values(levels), numbers, stride=2)
        # half the instants have 14 times the error, measured with 20, 40 and 80: cubics are of fourth order
        return Checked(shift(finer), shift(fewer) / 14, self._noise_of(course, point.size))

    def posterior(self, found: Found, kept: np.ndarray, change: np.ndarray) -> SignalPosterior:
        """Return what the searches tell of the parameters.

        **Arguments:** `kept`: indices of the minima; `change`: what half the step changes [standard errors].
        """
        model = self.model
        lead = found.lead
        point = found.point[lead]
        own = len(model.problem.unknowns)
        local = found.of_lead
        (root,) = local.root
        draws = point + local.solve(np.random.default_rng(0).normal(size=(DRAWS, point.size)))
        likely = self.course(np.vstack([point, draws])).reading
        return SignalPosterior(
            level=point[:own],
            covariance=_covariance(local),
            # of the data alone, with the starts unknown
            information=root.T @ root - np.eye(own),
            converged=bool(found.converged[lead]),
            minima=found.point[kept[1:], :own],
            step_change=change,
            noise=self.noise,
            windows=model.windows,
            reading=likely[0],
            draws=likely[1:],
            start=Motion(*(self.split(point[None])[1][0, 0] * SIZES)),
        )


def _covariance(local: Chain) -> Float[np.ndarray, "parameters parameters"]:
    """Return the covariance of the levels at the only point of a chain."""
    # by a root, so that no variance is negative where slopes in chaos are of any size
    inverse = np.linalg.inv(local.root[0])
    return inverse @ inverse.T


def _banded(value: np.ndarray, slope: np.ndarray, per_level: np.ndarray) -> np.ndarray:
    """Return values (starts, windows, rows) and slopes by a window's own directions as rows of a `Chain`."""
    starts, windows, rows = value.shape
    own, ten = per_level.shape[1], len(SIZES)
    found = np.zeros((starts, windows, rows, 2 * ten + own + 1))
    found[..., :ten] = slope[..., own:]
    found[..., 2 * ten : -1] = slope[..., :own] * per_level[:, None, None]
    found[..., -1] = value
    return found


def _rms(windows: Windows) -> Float[np.ndarray, " sensors"]:
    count = windows.known.sum(axis=(0, 2))
    mean = np.sum(windows.value * windows.known, axis=(0, 2)) / count
    square = np.sum((windows.value - mean[:, None]) ** 2 * windows.known, axis=(0, 2)) / count
    return np.maximum(np.sqrt(square), 1e-12)
