"""Arguments of a sweep as one frozen object, kept with its results and compared before a store continues."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from diffrax import AbstractSolver

from ..tools.checks import require, whole


@dataclass(frozen=True, kw_only=True)
class AbstractCall:
    """Arguments that sweeps and runs have in common, in the form that a user gives."""

    record: object = ()
    steps_per_period: int | Sequence[int] | np.ndarray | None = None
    refine: int = 1
    """Factor of the default steps [1]."""
    solver: AbstractSolver | str | None = None
    product: bool = True
    """Whether the grid is a product of its axes; False: one case for each place in the lists."""
    function: str = "sweep"
    """Name of the function that was called."""

    def __post_init__(self):
        refined(self.refine, self.steps_per_period)


@dataclass(frozen=True)
class Call(AbstractCall):
    """Lengths, records and numerics of a sweep in the form that a user gives, see `slipperjax.sweep`."""

    settled: int
    """Forcing periods before the measurement."""
    measured: int
    """Forcing periods that are recorded, or over which exponents are measured."""
    saves_per_period: int | None = None
    begin: float | None = None
    """Place where the run begins [m]; None for the beginning of its rail."""
    loads: bool | None = None
    probe: bool | None = None

    def __post_init__(self):
        # errors name the arguments as in `sweep`
        whole("transient", self.settled, 0)
        whole("periods", self.measured, 1)
        super().__post_init__()


def refined(refine: int, steps_per_period: object) -> int:
    """Return the factor of the default steps [1].

    **Raises:** `ValueError` where it is no whole number from 1 to 1000, or is not 1 together with given steps.
    """
    refine = whole("refine", refine, 1, 1000)
    good = refine == 1 or steps_per_period is None
    require(good, "refine", "be 1 where steps_per_period is given", refine)
    return refine
