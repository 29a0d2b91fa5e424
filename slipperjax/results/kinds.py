"""The kinds of results, by the functions that make them."""

import xarray as xr

from ..flow.datasets import function_of
from ..tools.checks import require
from .branches import BranchKind, CurveKind, OwnBranchKind
from .comparisons import ComparisonKind
from .designs import DesignKind
from .environments import EnvironmentKind
from .fits import FitKind
from .kind import Kind
from .loads import LoadsKind
from .motions import MotionKind, OrbitKind
from .runs import RunKind
from .sweeps import SweepKind

KINDS: dict[str, Kind] = {
    "simulate": MotionKind(),
    "periodic_orbit": OrbitKind(),
    "continue_orbit": BranchKind(),
    "continue_event": CurveKind(),
    "continue_motion": OwnBranchKind(),
    "sweep": SweepKind(),
    "follow": SweepKind(),
    "run": RunKind(),
    "compare": ComparisonKind(),
    "environment": EnvironmentKind(),
    "loads": LoadsKind(),
    "optimise_design": DesignKind(),
    "fit": FitKind(),
}


def kind_of(ds: xr.Dataset) -> Kind:
    """Return the kind of a result.

    **Raises:** `ValueError` for a dataset that no function of slipperjax made.
    """
    function = function_of(ds)
    require(function in KINDS, "result", f"be of one of {', '.join(KINDS)}", function)
    return KINDS[function]
