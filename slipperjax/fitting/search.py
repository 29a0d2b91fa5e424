"""Least squares from many starts at once, by the method of Levenberg and Marquardt in a trust region.

Separate programs compute the residuals at the points that the method asks for. The method gets the residuals of each
point and their exact derivatives, see `Chain`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .chain import Chain

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
"""Points without any gain after which a search stops; half as many for a rough search."""
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

    @property
    def patience(self) -> int:
        """Points without any gain after which a search stops."""
        return PATIENCE // 2 if self.rough else PATIENCE

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

    def nearest(self, most: int) -> Int[np.ndarray, " some"]:
        """Return the indices of up to `most` points whose sum of squares is at most twice the least one, the best
        first."""
        order = np.argsort(self.cost)[:most]
        return order[self.cost[order] <= 2 * self.cost[self.lead]]

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
) -> Found:
    """Search the least squares from some points.

    **Arguments:** `shown`: called with texts on the progress; `rough`: share of the sum of squares that is no gain
    [1].
    """
    local = evaluate(points, np.arange(len(points)))
    damping = np.maximum(np.sqrt(DAMPING) * local.lengths, 1e-12)
    found = Found(points.copy(), local, damping, np.zeros(len(points), int), rough)
    for _ in range(MOST_STEPS):
        index = np.flatnonzero(found.active)
        shown(f"{len(index)} of {len(points)} searches, chi-squared {found.cost.min():.5g}")
        if not len(index):
            break
        found.step(index, evaluate)
    return found
