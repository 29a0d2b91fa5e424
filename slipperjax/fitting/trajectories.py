"""Fits of trajectories: least squares of the differences from the samples, by exact derivatives, from many starts."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from ..flow.record import Labelled
from ..model.sensors import Rig
from ..solvers.explicit import RK4
from ..tools.checks import require, whole
from ..tools.columns import column
from ..tools.limits import refuse_impossible
from .course import SIZES, Course, Model, Windows
from .method import AbstractFitMethod, Posterior, Problem, spread
from .search import PATIENCE, STALLED, Chain, Found, search

MOST_NOISE_RATIO = 1.2
"""Residual over the given noise above which a model does not explain a signal [1]."""
SIGNIFICANCE = 1e-3
"""Probability of residuals below which a model does not explain them."""


@dataclass(frozen=True, kw_only=True)
class SignalPosterior(Posterior):
    """What is known about the parameters, and the signals that follow from them."""

    noise: Float[np.ndarray, " sensors"]
    """Standard deviations that the fit assumed for noise [the sensors' units]."""
    windows: Windows
    reading: Float[np.ndarray, "windows sensors samples"]
    """The signals of the model."""
    draws: Float[np.ndarray, "draws windows sensors samples"]
    """Signals of other parameters and starts that are as likely."""

    @property
    def left(self) -> list[Float[np.ndarray, " samples"]]:
        """Residuals of each sensor's signals, one window after the other [its unit]."""
        left = np.moveaxis(self.windows.value - self.reading, 1, 0)
        known = np.moveaxis(self.windows.known > 0, 1, 0)
        return [left[k][known[k]] for k in range(len(left))]

    @property
    def noise_left(self) -> Float[np.ndarray, " sensors"]:
        """RMS of the residuals of each sensor's signals [its unit]."""
        return np.array([np.sqrt(np.mean(left**2)) for left in self.left])

    @property
    def whiteness(self) -> Float[np.ndarray, " sensors"]:
        """For each sensor the probability that white noise is as correlated as the residuals [1]."""
        return np.array([whiteness(left) for left in self.left])

    def misfit(self, rig: Rig) -> list[str]:
        texts = []
        for sensor, white, left in zip(rig.sensors, self.whiteness, self.noise_left, strict=True):
            parts = []
            if white < SIGNIFICANCE:
                parts.append(f"what is left is no white noise (p = {white:.1g})")
            if sensor.noise is not None and left > MOST_NOISE_RATIO * sensor.noise:
                parts.append(f"it is {left / sensor.noise:.2g} times the noise")
            if parts:
                texts.append(f"the model does not explain {sensor.name}: {' and '.join(parts)}")
        return texts

    def label(self, rig: Rig) -> Labelled:
        windows = self.windows
        known = windows.known > 0
        low, high = np.quantile(self.draws, [0.05, 0.95], axis=0)
        over = ("window", "sensor", "sample")
        signal = lambda values, unit, text: column(over, np.where(known, values, np.nan), unit, text)
        data = {
            "noise": column("sensor", self.noise_left, "", "RMS of what the model leaves, in the sensor's unit"),
            "whiteness": column("sensor", self.whiteness, "1", "probability that white noise is as correlated"),
            "seconds": signal(windows.time, "s", "time since the run began"),
            "measured": signal(windows.value, "", "measured signal, in the sensor's unit"),
            "fitted": signal(self.reading, "", "signal of the model, in the sensor's unit"),
            "fitted_low": signal(low, "", "5 % quantile of likely signals, in the sensor's unit"),
            "fitted_high": signal(high, "", "95 % quantile of likely signals, in the sensor's unit"),
        }
        # of the window with the most samples, with noise
        most = int(np.argmax(known.sum(axis=(1, 2))))
        draws = self.draws[:, most]
        likely = draws + self.noise[:, None] * np.random.default_rng(0).normal(size=draws.shape)
        rows, coords = windows.densities(most, likely)
        return data | rows, coords | {"run": ("window", windows.run)}


def whiteness(residual: Float[np.ndarray, " samples"]) -> float:
    """Return the probability that white noise is at least as correlated as some residuals, by Ljung and Box's test.

    G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297, doi:10.1093/biomet/65.2.297.
    """
    count = len(residual)
    lags = np.arange(1, min(20, count // 5) + 1)
    x = residual - residual.mean()
    power = x @ x
    correlation = np.array([x[k:] @ x[:-k] for k in lags]) / power
    statistic = count * (count + 2) * np.sum(correlation**2 / (count - lags))
    return float(chi2.sf(statistic, len(lags)))


START_REACH = 3.0
"""Standard deviation of starts about the first guess [scales of the motion]."""
ARRAYS = 6
"""Arrays of all rows by the unknowns of their windows that a search holds for each start; measured at 400 windows."""
CONTINUITY = (0.3, 0.03, 1e-3)
"""Standard deviations of the jumps of motions where one window ends and the next begins, for successive searches
[scales]."""
FIRST_NOISE = 0.1
"""First assumption of noise over the RMS of a signal [1]."""
ROUGH = 0.01
"""Share of the sum of squares that does not count as a gain in the first search [1]."""
REFINED_STARTS = 4
"""Number of searches that continue from the results of the first search: they take as long as one."""
DRAWS = 15
"""Number of likely parameters whose signals are kept; with the estimate, two batches."""
GROWN_PATIENCE = 10
"""Points without any gain after which a search along a growing part of a record stops. A short part shows little of
some unknowns, so that first steps are too long; ten points shorten them to a thousandth."""
ROUNDS = 6
"""Most searches; after each search the noise is estimated again, or the step is halved."""
NEGLIGIBLE_CHANGE = 0.2
"""Change of an estimate by half the step, or by interpolation, that is small enough [standard errors]."""
LIKELY = 9.0
"""Sum of squares over the least of all up to which another minimum is likely: three standard deviations."""
CANDIDATES = 2
"""Number of points that are tried for each start."""


@dataclass(frozen=True)
class Trajectories(AbstractFitMethod):
    """Fit the model's signals to the measured signals, sample by sample, along motions whose starts are also found.

    For periodic motions and for short records. In chaos no motion stays near a record for long: use `Features`, or
    give a `window`.
    """

    starts: int = 16
    """Number of simultaneous searches, from those points of a cover of the priors that fit the record best."""
    window: int | None = None
    """Forcing periods after which a motion begins again at the end of the last (multiple shooting). None: the motion
    never begins again; on rails that do not recur it begins again after each period."""
    transient: int = 100
    """Forcing periods after which a motion serves as a first guess."""

    def __post_init__(self):
        whole("starts", self.starts, 1)
        whole("transient", self.transient, 0)
        if self.window is not None:
            whole("window", self.window, 1)

    def solver(self, scene):
        # fastest to compile and to differentiate; where its steps matter, their number will grow
        return RK4()

    def start(self, scene):
        # as `slipperjax.run` on such rails
        return None if np.isfinite(scene.recurrence) else "rest"

    def check(self, problem):
        beam = problem.scene.beam
        require(beam is None, "scene", "have rigid rails for a fit of trajectories", beam)

    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> SignalPosterior:
        windows = Windows.of(problem, self.window or (None if problem.recurs else 1))
        rows = windows.count * (windows.known[0].size + 2 * len(SIZES))
        columns = 2 * len(SIZES) + len(problem.unknowns) + 1
        slopes = f"derivatives by the starts of {windows.count} windows (a larger `window` makes fewer)"
        refuse_impossible(slopes, float(ARRAYS * 8 * self.starts * rows * columns), 0.0)
        model = Model.of(problem, windows)
        given = np.array([sensor.noise for sensor in problem.rig.sensors], float)
        or_given = lambda noise: np.where(np.isnan(given), noise, given)
        rms = np.std(windows.value, axis=(0, 2), where=windows.known > 0)
        noise = or_given(FIRST_NOISE * np.maximum(rms, 1e-12))
        # the scene's own values, and other values
        levels = np.vstack([problem.own, spread(problem.unknowns, CANDIDATES * self.starts - 1, problem.seed)])
        shown("first guesses")
        model.compile_ahead()
        # on a rail that does not recur, motions that differ are nowhere alike: later windows have no guess
        along, patience = (narrowed, PATIENCE) if problem.recurs else (grown, GROWN_PATIENCE)
        fit, found, kept = along(self, model, levels, noise, shown)
        if found.all_lost:
            raise ValueError(
                "Argument `unknowns` must have values with which the motion stays on the rail, but all starts are "
                "lost: raise steps_per_period, check the units, or change the bounds."
            )
        lead = np.array([found.lead])
        noise = or_given(fit.noise_left(fit.course(found.point[lead], lead)))
        model = model.with_steps(2 * model.steps)
        for _ in range(ROUNDS):
            levels, _ = model.split(found.point)
            model = model.with_steps(problem.needed(levels[found.lead]))
            fit, points = fit.onward(found.point, kept, model)
            fit = replace(fit, noise=noise, jump=CONTINUITY[-1])
            found = search(fit.rows, points, shown, patience=patience)
            kept = found.distinct(LIKELY)
            shown("errors")
            by_step, by_instants, left = fit.checked(found)
            # more steps and instants, until their effect is small enough; on no minimum it says nothing
            if found.converged[found.lead]:
                if np.abs(by_step).max() > NEGLIGIBLE_CHANGE:
                    model = model.with_steps(2 * model.steps)
                if np.abs(by_instants).max() > NEGLIGIBLE_CHANGE:
                    model = model.with_samples(2 * model.samples)
            known = np.all(np.isfinite(given) | (np.abs(left / noise - 1) < 0.02))
            one_motion = fit.is_one_motion(found)
            if model is fit.model and known and one_motion:
                break
            noise = or_given(left)
        return fit.posterior(found, kept, by_step, one_motion)


@dataclass(frozen=True)
class Fitting:
    """The least squares of a model; its unknowns are levels of parameters and numbers of starts."""

    model: Model
    guess: Float[np.ndarray, "starts windows 10"]
    """Motions about which windows begin [scales]."""
    carried: Float[np.ndarray, "starts windows size"]
    """Other numbers with which windows begin, see `begin`: those at the end of the window before."""
    noise: Float[np.ndarray, " sensors"]
    jump: float = CONTINUITY[-1]
    """Standard deviation of the jumps of motions from window to window [scales]."""

    def of(self, kept: np.ndarray) -> "Fitting":
        """Return the least squares of some of the starts."""
        return replace(self, guess=self.guess[kept], carried=self.carried[kept])

    def course(self, points: Float[np.ndarray, "starts unknowns"], index: np.ndarray) -> Course:
        """Return the runs from points of the starts at `index`."""
        return self.model.course(points, self.carried[index])

    def onward(
        self, points: Float[np.ndarray, "starts unknowns"], kept: np.ndarray, model: Model
    ) -> tuple["Fitting", np.ndarray]:
        """Return the least squares from some of the starts with the windows of another model, and their points.

        Windows begin with the memory of contacts at the end of the window before. Those that are not among the
        present ones begin there.
        """
        old, new = self.model.windows, model.windows
        if not new.number.any():
            return replace(self.of(kept), model=model), points[kept]
        course = self.course(points[kept], kept)
        levels, numbers = self.model.split(points[kept])
        same_run = new.run[:, None] == old.run
        here = same_run & (new.number[:, None] == old.number)
        before = same_run & (new.number[:, None] == old.number + 1)
        is_old, follows = here.any(axis=1), before.any(axis=1)
        place, earlier = here.argmax(axis=1), before.argmax(axis=1)
        either = lambda known: np.where(is_old[:, None], known[:, place], course.end[:, earlier])
        after = np.where(follows[:, None], model.carried(course.last[:, earlier]), self.carried[kept][:, place])
        fit = replace(self, model=model, guess=either(self.guess[kept]), carried=after)
        return fit, np.hstack([levels, either(numbers).reshape(len(kept), -1)])

    def is_one_motion(self, found: Found) -> bool:
        """Return whether the best point remains one if windows begin with the memory at the end of the one before."""
        if not self.model.windows.number.any():
            return True
        fit, points = self.onward(found.point, np.array([found.lead]), self.model)
        return bool(fit.rows(points, np.zeros(1, int)).distance[0] < STALLED)

    def rows(self, points: Float[np.ndarray, "starts unknowns"], index: np.ndarray) -> Chain:
        """Return all residuals, in standard deviations [1], and their derivatives, at points of the starts at
        `index`: differences from samples, jumps between windows, and deviations of the unknowns from their priors."""
        course = self.course(points, index)
        return self._chain(points, index, course, course.reading - self.model.windows.value)

    def _chain(
        self, points: np.ndarray, index: np.ndarray, course: Course, difference: np.ndarray, others: float = 1.0
    ) -> Chain:
        """Return the chain of some points, from their course and from the signals' differences from their targets.

        **Arguments:** `others`: factor of all residuals except these differences [1].
        """
        windows, ten = self.model.windows, len(SIZES)
        levels, numbers = self.model.split(points)
        # derivatives of the parameters by their levels
        per_level = self.model.problem.slopes(levels)
        weight = windows.known / self.noise[:, None]
        samples = _banded(difference * weight, course.slope * weight[..., None], per_level)
        # a window that is followed by one of the same run must end where the next one begins
        on = np.append(windows.run[1:] == windows.run[:-1], False)
        weight = on[:, None] / self.jump
        after = np.roll(numbers, -1, axis=1)
        jumps = _banded(others * (course.end - after) * weight, course.end_slope * weight[..., None], per_level)
        jumps[:, :, np.arange(ten), ten + np.arange(ten)] = -weight
        # priors of the starts, and of the levels
        known = np.zeros((*numbers.shape, samples.shape[-1]))
        known[..., :ten] = np.eye(ten) / START_REACH
        known[..., -1] = others * (numbers - self.guess[index]) / START_REACH
        of_levels = np.zeros((*levels.shape, levels.shape[1] + 1))
        of_levels[..., :-1] = np.eye(levels.shape[1])
        of_levels[..., -1] = others * levels
        return Chain.of(np.concatenate([samples, jumps, known], axis=2), of_levels)

    def noise_left(self, course: Course) -> Float[np.ndarray, " sensors"]:
        """Return the RMS of each signal's residuals, by its samples minus a share of the unknowns."""
        windows = self.model.windows
        unknowns = len(self.model.problem.unknowns) + self.guess[0].size
        left = (course.reading[0] - windows.value) * windows.known
        count = windows.known.sum(axis=(0, 2))
        free = count - unknowns * count / count.sum()
        return np.sqrt(np.sum(left**2, axis=(0, 2)) / np.maximum(free, 1.0))

    def checked(self, found: Found) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the change of the best point's parameters by half the step, their change by the interpolation of
        signals [standard errors], and the residual of each signal [its unit]."""
        index = np.array([found.lead])
        point = found.point[index]
        errors = np.sqrt(np.diag(_covariance(found.of_lead)))
        course = self.course(point, index)

        def shift(other: Course) -> np.ndarray:
            # the change of the least squares' parameters if only the signals change
            chain = self._chain(point, index, course, other.reading - course.reading, others=0.0)
            return -chain.solve(chain.residual[:, :-1])[0, : len(errors)] / errors

        finer = self.model.with_steps(2 * self.model.steps).course(point, self.carried[index])
        # half the instants have 14 times the error, measured with 20, 40 and 80 instants: cubics are of fourth order
        coarser = self.model.course(point, self.carried[index], stride=2)
        return shift(finer), shift(coarser) / 14, self.noise_left(course)

    def posterior(self, found: Found, kept: np.ndarray, change: np.ndarray, one_motion: bool) -> SignalPosterior:
        """Return what is known about the parameters after the searches.

        **Arguments:** `kept`: indices of the minima; `change`: by half the step [standard errors]; `one_motion`: see
        `is_one_motion`.
        """
        model = self.model
        lead = found.lead
        point = found.point[lead]
        own = len(model.problem.unknowns)
        local = found.of_lead
        (root,) = local.root
        draws = point + local.solve(np.random.default_rng(0).normal(size=(DRAWS, point.size)))
        likely = self.course(np.vstack([point, draws]), np.full(1 + DRAWS, lead)).reading
        return SignalPosterior(
            level=point[:own],
            covariance=_covariance(local),
            # information of the data only, with unknown starts
            information=root.T @ root - np.eye(own),
            # the least squares of windows that are not one motion are those of no run
            converged=bool(found.converged[lead]) and one_motion,
            minima=found.point[kept[1:], :own],
            step_change=change,
            noise=self.noise,
            windows=model.windows,
            reading=likely[0],
            draws=likely[1:],
            start=model.start(model.split(point[None])[1][0, 0], self.carried[lead, 0]),
        )


def narrowed(
    method: Trajectories, model: Model, levels: np.ndarray, noise: np.ndarray, shown: Callable[[str], object]
) -> tuple[Fitting, Found, np.ndarray]:
    """Return the minima near the guesses of all windows, first roughly from all starts, then from the best ones.

    **Returns:** least squares, the searches, and the indices of those to continue.
    """
    guess, far = model.guesses(levels, method.transient, noise)
    kept = np.argsort(far, kind="stable")[: method.starts]
    points = np.hstack([levels, guess.reshape(len(guess), -1)])
    for jump in CONTINUITY[:-1] if model.windows.number.any() else CONTINUITY[:1]:
        guess = guess[kept]
        fit = Fitting(model, guess, np.full((*guess.shape[:2], model.size), np.nan), noise, jump)
        found = search(fit.rows, points[kept], shown, rough=ROUGH, patience=PATIENCE // 2)
        points = found.point
        best = np.argsort(found.cost)[:REFINED_STARTS]
        kept = best[found.cost[best] <= 2 * found.cost[found.lead]]
    return fit, found, kept


def grown(
    method: Trajectories, model: Model, levels: np.ndarray, noise: np.ndarray, shown: Callable[[str], object]
) -> tuple[Fitting, Found, np.ndarray]:
    """Return the minima near the guesses of the first windows, and follow them along the record: one more window
    begins at the end of the last one, before motions that are alike become different. Arguments as of `narrowed`."""
    most = int(model.windows.number.max()) + 1
    part = lambda count: replace(model, windows=model.windows.first(count))
    begun = part(1).begun(levels)
    guess = begun[..., : len(SIZES)] / SIZES
    fit = Fitting(part(1), guess, part(1).carried(begun), noise)
    points = np.hstack([levels, guess.reshape(len(guess), -1)])
    kept = np.argsort(fit.rows(points, np.arange(len(points))).cost, kind="stable")[: method.starts]
    fit, points = fit.of(kept), points[kept]
    for count in range(1, most + 1):
        tell = lambda more, count=count: shown(f"{count} of {most} windows: {more}")
        found = search(fit.rows, points, tell, rough=ROUGH, patience=GROWN_PATIENCE)
        # lost motions have no end at which more windows could begin
        if found.all_lost:
            break
        # the least squares of a part need not lead to those of the whole
        kept = np.argsort(found.cost)[:REFINED_STARTS]
        if count < most:
            fit, points = fit.onward(found.point, kept, part(count + 1))
    return fit, found, found.distinct(found.cost[found.lead])


def _covariance(local: Chain) -> Float[np.ndarray, "parameters parameters"]:
    """Return the covariance of the levels at the only point of a chain."""
    # by a root, so that no variance becomes negative where slopes in chaos are very large
    inverse = np.linalg.inv(local.root[0])
    return inverse @ inverse.T


def _banded(value: np.ndarray, slope: np.ndarray, per_level: np.ndarray) -> np.ndarray:
    """Return values (starts, windows, ...) and slopes by a window's own directions as rows of a `Chain`."""
    own, ten = per_level.shape[1], len(SIZES)
    value = value.reshape(*value.shape[:2], -1)
    slope = slope.reshape(*value.shape, -1)
    found = np.zeros((*value.shape, 2 * ten + own + 1))
    found[..., :ten] = slope[..., own:]
    found[..., 2 * ten : -1] = slope[..., :own] * per_level[:, None, None]
    found[..., -1] = value
    return found
