"""Many cases: grids, paths with memory, jumps, attractors and Lyapunov exponents over parameters."""

from .attractors import attractors as attractors, groups as groups, strobe_states as strobe_states
from .compare import on_rails as on_rails, over_rails as over_rails
from .explain import Estimate as Estimate
from .exponents import LyapunovExponents as LyapunovExponents
from .follow import Jump as Jump, find_jump as find_jump
from .grid import sample_box as sample_box
from .loads import loads as loads
from .orbits import NearestOrbit as NearestOrbit
from .plan import AbstractStage as AbstractStage
from .records import LargestExponent as LargestExponent, MotionKind as MotionKind
from .store import (
    Store as Store,
    StoreInUse as StoreInUse,
    StoreStatus as StoreStatus,
    WorkerLost as WorkerLost,
    check_store as check_store,
    processes as processes,
    store_status as store_status,
)
from .windows import AccelerationHistory as AccelerationHistory, LoadHistory as LoadHistory, whole_run as whole_run
