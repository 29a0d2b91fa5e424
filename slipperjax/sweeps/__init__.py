"""Many cases: grids, paths with memory, jumps, attractors and Lyapunov exponents over parameters."""

from .attractors import attractors as attractors
from .attractors import groups as groups
from .attractors import strobe_states as strobe_states
from .explain import Estimate as Estimate
from .exponents import LyapunovExponents as LyapunovExponents
from .follow import Jump as Jump
from .follow import find_jump as find_jump
from .orbits import NearestOrbit as NearestOrbit
from .over_rails import over_rails as over_rails
from .plan import AbstractStage as AbstractStage
from .records import LargestExponent as LargestExponent
from .records import MotionKind as MotionKind
from .store import StoreInUse as StoreInUse
from .store import StoreStatus as StoreStatus
from .store import WorkerLost as WorkerLost
from .store import check_store as check_store
from .store import store_status as store_status
