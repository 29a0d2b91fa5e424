"""Least squares from many starts at once, by the method of Levenberg and Marquardt in a trust region.

Separate programs compute the residuals at the points that the method asks for, and their exact derivatives. Windows
of records form a chain: each begins with its own numbers, and ends near the numbers of the next window; all windows
depend on the same levels of the parameters. They are eliminated block by block. Therefore memory and time grow as the
number of windows, and not as its square, as for arrays of all derivatives.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

LOST = 1e24
"""Sum of squares of a lost motion."""


class Chain(NamedTuple):
    """Residuals at some points and their derivatives, rotated so that these are triangular; sums of squares are kept.

    The unknowns of a point are first the levels, then the numbers of each window. There may be no windows.
    """

    windows: Float[np.ndarray, "points windows numbers columns"]
    """As many rows for each window as it has numbers. Columns: the window's numbers, the next window's numbers, the
    levels, and the residual."""
    levels: Float[np.ndarray, "points more columns"]
    """One row more than there are levels. Columns: the levels, and the residual."""

    @classmethod
    def of(
        cls,
        windows: Float[np.ndarray, "points windows rows columns"],
        levels: Float[np.ndarray, "points some fewer"],
    ) -> "Chain":
        """Return the chain of any number of rows, with the columns above.

        A QR decomposition eliminates the numbers of each window in turn; rows of the next window's numbers and of the
        levels remain. Lost motions, with some rows that are not finite, get the worst possible residual.
        """
        good = np.isfinite(windows).all(axis=(1, 2, 3)) & np.isfinite(levels).all(axis=(1, 2))
        windows, levels = (np.where(good.reshape(-1, *[1] * (a.ndim - 1)), a, 0.0) for a in (windows, levels))
        points, count, _, columns = windows.shape
        own = levels.shape[-1] - 1
        numbers = (columns - own - 1) // 2
        found = np.zeros((points, count, numbers, columns))
        left = np.zeros((points, 0, columns - numbers))
        for k in range(count):
            before = np.insert(left, [numbers] * numbers, 0.0, axis=2)
            few = _rotated(np.concatenate([before, windows[:, k]], axis=1))
            found[:, k] = few[:, :numbers]
            left = few[:, numbers:, numbers:]
        rest = np.concatenate([left[..., numbers:], levels, np.zeros((points, own + 1, own + 1))], axis=1)
        last = _rotated(rest)
        last[~good, -1, -1] = np.sqrt(LOST)
        return cls(found, last)

    @property
    def numbers(self) -> int:
        """Numbers of a window."""
        return self.windows.shape[2]

    def at(self, index: np.ndarray) -> "Chain":
        """Return the chains of some of the points."""
        return Chain(*(array[index] for array in self))

    @property
    def residual(self) -> Float[np.ndarray, "points rows"]:
        """Residuals of windows, then of levels."""
        return np.concatenate([_flat(self.windows[..., -1]), self.levels[..., -1]], axis=1)

    @property
    def cost(self) -> Float[np.ndarray, " points"]:
        """Sum of squares."""
        return np.sum(self.residual**2, axis=1)

    @property
    def distance(self) -> Float[np.ndarray, " points"]:
        """Distance from the least squares, by the slopes [standard errors]."""
        # no unknown changes the last row
        return np.linalg.norm(self.residual[:, :-1], axis=1)

    @property
    def root(self) -> Float[np.ndarray, "points levels levels"]:
        """R of the inverse covariance R^T R of the levels, for any numbers of the windows."""
        return self.levels[:, :-1, :-1]

    @property
    def lengths(self) -> Float[np.ndarray, "points unknowns"]:
        """Lengths of the columns of the derivatives."""
        square = np.sum(self.windows[..., :-1] ** 2, axis=2)
        of_windows = square[..., : self.numbers].copy()
        of_windows[:, 1:] += square[:, :-1, self.numbers : 2 * self.numbers]
        of_levels = square[..., 2 * self.numbers :].sum(axis=1) + np.sum(self.root**2, axis=1)
        return np.sqrt(np.concatenate([of_levels, _flat(of_windows)], axis=1))

    def along(self, way: Float[np.ndarray, "points unknowns"]) -> Float[np.ndarray, "points rows"]:
        """Return the changes of the residuals, to first order. Here and below, one chain serves many points."""
        levels, numbers = self._split(way)
        # the last window has no next one, and its slopes by it are zero
        after = np.roll(numbers, -1, axis=1)
        each = np.broadcast_to(levels[:, None], (*numbers.shape[:2], levels.shape[1]))
        columns = np.concatenate([numbers, after, each], axis=2)
        of_windows = _times(self.windows[..., :-1], columns)
        return np.concatenate([_flat(of_windows), _times(self.levels[..., :-1], levels)], axis=1)

    def damped(self, weight: Float[np.ndarray, "points unknowns"]) -> "Chain":
        """Return the same chain with further residuals: all unknowns times weights."""
        levels, numbers = self._split(weight)
        grown = []
        for rows, own in zip(self, (numbers, levels), strict=True):
            more = own[..., None] * np.eye(own.shape[-1], rows.shape[-1])
            grown.append(np.concatenate([rows, more], axis=-2))
        return Chain.of(*grown)

    def solve(self, change: Float[np.ndarray, "points unknowns"]) -> Float[np.ndarray, "points unknowns"]:
        """Return the unknowns along which the residuals change by `change`, all but the last residual."""
        size = self.numbers
        count = self.windows.shape[1]
        of_windows = change[:, : size * count].reshape(len(change), count, size)
        levels = _solved(self.root, change[:, size * count :])
        found = np.zeros(of_windows.shape)
        after = np.zeros((len(found), size))
        for k in reversed(range(count)):
            rows = self.windows[:, k]
            known = _times(rows[..., size:-1], np.concatenate([after, levels], axis=1))
            after = found[:, k] = _solved(rows[..., :size], of_windows[:, k] - known)
        return np.concatenate([levels, _flat(found)], axis=1)

    def _split(self, unknowns: Float[np.ndarray, "points unknowns"]) -> tuple[np.ndarray, np.ndarray]:
        """Return the levels, and the numbers of windows (points, windows, numbers)."""
        own = self.levels.shape[-1] - 1
        return unknowns[:, :own], unknowns[:, own:].reshape(len(unknowns), self.windows.shape[1], self.numbers)


def _rotated(rows: Float[np.ndarray, "points rows columns"]) -> Float[np.ndarray, "points few columns"]:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _flat(array: np.ndarray) -> np.ndarray:
    """Return an array of two axes."""
    return array.reshape(len(array), int(np.prod(array.shape[1:])))


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[..., None])[..., 0]


def _solved(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.linalg.solve(matrices, vectors[..., None])[..., 0]


DAMPING = 1e-2
"""Damping of the first step, over the squares of the slopes [1]."""
MOST_STEPS = 40
"""Points that a search tries from each start."""
NEAR = 0.2
"""Distance from the least squares, in standard errors, at which a search has converged."""
STALLED = 0.5
"""The same distance where there is no further gain: impacts that appear or vanish leave kinks in a sum of squares."""
GAIN = 0.02
"""Change of the sum of squares that does not count as a gain: that of a seventh of a standard error [1]."""
PATIENCE = 4
"""Points without any gain after which a search stops."""
APART = 4.0
"""Distance from which two minima count as different [standard errors]."""
GIVEN_UP_ABOVE = 2.0
"""Sum of squares over the least of all, above which a search ends without success after another one has converged."""
POOR, WELL = 0.01, 0.99
"""Shares of the gain that slopes predict: below the first, steps become shorter; above the second, longer. These four
numbers are from Gould et al., 4OR 3 (2005) 227."""
SHORTER, LONGER = 0.25, 3.5
"""Factors on the trust region in these two cases."""


Evaluate = Callable[[np.ndarray, np.ndarray], Chain]
"""Returns residuals and slopes at points of some starts, given the starts' indices."""


@dataclass
class Found:
    """Searches by the method of Levenberg and Marquardt, at their best points so far."""

    point: Float[np.ndarray, "starts unknowns"]
    local: Chain
    """Residuals and slopes at these points."""
    damping: Float[np.ndarray, "starts unknowns"]
    """Damping that keeps changes of unknowns small. Unknowns are scaled by their effect, as by Marquardt."""
    still: Int[np.ndarray, " starts"]
    """Number of points since the last gain."""
    rough: float
    """Share of the sum of squares that does not count as a gain [1]."""
    patience: int
    """Points without any gain after which a search stops."""

    @property
    def cost(self) -> Float[np.ndarray, " starts"]:
        """Sum of squares."""
        return self.local.cost

    @property
    def converged(self) -> Bool[np.ndarray, " starts"]:
        distance = self.local.distance
        return (distance < NEAR) | ((distance < STALLED) & (self.still >= self.patience))

    @property
    def lead(self) -> int:
        """Index of the best search."""
        return int(np.argmin(self.cost))

    @property
    def all_lost(self) -> bool:
        """Whether the motions of all searches are lost."""
        return bool(self.cost[self.lead] >= LOST)

    @property
    def of_lead(self) -> Chain:
        """Residuals and slopes of the best search."""
        return self.local.at(np.array([self.lead]))

    @property
    def active(self) -> Bool[np.ndarray, " starts"]:
        """Whether each search continues: not if it has stopped, has reached the best search, or has no chance."""
        on = ~self.converged & (self.still < self.patience)
        if on[self.lead]:
            return on
        # in standard errors
        apart = np.linalg.norm(self.of_lead.along(self.point - self.point[self.lead]), axis=1)
        return on & (self.cost < GIVEN_UP_ABOVE * self.cost[self.lead]) & (apart > 1.0)

    def distinct(self, more: float) -> Int[np.ndarray, " minima"]:
        """Return the indices of ends with different levels whose sum of squares is at most `more` above the least
        one, the best first."""
        (root,) = self.of_lead.root
        # in standard errors
        levels = self.point[:, : len(root)] @ root.T
        kept: list[int] = []
        for k in map(int, np.argsort(self.cost)):
            likely = self.cost[k] <= self.cost[self.lead] + more and (self.converged[k] or k == self.lead)
            if likely and np.all(np.linalg.norm(levels[kept] - levels[k], axis=1) > APART):
                kept.append(k)
        return np.array(kept)

    def step(self, index: np.ndarray, evaluate: Evaluate) -> None:
        """Try the next points of some starts, move to them where they are better, and change the damping."""
        here = self.local.at(index)
        damped = here.damped(self.damping[index])
        way = -damped.solve(damped.residual[:, :-1])
        point = self.point[index] + way
        seen = evaluate(point, index)
        predicted = np.sum((here.residual + here.along(way)) ** 2, axis=1) - here.cost
        change = seen.cost - here.cost
        gains = change < -self.rough * here.cost - GAIN
        self.still[index] = np.where(gains, 0, self.still[index] + 1)
        good = change <= POOR * predicted
        well = (change < WELL * predicted) & (predicted < 0)
        trust = np.where(good, np.where(well, LONGER, 1.0), SHORTER)
        self.damping[index] /= np.sqrt(trust)[:, None]
        better = change < 0
        for array, new in zip((self.point, *self.local), (point, *seen), strict=True):
            array[index[better]] = new[better]


def search(
    evaluate: Evaluate,
    points: Float[np.ndarray, "starts unknowns"],
    shown: Callable[[str], object] = lambda text: None,
    *,
    rough: float = 0.0,
    patience: int = PATIENCE,
) -> Found:
    """Search the least squares from some points.

    **Arguments:** `shown`: called with texts on the progress; `rough`: share of the sum of squares that is no gain
    [1]; `patience`: points without any gain after which a search stops.
    """
    local = evaluate(points, np.arange(len(points)))
    damping = np.maximum(np.sqrt(DAMPING) * local.lengths, 1e-12)
    found = Found(points.copy(), local, damping, np.zeros(len(points), int), rough, patience)
    for _ in range(MOST_STEPS):
        index = np.flatnonzero(found.active)
        shown(f"{len(index)} of {len(points)} searches, chi-squared {found.cost.min():.5g}")
        if not len(index):
            break
        found.step(index, evaluate)
    return found
