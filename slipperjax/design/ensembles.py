"""Ensembles of runs around a design: their sizes, their rails, and planes through their values."""

import abc
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from ..analysis.quantiles import bootstrap, check_quantile, least_rails, mean_plane, quantile_plane, standard_error
from ..model.rails import TrackSet
from ..model.scene import Scene
from ..model.tracks import AbstractTrack
from ..orbits.motions import recurs
from ..tools.checks import instance, require, whole

Planes = tuple[Float[np.ndarray, "objectives unknowns"], Float[np.ndarray, "objectives unknowns"]]
"""For each objective, its value at a design and its slopes per reach, and the standard errors of both; NaN where
there are too few runs."""


class AbstractEnsemble(abc.ABC):
    """Runs at the corners of a small box around a design, with a plane through their values."""

    box_reach: ClassVar[float]
    """Distance of the runs' parameters from a design's parameters [unit box]."""
    relative_reach: ClassVar[float]
    """The same distance in `sensitivities`, over the parameters' values [1]."""
    transient: int
    periods: int
    seed: int

    @abc.abstractmethod
    def conditions(
        self, track: AbstractTrack, corners: int
    ) -> tuple[Int[np.ndarray, " runs"], dict[str, np.ndarray]]:
        """Return the differences between the runs at each corner, the same at all corners and for all designs.

        **Returns:** the number of the rail of each run, because runs on one rail are not independent; and the numbers
        that choose the rails, by their paths in the scene, without a path where all runs have one rail.
        """

    @abc.abstractmethod
    def fit(
        self,
        corners: Float[np.ndarray, "corners parameters"],
        values: Float[np.ndarray, "corners runs objectives"],
        rail: Int[np.ndarray, " runs"],
    ) -> Planes:
        """Fit a plane to runs at the corners of a box around a design, for each objective.

        **Arguments:** `corners`: differences from the design, in multiples of the reach; `values`: NaN for lost runs;
        `rail`: of `conditions`.
        """


@dataclass(frozen=True)
class EnsembleSettings(AbstractEnsemble):
    """Ensembles of runs from disturbed starts, whose values are averaged.

    With the defaults the error of slopes is about 10 % where averages change by as much.
    """

    box_reach = 0.005
    relative_reach = 0.002
    members: int = 32
    """Runs of each case, in all corners together."""
    transient: int = 60
    """Forcing periods before recording, in which disturbances grow to the attractor's size."""
    periods: int = 100
    """Recorded forcing periods of each run."""
    seed: int = 0
    """Random seed of the disturbances."""

    def __post_init__(self):
        _check_whole(self, members=4)

    def conditions(self, track, corners):
        # each corner has as many runs as are needed for all members
        return np.arange(-(-self.members // corners)), {}

    def fit(self, corners, values, rail):
        _, runs, objectives = values.shape
        rows = values.reshape(-1, objectives)
        used = np.isfinite(rows).all(axis=1)
        system = _system(corners, runs)[used]
        # remaining degrees of freedom, for the errors
        freedom = len(system) - system.shape[1]
        if freedom <= 0 or used.mean() < 0.5:
            return _unknown(corners, objectives)
        planes, *_ = np.linalg.lstsq(system, rows[used], rcond=None)
        left = rows[used] - system @ planes
        variance = np.sum(left**2, axis=0) / freedom
        covariance = np.linalg.pinv(system.T @ system)
        return planes.T, np.sqrt(np.diag(covariance)[:, None] * variance).T


@dataclass(frozen=True)
class RailEnsemble(AbstractEnsemble):
    """Ensembles of runs along rails that do not recur, with a quantile of their values.

    Where the scene's track is one of many rails, each run of a corner has its own rail: seeds of a `RandomTrack` or
    of `RandomRails`, or numbers of a `TrackSet`. Of a `TrackSet`, ensembles with an even seed use the even numbers,
    those with an odd seed the odd numbers. Where a set has fewer rails than runs, its rails repeat with other starts.
    All designs run on the same rails. A rail with a lost run is left out. Periods are reference lengths of travel.
    """

    box_reach = 0.05
    relative_reach = 0.05
    rails: int = 80
    """Runs at each corner of a box, each on its own rail where there are enough rails."""
    transient: int = 5
    """Reference lengths before recording."""
    periods: int = 100
    """Recorded reference lengths of each run."""
    seed: int = 0
    """Number of the batch of rails: batches of an even and an odd seed have no common rail."""
    quantile: float | None = 0.95
    """Share of rails on which the objective is lower [1]; None for the mean."""

    def __post_init__(self):
        _check_whole(self, rails=2)
        check_quantile(self.quantile, self.rails)

    def conditions(self, track, corners):
        count = self.rails
        chosen = {}
        for path, part in _of_many(track, "track").items():
            if isinstance(part, TrackSet):
                half = np.arange(self.seed % 2, len(part.tracks), 2.0)
                chosen[path] = half[np.arange(count) % len(half)]
            else:
                chosen[path] = self.seed * count + np.arange(count, dtype=float)
        # rails with a common part are not independent; on a single rail each start counts
        parts = [np.unique(numbers, return_inverse=True)[1] for numbers in chosen.values()]
        return min(parts, key=np.max, default=np.arange(count)), chosen

    def unseen(self, track: AbstractTrack) -> str:
        """Return a text that names what a search along these rails has not used, for the last judgement."""
        rail, chosen = replace(self, seed=self.seed + 1).conditions(track, 1)
        if not chosen:
            return f"from {len(rail)} other starts along the one rail of the search"
        return f"along {len(np.unique(rail))} rails that the search has not seen"

    def fit(self, corners, values, rail):
        # a rail counts only with all its runs at all corners
        whole = np.isfinite(values).all(axis=(0, 2))
        counted = ~np.isin(rail, rail[~whole])
        _, index = np.unique(rail[counted], return_inverse=True)
        rails = len(np.unique(index))
        if rails < least_rails(self.quantile):
            return _unknown(corners, values.shape[2])
        system = _system(corners, len(index))
        fits = []
        for column in values[:, counted].reshape(len(system), -1).T:
            # a rail is drawn with all its runs
            def plane(weights, column=column):
                of_runs = np.tile(weights[index], len(corners))
                if self.quantile is None:
                    return mean_plane(system, column, of_runs)
                return quantile_plane(system, column, self.quantile, of_runs)

            found, drawn = bootstrap(plane, rails)
            fits.append((found, standard_error(drawn, rails)))
        planes, errors = map(np.array, zip(*fits, strict=True))
        return planes, errors


def _check_whole(ensemble: AbstractEnsemble, **size: int) -> None:
    """Check the numbers of an ensemble. **Arguments:** `size`: least number of its runs, by the field's name."""
    for name, least in (*size.items(), ("transient", 0), ("periods", 1), ("seed", 0)):
        whole(name, getattr(ensemble, name), least)


def _system(corners: Float[np.ndarray, "corners parameters"], runs: int) -> Float[np.ndarray, "rows unknowns"]:
    """Return the system of equations of planes through runs at corners, corner by corner."""
    return np.column_stack([np.ones(len(corners) * runs), np.repeat(corners, runs, axis=0)])


def _unknown(corners: np.ndarray, objectives: int) -> Planes:
    unknown = np.full((objectives, 1 + corners.shape[1]), np.nan)
    return unknown, unknown


def _of_many(track: AbstractTrack, path: str) -> dict[str, AbstractTrack]:
    """Return the parts of a track that are one of many rails, by the paths of the numbers that choose them."""
    # such a track chooses the rails within it; a single rail is no choice
    if isinstance(track, TrackSet) and len(track.tracks) == 1:
        return {}
    if track.chosen_by:
        return {f"{path}.{track.chosen_by}": track}
    found = {}
    # sums, windows and pairs hold other tracks
    for name, part in vars(track).items():
        if isinstance(part, AbstractTrack):
            found |= _of_many(part, f"{path}.{name}")
    return found


def ensemble_for(scene: Scene, ensemble: AbstractEnsemble | None) -> AbstractEnsemble:
    """Return a user's ensemble, by default an ensemble that suits the scene's track.

    **Raises:** `ValueError` for one without rails where the track does not recur, and for too few or too short rails.
    """
    on_rails = not bool(recurs(scene))
    kind = RailEnsemble if on_rails else EnsembleSettings
    ensemble = kind() if ensemble is None else ensemble
    instance("ensemble", ensemble, kind, f"a slipperjax.design.{kind.__name__}")
    if on_rails:
        known = scene.track.extent - scene.track.origin
        # whole periods, up to rounding
        most = np.floor(known / float(scene.wavelength) * (1 + 1e-9))
        periods = ensemble.transient + ensemble.periods
        need = f"have at most {most:g} periods, transient included, because the rail is known up to that"
        require(periods <= most, "ensemble", need, shown=f"{periods}")
        # the search uses one half of a set of rails, and the last judgement the other half
        halves = [replace(ensemble, seed=seed).conditions(scene.track, 1)[0] for seed in (0, 1)]
        check_quantile(ensemble.quantile, min(len(np.unique(rail)) for rail in halves))
    return ensemble


def box_corners(parameters: int) -> Float[np.ndarray, "corners parameters"]:
    """Return corners of a box from -1 to 1 whose columns are orthogonal to each other and to their mean.

    Columns of a Hadamard matrix: about as many corners as parameters (Plackett and Burman 1946,
    doi:10.1093/biomet/33.4.305).
    """
    # the least power of 2 above the number of parameters; the first column, all ones, is for the mean
    count = 2 ** int(parameters).bit_length()
    return -scipy.linalg.hadamard(count)[:, parameters:0:-1].astype(float)
