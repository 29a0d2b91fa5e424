"""Ensembles of runs around a design: their sizes, their rails, and the planes through their values."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

from ..analysis.quantiles import bootstrap, check_quantile, mean_plane, quantile_plane
from ..model.rails import TrackSet
from ..model.scene import Scene
from ..model.tracks import AbstractTrack
from ..orbits.motions import recurs
from ..tools.checks import instance, require, whole


class Plane(NamedTuple):
    """Values at a design and slopes per reach, from runs around it; NaN where the runs are too few."""

    value: Float[np.ndarray, " objectives"]
    stderr: Float[np.ndarray, " objectives"]
    slope: Float[np.ndarray, "objectives parameters"]
    slope_stderr: Float[np.ndarray, "objectives parameters"]


@dataclass(frozen=True)
class EnsembleSettings:
    """Ensembles of runs from disturbed starts, of whose values the mean is taken.

    The defaults give slopes to some 10 % where averages change by as much.
    """

    box_reach: ClassVar[float] = 0.005
    """Distance of the runs' parameters from a design's [unit box]."""
    relative_reach: ClassVar[float] = 0.002
    """The same in `sensitivities`, over the parameters' values [1]."""
    members: int = 32
    """Runs of each case."""
    transient: int = 60
    """Forcing periods before recording, in which disturbances grow to the attractor's size."""
    periods: int = 100
    """Recorded forcing periods of each run."""
    seed: int = 0
    """Of the disturbances; on rails that do not recur the number of the batch of rails, which have none in common."""

    def __post_init__(self):
        for name, least in (("members", 4), ("transient", 0), ("periods", 1), ("seed", 0)):
            whole(name, getattr(self, name), least)

    def rails(self, track: AbstractTrack, count: int) -> dict[str, np.ndarray]:
        """Return the numbers that choose `count` rails, by their paths in the scene. Here none: all share one."""
        del track, count
        return {}

    def enough(self, share: float) -> bool:
        """Return whether the share of the runs that stayed on the rail [1] is enough for a value."""
        return share >= 0.5

    def fit(
        self,
        corners: Float[np.ndarray, "corners parameters"],
        values: Float[np.ndarray, "corners runs objectives"],
        kept: np.ndarray,
    ) -> Plane:
        """Fit a plane to runs at the corners of a box around a design, for each objective.

        **Arguments:** `corners`: differences from the design, in the reach; `kept`: whether each run stayed
        on the rail, shape (corners, runs).
        """
        _, runs, objectives = values.shape
        rows = values.reshape(-1, objectives)
        used = kept.ravel() & np.all(np.isfinite(rows), axis=1)
        system = np.column_stack([np.ones(len(rows)), np.repeat(corners, runs, axis=0)])
        # a plane needs more runs than unknowns
        if used.sum() <= system.shape[1]:
            value = np.full(objectives, np.nan)
            slope = np.full((objectives, corners.shape[1]), np.nan)
            return Plane(value, value, slope, slope)
        fits, stderr = self._planes(system, rows, used, runs)
        return Plane(fits[:, 0], stderr[:, 0], fits[:, 1:], stderr[:, 1:])

    def _planes(
        self, system: np.ndarray, rows: np.ndarray, used: np.ndarray, runs: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return planes (objectives, unknowns) and their standard errors, here by least squares."""
        del runs
        system = system[used]
        planes, *_ = np.linalg.lstsq(system, rows[used], rcond=None)
        left = rows[used] - system @ planes
        # degrees of freedom that are left for the errors
        freedom = len(system) - system.shape[1]
        variance = np.sum(left**2, axis=0) / freedom
        covariance = np.linalg.pinv(system.T @ system)
        return planes.T, np.sqrt(np.diag(covariance)[:, None] * variance).T


@dataclass(frozen=True)
class RailEnsemble(EnsembleSettings):
    """Ensembles of runs along rails that do not recur, of whose values a quantile is taken.

    Each run has a rail of its own where the scene's track is one of many: the seeds of a `RandomTrack` or of
    `RandomRails`, the numbers of a `TrackSet`. All designs run on the same rails. Periods are reference lengths of
    travel. Runs that leave the rail count as greater than all others.
    """

    box_reach: ClassVar[float] = 0.05
    relative_reach: ClassVar[float] = 0.05
    members: int = 400
    """Runs of each case, at all corners of a box together."""
    transient: int = 5
    """Reference lengths before recording."""
    quantile: float | None = 0.99
    """Share of rails on which the objective is lower [1]; None for the mean."""

    def __post_init__(self):
        super().__post_init__()
        check_quantile(self.quantile, self.members)

    def rails(self, track: AbstractTrack, count: int) -> dict[str, np.ndarray]:
        # batches of different seeds have no rail in common
        numbers = self.seed * count + np.arange(count, dtype=float)
        chosen = {}
        for path, part in _of_many(track, "track").items():
            # a set of rails begins again after its last one
            chosen[path] = numbers % len(part.tracks) if isinstance(part, TrackSet) else numbers
        return chosen

    # a quantile below the lost runs is still known
    def enough(self, share: float) -> bool:
        return super().enough(share) if self.quantile is None else share > self.quantile

    def _planes(
        self, system: np.ndarray, rows: np.ndarray, used: np.ndarray, runs: int
    ) -> tuple[np.ndarray, np.ndarray]:
        planes = []
        errors = []
        for column in rows.T:
            # a quantile depends on which side of the plane a lost run lies, not on how far
            above = 2 * np.max(np.abs(column[used]), initial=0.0)
            column = np.where(used, column, above)

            # a rail is drawn with its runs at all corners
            def plane(weights, column=column):
                of_runs = np.tile(weights, len(column) // runs)
                if self.quantile is None:
                    return mean_plane(system, column, of_runs * used)
                return quantile_plane(system, column, self.quantile, of_runs)

            found, drawn = bootstrap(plane, runs)
            planes.append(found)
            errors.append(drawn.std(axis=0, ddof=1))
        return np.array(planes), np.array(errors)


def _of_many(track: AbstractTrack, path: str) -> dict[str, AbstractTrack]:
    """Return the parts of a track that are one of many rails, by the paths of the numbers that choose them."""
    # what is within such a track, it chooses itself
    if track.chosen_by:
        return {f"{path}.{track.chosen_by}": track}
    found = {}
    # sums, windows and pairs hold other tracks
    for name, part in vars(track).items():
        if isinstance(part, AbstractTrack):
            found |= _of_many(part, f"{path}.{name}")
    return found


def ensemble_for(scene: Scene, ensemble: EnsembleSettings | None) -> EnsembleSettings:
    """Return a user's ensemble, by default the one that a scene's track needs.

    **Raises:** `ValueError` for one without rails where the track does not recur, or a rail that is too short.
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
    return ensemble


def box_corners(parameters: int) -> Float[np.ndarray, "corners parameters"]:
    """Return corners of a box of -1 and 1 on which the columns are orthogonal to each other and to their mean.

    Columns of a Hadamard matrix: about as many corners as parameters (Plackett and Burman 1946,
    doi:10.1093/biomet/33.4.305).
    """
    # the least power of 2 above the number of parameters; the first column, all ones, stands for the mean
    count = 2 ** int(parameters).bit_length()
    return -scipy.linalg.hadamard(count)[:, parameters:0:-1].astype(float)
