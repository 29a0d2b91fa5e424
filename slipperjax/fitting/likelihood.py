"""Fits of features: a normal likelihood of features, whose mean and covariance come from ensembles of runs.

S. N. Wood, *Statistical inference for noisy nonlinear ecological dynamic systems*, Nature 466 (2010) 1102,
doi:10.1038/nature09319. The best guesses of the parameters summarise the features, as in P. Fearnhead and D. Prangle,
J. R. Stat. Soc. B 74 (2012) 419, doi:10.1111/j.1467-9868.2011.01010.x. The means of these summaries are quadratic
functions of the parameters, fitted to ensembles in the whole region that the record allows, so that chance in one
ensemble has little effect.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import digamma
from scipy.stats import multivariate_t

from ..flow.period_map import advance
from ..flow.record import Labelled
from ..flow.status import heed_interrupts
from ..flow.stepping import ROOM, calls_of
from ..model.kinematics import disturbances
from ..model.quantities import MOTION_NUMBERS
from ..model.sensors import Rig
from ..orbits.motions import recurs
from ..tools.checks import require, tuple_of, warn, whole
from ..tools.columns import column
from ..tools.compile import as_argument
from .course import SIZES, Model, Windows, begin
from .features import DEFAULT, AbstractFeature
from .measured import Signal
from .method import AbstractFitMethod, Posterior, Problem, spread

RIDGE = 1e-2
"""Number added to the squares of the features from which parameters are guessed [1]."""
WIDER = 2.0
"""Standard deviations of proposals over the present standard deviations of the parameters."""
OUTLYING = 3.0
"""Distance from the mean, in standard deviations, to which features farther away are moved."""
REGULAR = 0.2
"""Spread of an ensemble over the usual spread below which its motions are of another kind."""
FARTHEST = 2.5
"""Distance from the likely levels, in the scale of proposals, beyond which functions of levels are not reliable."""
DRAWS = 4000
"""Number of likely parameters of a posterior."""
SHOWN = 24
"""Number of these whose densities are kept."""
LANES = 32
"""Runs in one call."""
SIGNIFICANCE_OF_FEATURES = 0.01
"""Share of records with at least the same distance from the others, below which a model does not explain a record.
"""
MIN_RUNS_FOR_P_VALUE = 200
"""Least number of runs near the likely parameters with which a record is compared."""


@dataclass(frozen=True)
class Features(AbstractFitMethod):
    """Fit features of the signals, over ensembles of runs with other starts, and other rails if these are random.

    For chaotic motions and random rails, where no trajectory stays near a record. Sensors need a `noise`, and the
    speed must be constant.
    """

    features: tuple[AbstractFeature, ...] = DEFAULT
    members: int = 16
    """Runs at each proposal, with the same starts and rails at all proposals."""
    proposals: int = 64
    """Number of parameters that are tried at once."""
    rounds: int = 5
    """Most rounds of such tries."""
    transient: int = 300
    """Forcing periods before a run is similar to the record: transients may take 70 periods to halve."""

    def __post_init__(self):
        features = tuple_of("features", self.features, AbstractFeature, "kinds of features of slipperjax.fitting")
        require(features, "features", "have one kind or more", shown="none")
        object.__setattr__(self, "features", features)  # the class is frozen
        for name, least in (("members", 4), ("proposals", 16), ("rounds", 1), ("transient", 0)):
            whole(name, getattr(self, name), least)

    def check(self, problem: Problem) -> None:
        for sensor in problem.rig.sensors:
            require(sensor.noise is not None, "noise", f"be given of the sensor {sensor.name} for features", None)
        constant = problem.scene.travel(0.0).acceleration is None
        require(constant, "method", "be Trajectories() at a speed that changes", self)

    def fitted(self, problem: Problem, shown: Callable[[str], object]) -> Posterior:
        ensemble = _Ensemble.of(self, problem)
        windows = ensemble.model.windows
        (target,) = ensemble.values(windows.value)
        size = len(problem.unknowns)
        levels = spread(problem.unknowns, self.proposals, problem.seed)
        levels[0] = problem.own
        known = _Known(levels[:0], np.empty((0, self.members, len(target))))
        # so that the first emulator has the scale of the priors
        likely = _Likely(np.zeros(size), np.eye(size) / WIDER**2, levels[:0])
        rng = np.random.default_rng(problem.seed)
        for number in range(self.rounds):
            shown(f"round {number + 1} of {self.rounds}")
            known = known.with_more(levels, ensemble.features(levels, problem.seed))
            emulator = _Emulator.of(known, target, likely)
            before, likely = likely, emulator.likely()
            moved = np.abs(likely.mean - before.mean) / before.stderr
            narrowed = likely.stderr / before.stderr
            steady = moved.max() < 0.25 and narrowed.min() > 0.8 and narrowed.max() < 1.25
            converged = bool(number and steady)
            if converged:
                break
            levels = rng.multivariate_normal(likely.mean, WIDER**2 * likely.covariance, self.proposals)
            # beyond these bounds all values are similar
            levels = np.clip(levels, -3.0, 3.0)
        signals = ensemble.signals(rng.choice(likely.draws, SHOWN), 1, problem.seed + 1)
        expected, spread_of_records, excess = _records_near(known, target, likely)
        return FeaturePosterior(
            level=likely.mean,
            covariance=likely.covariance,
            information=emulator.information(likely.mean),
            converged=converged,
            minima=np.empty((0, size)),
            step_change=np.full(size, np.nan),
            start=problem.motion,
            draws=likely.draws,
            names=ensemble.names,
            measured=target,
            expected=expected,
            spread=spread_of_records,
            excess=excess,
            windows=windows,
            likely=signals[:, 0],
        )


class _Known(NamedTuple):
    """Ensembles that have been run."""

    level: Float[np.ndarray, "ensembles parameters"]
    values: Float[np.ndarray, "ensembles members features"]

    def with_more(self, levels: np.ndarray, values: Float[np.ndarray, "ensembles members features"]) -> "_Known":
        """Return these and further ensembles, without ensembles that have lost runs."""
        good = np.isfinite(values).all(axis=(1, 2))
        if not good.all():
            warn(f"{np.sum(~good)} of {len(good)} ensembles have lost runs, and are left out.")
        least = 1 + self.level.shape[1]
        need = f"have bounds within which runs are not lost, for {least} ensembles or more"
        require(len(self.level) + good.sum() >= least, "unknowns", need, shown=f"such for {good.sum()}")
        return _Known(np.concatenate([self.level, levels[good]]), np.concatenate([self.values, values[good]]))


@dataclass(frozen=True)
class _Emulator:
    """Summaries of features as functions of the levels near the likely levels, and what follows for the levels.

    There is one summary for each parameter: the best guess of its level by a linear function of the features. Means
    of summaries are quadratic functions of the levels, logarithms of their variances are linear functions, and their
    correlations are constant.
    """

    centre: Float[np.ndarray, " parameters"]
    scale: Float[np.ndarray, " parameters"]
    means: Float[np.ndarray, "terms parameters"]
    spreads: Float[np.ndarray, "linear_terms parameters"]
    """Coefficients of the logarithms of standard deviations."""
    correlation: Float[np.ndarray, "parameters parameters"]
    """Correlations, including the misfit of the quadratic functions, and therefore more than one on the diagonal."""
    target: Float[np.ndarray, " parameters"]
    """Summaries of the record."""

    @classmethod
    def of(cls, known: _Known, record: np.ndarray, before: "_Likely") -> "_Emulator":
        """Return the emulator for a record's features, near the likely levels of an earlier emulator."""
        _, members, features = known.values.shape
        size = len(before.mean)
        scale = before.stderr * WIDER
        z = (known.level - before.mean) / scale
        # near ensembles count most; ensembles of regular motions, with hardly any spread, do not count
        weight = np.exp(-0.5 * np.sum(z**2, axis=1) / (size + 1))
        own = known.values.std(axis=1)
        # the usual spread, of most ensembles with any spread
        weights = np.where((own > 0) | ~np.any(own > 0, axis=0), weight[:, None], 0.0)
        usual = np.quantile(own, 0.5, axis=0, weights=weights, method="inverted_cdf")
        weight = np.where(np.median(own / np.maximum(usual, 1e-6), axis=1) < REGULAR, 0.0, weight)
        runs = known.values.reshape(-1, features)
        of_run = np.repeat(weight, members)
        middle = of_run @ runs / of_run.sum()
        total = np.sqrt(of_run @ (runs - middle) ** 2 / of_run.sum()) + 1e-12
        # single runs may be far from all other runs
        clipped = lambda values: np.clip((values - middle) / total, -OUTLYING, OUTLYING)
        x = clipped(runs)
        gram = x.T @ (of_run[:, None] * x) + RIDGE * of_run.sum() * np.eye(x.shape[1])
        to_level = np.linalg.solve(gram, x.T @ (of_run[:, None] * np.repeat(z, members, axis=0)))
        summary = (x @ to_level).reshape(-1, members, size)
        terms = _terms(z)
        root = np.sqrt(weight)[:, None]
        mean = summary.mean(axis=1)
        means, *_ = np.linalg.lstsq(terms * root, mean * root, rcond=None)
        # logarithms of variances of few runs are too low on average
        free = (members - 1) / 2
        deviation = summary.std(axis=1, ddof=1)
        logarithm = np.log(np.maximum(deviation, 1e-9)) - 0.5 * (digamma(free) - np.log(free))
        few = terms[:, : size + 1]
        spreads, *_ = np.linalg.lstsq(few * root, logarithm * root, rcond=None)
        # common correlations, in multiples of standard deviations, without runs of another kind
        expected = np.exp(few @ spreads)
        away = np.clip((summary - mean[:, None]) / expected[:, None], -OUTLYING, OUTLYING)
        common = np.einsum("e,emi,emj->ij", weight, away, away) / (weight.sum() * (members - 1))
        # the misfit of a quadratic function is more than the chance of ensembles
        left = (mean - terms @ means) / expected * root
        misfit = left.T @ left / max(weight.sum() - terms.shape[1], 1.0)
        values, vectors = np.linalg.eigh(misfit - common / members)
        correlation = common * (1 + 1 / members) + (vectors * np.maximum(values, 0.0)) @ vectors.T
        return cls(before.mean, scale, means, spreads, correlation, clipped(record) @ to_level)

    def _logarithm(self, level: np.ndarray) -> np.ndarray:
        """Return the logarithm of the posterior density, up to a constant."""
        z = (level - self.centre) / self.scale
        terms = _terms(z)
        expected = np.exp(terms[:, : level.shape[1] + 1] @ self.spreads)
        away = (terms @ self.means - self.target) / expected
        chi = np.einsum("li,ij,lj->l", away, np.linalg.inv(self.correlation), away)
        return -0.5 * (chi + np.sum(level**2, axis=1)) - np.sum(np.log(expected), axis=1)

    def likely(self) -> "_Likely":
        """Return likely levels, by importance sampling with proposals that come closer in a few rounds."""
        rng = np.random.default_rng(0)
        size = len(self.centre)
        mean, covariance = self.centre, np.diag(np.minimum(self.scale, 1.0) ** 2)
        for _ in range(12):
            proposal = multivariate_t(mean, covariance, df=6)
            level = proposal.rvs(DRAWS, random_state=rng).reshape(DRAWS, size)
            inside = np.abs((level - self.centre) / self.scale) < FARTHEST
            level = level[np.all(inside & (np.abs(level) < 4.0), axis=1)]
            logarithm = self._logarithm(level) - proposal.logpdf(level)
            share = np.exp(logarithm - logarithm.max())
            # a few proposals with large weights would end the search, so that weights are shared
            share = np.minimum(share / share.sum(), 20.0 / DRAWS)
            share /= share.sum()
            mean = share @ level
            covariance = np.einsum("l,li,lj->ij", share, level - mean, level - mean) + 1e-8 * np.eye(size)
        chosen = rng.choice(len(level), DRAWS, p=share)
        return _Likely(mean, covariance, level[chosen])

    def information(self, level: np.ndarray) -> np.ndarray:
        """Return Fisher's information of the summaries on the levels, at some level."""
        z = (level - self.centre) / self.scale
        # differences of quadratic functions are exact
        change = np.eye(len(z))
        slope = ((_terms(z + change) - _terms(z - change)) / 2 @ self.means).T
        slope = slope / self.scale / np.exp(_terms(z)[: len(z) + 1] @ self.spreads)[:, None]
        return slope.T @ np.linalg.solve(self.correlation, slope)


class _Likely(NamedTuple):
    """Likely levels of the parameters."""

    mean: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    draws: Float[np.ndarray, "draws parameters"]

    @property
    def stderr(self) -> Float[np.ndarray, " parameters"]:
        """Standard deviations of the likely levels."""
        return np.sqrt(np.diag(self.covariance))


def _records_near(known: _Known, record: np.ndarray, likely: _Likely) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean and standard deviation of the features of records near likely levels, and the share of these
    records whose distance from the others is at least that of the measured record [1]."""
    away = known.level - likely.mean
    far = np.einsum("ei,ij,ej->e", away, np.linalg.inv(likely.covariance), away)
    near = np.argsort(far)[: max(len(far) // 10, -(-MIN_RUNS_FOR_P_VALUE // known.values.shape[1]))]
    runs = known.values[near].reshape(-1, len(record))
    middle, deviation = runs.mean(axis=0), runs.std(axis=0) + 1e-12
    x = (np.vstack([record, runs]) - middle) / deviation
    shape = np.linalg.inv(np.corrcoef(x[1:].T + 1e-9) + np.eye(len(record)))
    distance = np.einsum("ri,ij,rj->r", x, shape, x)
    return middle, deviation, float((1 + np.sum(distance[1:] >= distance[0])) / len(distance))


def _terms(z: np.ndarray) -> np.ndarray:
    """Return the terms of a quadratic function of (..., parameters)."""
    factors = np.insert(z, 0, 1.0, axis=-1)
    first, second = np.triu_indices(factors.shape[-1])
    return factors[..., first] * factors[..., second]


@dataclass(frozen=True)
class _Ensemble:
    """Runs whose features are compared with those of the record."""

    method: Features
    model: Model
    """With one window, the whole record at equal times."""
    functions: list[tuple[int, Callable]]
    """Functions that compute features of a signal, with the sensor's number."""
    names: list[str]

    @classmethod
    def of(cls, method: Features, problem: Problem) -> "_Ensemble":
        require(len(problem.runs) == 1, "measured", "be one run for features", shown=f"{len(problem.runs)} runs")
        (run,) = problem.runs
        equal, functions, names = [], [], []
        for k, (sensor, signal) in enumerate(zip(problem.rig.sensors, run.signals, strict=True)):
            equal.append(_at_equal_times(sensor.name, signal))
            for feature in method.features:
                of_kind, function = feature.of(equal[k].value)
                functions.append((k, function))
                names += [f"{sensor.name} {name}" for name in of_kind]
        problem = replace(problem, runs=(run._replace(signals=tuple(equal)),))
        return cls(method, Model.of(problem, Windows.of(problem)), functions, names)

    def values(self, signals: Float[np.ndarray, "runs sensors samples"]) -> Float[np.ndarray, "runs features"]:
        """Return features of signals; each sensor has as many samples as in its record."""
        known = self.model.windows.known[0] > 0
        return np.concatenate([values(signals[:, k][:, known[k]]) for k, values in self.functions], axis=1)

    def features(self, levels: np.ndarray, seed: int) -> Float[np.ndarray, "ensembles members features"]:
        """Return features of ensembles at some levels, NaN for lost runs."""
        signals = self.signals(levels, self.method.members, seed)
        good = np.isfinite(signals).all(axis=(2, 3))
        found = np.full((*good.shape, len(self.names)), np.nan)
        if good.any():
            found[good] = self.values(signals[good])
        return found

    def signals(
        self, levels: np.ndarray, members: int, seed: int
    ) -> Float[np.ndarray, "ensembles members sensors samples"]:
        """Return noisy signals of ensembles, with the same starts, rails and noise at all levels."""
        method, model, problem = self.method, self.model, self.model.problem
        rng = np.random.default_rng(seed)
        # velocities of a third of their scales, which chaos makes as different as possible
        change = disturbances(problem.scene, 0.3, members, rng)
        first = np.array([float(getattr(problem.motion, name)) for name in MOTION_NUMBERS]) + change
        numbers = np.tile(first / SIZES, (len(levels), 1))[:, None]
        noise = np.array([sensor.noise for sensor in problem.rig.sensors])[:, None]
        deviates = rng.normal(size=(members, *model.windows.time.shape[1:]))
        settle = method.transient
        origin = problem.origin + settle
        reader = model.reader(model.samples, origin)

        def work(scenes, starts, window, q):
            epoch = np.full(len(window), problem.origin)
            states = begin(scenes, starts, epoch, names=problem.names).state
            # nothing is recorded before the motion has settled
            at = problem.origin
            for used in calls_of(settle):
                heed_interrupts()
                how = dict(solver=problem.solver, periods=ROOM, used=as_argument(used))
                states = advance(scenes, states, at, model.stepping, **how).state
                at += used
            now = begin(scenes, states, epoch + settle, names=problem.names)
            seen = model.followed(scenes, now, origin, 0, model.windows.periods)
            read, _ = reader(scenes, q, seen, None, epoch + settle, model.windows.time[window])
            return [np.asarray(read)]

        rails = {}
        scene = problem.scene
        if scene.track.chosen_by and not recurs(scene):
            # for random rails each member has its own rail
            number = np.arange(members) + 1000 * (seed + 1)
            rails[f"track.{scene.track.chosen_by}"] = np.tile(number, len(levels))
        (read,) = model.each(np.repeat(levels, members, axis=0), numbers, LANES, work, **rails)
        return read.reshape(len(levels), members, *read.shape[2:]) + noise * deviates


def _at_equal_times(sensor: str, signal: Signal) -> Signal:
    """Return a signal at equal times, which begin at zero.

    **Raises:** `ValueError` where more than 5 % of the samples are missing, or there are fewer than 100.
    """
    rate = 1 / float(np.median(np.diff(signal.time)))
    count = round(np.ptp(signal.time) * rate) + 1
    missing = 1 - len(signal.time) / count
    need = f"have 100 or more equal times of {sensor}, of which at most 5 % are missing, for features"
    good = missing <= 0.05 and count >= 100
    require(good, "measured", need, shown=f"{count} times, {100 * missing:.2g} % missing")
    time = np.arange(count) / rate
    return Signal(time, np.interp(signal.time[0] + time, signal.time, signal.value))


@dataclass(frozen=True, kw_only=True)
class FeaturePosterior(Posterior):
    """What is known about the parameters, and the features that follow from them."""

    draws: Float[np.ndarray, "draws parameters"]
    """Likely levels."""
    names: list[str]
    """Names of the features."""
    measured: Float[np.ndarray, " features"]
    expected: Float[np.ndarray, " features"]
    spread: Float[np.ndarray, " features"]
    """Standard deviations of features of records like the measured record."""
    excess: float
    """Share of such records whose distance from the others is at least that of the measured record [1]."""
    windows: Windows
    """The record at equal times, as one window."""
    likely: Float[np.ndarray, "shown sensors samples"]
    """Signals of likely parameters, with noise."""

    def ends(self, confidence: float) -> np.ndarray:
        return np.quantile(self.draws, [0.5 - confidence / 2, 0.5 + confidence / 2], axis=0)

    def misfit(self, rig: Rig) -> list[str]:
        if self.excess > SIGNIFICANCE_OF_FEATURES:
            return []
        far = np.argsort(-np.abs(self.measured - self.expected) / self.spread)[:3]
        worst = ", ".join(self.names[k] for k in far)
        return [f"the model does not explain the features (p = {self.excess:.1g}), least of all {worst}"]

    def label(self, rig: Rig) -> Labelled:
        data = {
            "measured_feature": column("feature", self.measured, "", "mean feature of the record"),
            "fitted_feature": column("feature", self.expected, "", "mean feature of the model"),
            "feature_stderr": column("feature", self.spread, "", "standard deviation of such records"),
        }
        rows, coords = self.windows.densities(0, np.nan_to_num(self.likely))
        return data | rows, coords | {"feature": self.names}
