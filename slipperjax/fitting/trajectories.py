"""Fits of trajectories: least squares of the differences from the samples, by exact derivatives, from many starts."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from ..flow.record import Labelled
from ..model.kinematics import Motion
from ..model.sensors import Rig
from ..solvers.explicit import RK4
from ..tools.checks import require, whole
from ..tools.columns import column
from ..tools.limits import refuse_impossible
from .course import SIZES, Course, Model, Windows
from .method import AbstractFitMethod, Posterior, Problem, spread
from .search import LOST, Chain, Found, search

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
    """Forcing periods after which a motion begins again at the end of the last (multiple shooting). None: never."""
    transient: int = 100
    """Forcing periods after which a motion serves as a first guess."""

    def __post_init__(self):
        whole("starts", self.starts, 1)
        whole("transient", self.transient, 0)
        if self.window is not None:
            whole("window", self.window, 1)

    def solver(self, scene):
        require(scene.beam is None, "scene", "have rigid rails for a fit of trajectories", scene.beam)
        # fastest to compile and to differentiate; where its steps matter, their number will grow
        return RK4()

    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> SignalPosterior:
        windows = Windows.of(problem, self.window)
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
        guess, far = model.guesses(levels, self.transient, noise)
        kept = np.argsort(far, kind="stable")[: self.starts]
        points = np.hstack([levels, guess.reshape(len(guess), -1)])
        # first roughly from all starts, then from the few minima found
        for jump in CONTINUITY[:-1] if windows.count > 1 else CONTINUITY[:1]:
            guess = guess[kept]
            fit = Fitting(model, guess, noise, jump)
            found = search(fit.rows, points[kept], shown, rough=ROUGH)
            points = found.point
            best = np.argsort(found.cost)[:REFINED_STARTS]
            kept = best[found.cost[best] <= 2 * found.cost[found.lead]]
        if found.cost[found.lead] >= LOST:
            raise ValueError(
                "Argument `unknowns` must have values with which the motion stays on the rail, but all starts are "
                "lost: raise steps_per_period, check the units, or change the bounds."
            )
        noise = or_given(fit.noise_left(model.course(points[[found.lead]])))
        model = model.with_steps(2 * model.steps)
        for _ in range(ROUNDS):
            levels, _ = model.split(found.point)
            model = model.with_steps(problem.needed(levels[found.lead]))
            fit = Fitting(model, fit.guess[kept], noise)
            found = search(fit.rows, found.point[kept], shown)
            kept = found.distinct(LIKELY)
            shown("errors")
            by_step, by_instants, left = fit.checked(found)
            # more steps and instants, until their effect is small enough
            if np.abs(by_step).max() > NEGLIGIBLE_CHANGE:
                model = model.with_steps(2 * model.steps)
            if np.abs(by_instants).max() > NEGLIGIBLE_CHANGE:
                model = model.with_samples(2 * model.samples)
            if model is fit.model and np.all(np.isfinite(given) | (np.abs(left / noise - 1) < 0.02)):
                break
            noise = or_given(left)
        return fit.posterior(found, kept, by_step)


@dataclass(frozen=True)
class Fitting:
    """The least squares of a model; its unknowns are levels of parameters and numbers of starts."""

    model: Model
    guess: Float[np.ndarray, "starts windows 10"]
    noise: Float[np.ndarray, " sensors"]
    jump: float = CONTINUITY[-1]
    """Standard deviation of the jumps of motions from window to window [scales]."""

    def rows(self, points: Float[np.ndarray, "starts unknowns"], index: np.ndarray) -> Chain:
        """Return all residuals, in standard deviations [1], and their derivatives, at points of the starts at
        `index`: differences from samples, jumps between windows, and deviations of the unknowns from their priors."""
        course = self.model.course(points)
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
        course = self.model.course(point)

        def shift(other: Course) -> np.ndarray:
            # the change of the least squares' parameters if only the signals change
            chain = self._chain(point, index, course, other.reading - course.reading, others=0.0)
            return -chain.solve(chain.residual[:, :-1])[0, : len(errors)] / errors

        finer = self.model.with_steps(2 * self.model.steps).course(point)
        # half the instants have 14 times the error, measured with 20, 40 and 80 instants: cubics are of fourth order
        return shift(finer), shift(self.model.course(point, stride=2)) / 14, self.noise_left(course)

    def posterior(self, found: Found, kept: np.ndarray, change: np.ndarray) -> SignalPosterior:
        """Return what is known about the parameters after the searches.

        **Arguments:** `kept`: indices of the minima; `change`: by half the step [standard errors].
        """
        model = self.model
        lead = found.lead
        point = found.point[lead]
        own = len(model.problem.unknowns)
        local = found.of_lead
        (root,) = local.root
        draws = point + local.solve(np.random.default_rng(0).normal(size=(DRAWS, point.size)))
        likely = model.course(np.vstack([point, draws])).reading
        return SignalPosterior(
            level=point[:own],
            covariance=_covariance(local),
            # information of the data only, with unknown starts
            information=root.T @ root - np.eye(own),
            converged=bool(found.converged[lead]),
            minima=found.point[kept[1:], :own],
            step_change=change,
            noise=self.noise,
            windows=model.windows,
            reading=likely[0],
            draws=likely[1:],
            start=Motion(*(model.split(point[None])[1][0, 0] * SIZES)),
        )


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
