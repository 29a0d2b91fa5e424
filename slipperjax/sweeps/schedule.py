"""Schedules: the spans of forcing periods with equal steps through which a batch of cases passes."""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from .grid import batch_size

FEW = 10
"""Capacity of programs that record no more forcing periods, with shorter arrays."""

STEP_IN_LANES = 2
"""Number of cases whose time equals the constant part of a step's time: measured with 8 to 128 cases."""


class Span(NamedTuple):
    """Successive forcing periods with equal steps."""

    periods: int
    steps: int
    """Integration steps in each period."""
    recorded: bool = True
    """Whether all records sample these periods; otherwise only records that sample a run from its start."""
    probed: int = 0
    """Periods from the span's start that are repeated with half the step, to measure the error; 0 for none."""


@dataclass(frozen=True)
class Schedule:
    """Successive stretches of spans. Cases of one schedule run as one batch."""

    stretches: tuple[tuple[Span, ...], ...]
    """Records are finished at the end of each stretch, and begin again after it."""

    @classmethod
    def of(cls, settled: int, recorded: int, steps: int, probed: int = 0) -> "Schedule":
        """Return a transient without records, and a recorded span, with equal steps.

        **Arguments:** `probed`: periods of the recorded span that are repeated with half the step.
        """
        return cls(((Span(settled, steps, recorded=False), Span(recorded, steps, probed=probed)),))

    @classmethod
    def of_profile(
        cls, profile: Int[np.ndarray, " periods"], stretch: int, probed: Collection[int], length: int
    ) -> "Schedule":
        """Return recorded stretches from the integration steps in each forcing period.

        **Arguments:** `stretch`: periods in each stretch; `probed`: the stretches at whose start `length` periods are
        repeated with half the step.
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
        """Forcing periods before the recorded periods."""
        return sum(span.periods for span in self.spans if not span.recorded)

    @property
    def recorded(self) -> int:
        """Recorded forcing periods."""
        return sum(span.periods for span in self.spans if span.recorded)

    @property
    def periods(self) -> int:
        """Total number of forcing periods."""
        return self.settled + self.recorded

    @property
    def steps(self) -> int:
        """The greatest number of integration steps in a forcing period."""
        return max(span.steps for span in self.spans)

    @property
    def work(self) -> int:
        """Total number of integration steps."""
        return sum(span.periods * span.steps for span in self.spans)

    @property
    def profile(self) -> list[int]:
        """Integration steps in each forcing period."""
        return [span.steps for span in self.spans for _ in range(span.periods)]

    @property
    def mean_steps(self) -> float:
        """Mean integration steps of its forcing periods."""
        return self.work / max(self.periods, 1)


def probed(spans: Sequence[Span]) -> list[tuple[int, int]]:
    """Return steps and number of the periods that the first of some successive spans repeats with half the step; the
    last span continues at the end."""
    left = spans[0].probed
    parts = []
    for span in spans:
        parts.append((span.steps, min(span.periods, left)))
        left -= parts[-1][1]
    return [*parts, (spans[-1].steps, left)]


def shared_capacity(most: int, steps: int) -> int:
    """Return the capacity of a recording program for steps: the least `most` / 8^k that is at least `steps`.

    Cases share one program unless their steps differ by more than a factor of 8.
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
    # time of a batch, in steps of one case
    cost = lambda profile, cases: int(profile.sum()) * (STEP_IN_LANES + batch_size(len(cases)))
    order = np.argsort(profiles.sum(axis=1), kind="stable")
    groups = [(profiles[k], np.flatnonzero(which == k)) for k in order]
    # each step joins the two neighbours that save most time
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
