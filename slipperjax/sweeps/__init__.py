"""Many cases: grids, paths with memory, jumps, attractors and Lyapunov exponents over parameters."""

from .attractors import attractors as attractors
from .attractors import groups as groups
from .attractors import strobe_states as strobe_states
from .cases import Cases as Cases
from .executors import ChunkRun as ChunkRun
from .executors import Runs as Runs
from .executors import on_threads as on_threads
from .executors import run_chunk as run_chunk
from .executors import run_chunks as run_chunks
from .exponents import lyapunov_sweep as lyapunov_sweep
from .follow import follow as follow
from .jumps import Jump as Jump
from .jumps import find_jump as find_jump
from .limits import refuse_cases as refuse_cases
from .orbits import orbit_sweep as orbit_sweep
from .plan import Chunk as Chunk
from .plan import OnProgress as OnProgress
from .plan import Plan as Plan
from .plan import make_plan as make_plan
from .repeat import repeat as repeat
from .sweep import sweep as sweep
