"""Least squares of windows that form a chain, block by block.

Each window begins with its own numbers, and ends near the numbers of the next window; all windows depend on the same
levels of the parameters. Memory and time grow as the number of windows, and not as its square, as for arrays of all
derivatives.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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
            few = np.linalg.qr(np.concatenate([before, windows[:, k]], axis=1), mode="r")
            found[:, k] = few[:, :numbers]
            left = few[:, numbers:, numbers:]
        rest = np.concatenate([left[..., numbers:], levels, np.zeros((points, own + 1, own + 1))], axis=1)
        last = np.linalg.qr(rest, mode="r")
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


def _flat(array: np.ndarray) -> np.ndarray:
    """Return an array of two axes."""
    return array.reshape(len(array), int(np.prod(array.shape[1:])))


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[..., None])[..., 0]


def _solved(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.linalg.solve(matrices, vectors[..., None])[..., 0]
