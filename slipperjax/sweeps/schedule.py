"""Schedules: what a batch of cases passes through, as spans of forcing periods with equal steps."""

import itertools
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from .grid import batch_size

FEW = 10
"""Room of programs that record no more forcing periods: their arrays are shorter."""

STEP_IN_LANES = 2
"""Lanes that take as long as the rest of a step, whatever their number: measured with 8 to 128 lanes."""


class Span(NamedTuple):
    """Forcing periods one after the other, with equal steps."""

    periods: int
    steps: int
    """Integration steps in each."""
    recorded: bool = True
    """Whether all records see them; otherwise those that sample a run from its start on."""
    probed: int = 0
    """Periods from its start on that are repeated with half the step, to measure the error; 0 for none."""


@dataclass(frozen=True)
class Schedule:
    """Stretches one after the other, of spans. Cases of one schedule run as one batch."""

    stretches: tuple[tuple[Span, ...], ...]
    """Records are finished at the end of each stretch, and begin anew after it."""

    @classmethod
    def of(cls, settled: int, recorded: int, steps: int, probed: int = 0) -> "Schedule":
        """Return a transient, of which nothing is recorded, and a recorded span, all in equal steps.

        **Arguments:** `probed`: periods of the recorded span that are probed.
        """
        return cls(((Span(settled, steps, recorded=False), Span(recorded, steps, probed=probed)),))

    @classmethod
    def of_profile(
        cls, profile: Int[np.ndarray, " periods"], stretch: int, probed: Collection[int], length: int
    ) -> "Schedule":
        """Return recorded stretches from the integration steps in each forcing period.

        **Arguments:** `stretch`: periods in each stretch; `probed`: the stretches at whose start `length` periods are
        probed.
        """
        stretches = []
        for k, first in enumerate(range(0, len(profile), stretch)):
            alike = itertools.groupby(profile[first : first + stretch].tolist())
            spans = [Span(len(list(group)), steps) for steps, group in alike]
            spans[0] = spans[0]._replace(probed=length if k in probed else 0)
            stretches.append(tuple(spans))
        return cls(tuple(stretches))

    @property
    def spans(self) -> list[Span]:
        """All spans."""
        return [span for stretch in self.stretches for span in stretch]

    @property
    def settled(self) -> int:
        """Forcing periods before the recorded ones."""
        return sum(span.periods for span in self.spans if not span.recorded)

    @property
    def recorded(self) -> int:
        """Recorded forcing periods."""
        return sum(span.periods for span in self.spans if span.recorded)

    @property
    def periods(self) -> int:
        """Forcing periods in all."""
        return self.settled + self.recorded

    @property
    def steps(self) -> int:
        """The most integration steps in a forcing period."""
        return max(span.steps for span in self.spans)

    @property
    def work(self) -> int:
        """Integration steps in all."""
        return sum(span.periods * span.steps for span in self.spans)

    @property
    def profile(self) -> list[int]:
        """Integration steps in each forcing period."""
        return [span.steps for span in self.spans for _ in range(span.periods)]

    @property
    def mean_steps(self) -> float:
        """Mean integration steps of its forcing periods."""
        return self.work / max(self.periods, 1)

    def following(self, first: int, periods: int) -> list[tuple[int, int]]:
        """Return steps and number of the next forcing periods, from a span on; the last span goes on at the end."""
        parts = []
        for span in self.spans[first:]:
            parts.append((span.steps, min(span.periods, periods)))
            periods -= parts[-1][1]
        parts.append((self.spans[-1].steps, periods))
        return [(steps, number) for steps, number in parts if number]


def shared_capacity(most: int, steps: int) -> int:
    """Return the steps that a recording program has capacity for: `most` / 8^k, the least that is not below `steps`.

    So cases share one program unless their steps differ by more than a factor of 8.
    """
    while most // 8 >= steps:
        most //= 8
    return most


def joint_profiles(
    profiles: Int[np.ndarray, "profiles periods"], which: Int[np.ndarray, " cases"]
) -> tuple[Int[np.ndarray, "fewer periods"], Int[np.ndarray, " cases"]]:
    """Return fewer profiles of steps, with at least as many steps for each case, where larger batches save time.

    **Arguments:** `which`: the profile of each case.
    """
    # time that a batch takes, in steps of one lane
    cost = lambda profile, cases: int(profile.sum()) * (STEP_IN_LANES + batch_size(len(cases)))
    order = np.argsort(profiles.sum(axis=1), kind="stable")
    groups = [(profiles[k], np.flatnonzero(which == k)) for k in order]
    # each step joins the two neighbours that save most
    while len(groups) > 1:
        joint = []
        saved = []
        for a, b in itertools.pairwise(groups):
            both = np.maximum(a[0], b[0]), np.concatenate([a[1], b[1]])
            joint.append(both)
            saved.append(cost(*a) + cost(*b) - cost(*both))
        k = int(np.argmax(saved))
        if saved[k] <= 0:
            break
        groups[k : k + 2] = [joint[k]]
    found = np.empty_like(which)
    for k, (_, cases) in enumerate(groups):
        found[cases] = k
    return np.array([profile for profile, _ in groups]), found
