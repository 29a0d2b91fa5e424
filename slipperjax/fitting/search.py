"""Least squares from many starts at once, by the method of Levenberg and Marquardt in a region of trust.

The residuals come from programs of their own, which are asked for the points that the method wants to see. Of each
point it sees the residuals and their exact derivatives, see `Chain`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .chain import Chain

DAMPING = 1e-2
"""Of the first step, over the squares of the slopes [1]."""
MOST_STEPS = 40
"""Points that a search tries from each start."""
NEAR = 0.2
"""Distance from the least squares, in standard errors, at which a search has converged."""
STALLED = 0.5
"""The same where no more is gained: impacts that come or go leave kinks in a sum of squares."""
GAIN = 0.02
"""Change of the sum of squares that is none, that of a seventh of a standard error [1]."""
PATIENCE = 4
"""Points without any gain after which a search stops; of a rough one half as many."""
APART = 4.0
"""Distance from which on two minima are different ones [standard errors]."""
GIVEN_UP_ABOVE = 2.0
"""Sum of squares over the least of all at which a search is given up once another one has converged."""
POOR, WELL = 0.01, 0.99
"""Shares of the gain that slopes predict below which steps become shorter, and above which steps become longer; these
four numbers are those of Gould et al., 4OR 3 (2005) 227."""
SHORTER, LONGER = 0.25, 3.5
"""What the region of trust is multiplied by then."""


Evaluate = Callable[[np.ndarray, np.ndarray], Chain]
"""Returns residuals and slopes at points of some starts, whose indices it is told."""


@dataclass
class Found:
    """Searches by the method of Levenberg and Marquardt, at the best points that they have seen."""

    point: Float[np.ndarray, "starts unknowns"]
    local: Chain
    """Residuals and slopes there."""
    damping: Float[np.ndarray, "starts unknowns"]
    """By which unknowns are kept small. All count alike by what they change, as Marquardt did."""
    still: Int[np.ndarray, " starts"]
    """Points since anything was gained."""
    rough: float
    """Share of the sum of squares that is no gain [1]."""

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
        """Index of the best."""
        return int(np.argmin(self.cost))

    @property
    def of_lead(self) -> Chain:
        """Residuals and slopes of the best."""
        return self.local.at(np.array([self.lead]))

    @property
    def active(self) -> Bool[np.ndarray, " starts"]:
        """Whether each search goes on: not those that stand still, have come to the best or are hopeless."""
        on = ~self.converged & (self.still < self.patience)
        if on[self.lead]:
            return on
        # in standard errors
        apart = np.linalg.norm(self.of_lead.along(self.point - self.point[self.lead]), axis=1)
        return on & (self.cost < GIVEN_UP_ABOVE * self.cost[self.lead]) & (apart > 1.0)

    def nearest(self, most: int) -> Int[np.ndarray, " some"]:
        """Return the indices of up to `most` points whose sum of squares is at most twice the least, the best
        first."""
        order = np.argsort(self.cost)[:most]
        return order[self.cost[order] <= 2 * self.cost[self.lead]]

    def distinct(self, more: float) -> Int[np.ndarray, " minima"]:
        """Return the indices of ends whose levels are apart, and whose sum of squares is at most `more` above the
        least, the best first."""
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
        """Look at the next points of some starts, go there where they are better, and change the damping."""
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

    **Arguments:** `shown`: is told of the progress; `rough`: share of the sum of squares that is no gain [1].
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
