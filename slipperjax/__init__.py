"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import importlib as _importlib
import importlib.metadata as _metadata
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

import jax as _jax

from .tools import loops_in_one_kernel as _loops_in_one_kernel

_jax.config.update("jax_enable_x64", True)
_loops_in_one_kernel()

from .flow import Interrupted as Interrupted  # noqa: E402
from .flow import Status as Status  # noqa: E402
from .flow import Trajectory as Trajectory  # noqa: E402
from .flow import load_scene as load_scene  # noqa: E402
from .flow import load_start as load_start  # noqa: E402
from .flow import period_map as period_map  # noqa: E402
from .flow import simulate as simulate  # noqa: E402
from .model import PARAMETERS as PARAMETERS  # noqa: E402
from .model import AbstractContactLaw as AbstractContactLaw  # noqa: E402
from .model import AbstractMemory as AbstractMemory  # noqa: E402
from .model import AbstractTrack as AbstractTrack  # noqa: E402
from .model import Args as Args  # noqa: E402
from .model import ConstantDamping as ConstantDamping  # noqa: E402
from .model import EventLatch as EventLatch  # noqa: E402
from .model import Flores as Flores  # noqa: E402
from .model import HarmonicTrack as HarmonicTrack  # noqa: E402
from .model import HertzSpring as HertzSpring  # noqa: E402
from .model import HuntCrossley as HuntCrossley  # noqa: E402
from .model import Irregularity as Irregularity  # noqa: E402
from .model import LankaraniNikravesh as LankaraniNikravesh  # noqa: E402
from .model import Motion as Motion  # noqa: E402
from .model import Reactions as Reactions  # noqa: E402
from .model import Scene as Scene  # noqa: E402
from .model import Section as Section  # noqa: E402
from .model import Slipper as Slipper  # noqa: E402
from .model import SmoothSwitch as SmoothSwitch  # noqa: E402
from .model import State as State  # noqa: E402
from .model import StraightTrack as StraightTrack  # noqa: E402
from .model import contact_duration as contact_duration  # noqa: E402
from .model import default_steps_per_period as default_steps_per_period  # noqa: E402
from .model import initial_state as initial_state  # noqa: E402
from .model import paper_scene as paper_scene  # noqa: E402
from .model import paper_section as paper_section  # noqa: E402
from .model import reactions as reactions  # noqa: E402
from .model import table_2_start as table_2_start  # noqa: E402
from .model import vector_field as vector_field  # noqa: E402
from .solvers import RK4 as RK4  # noqa: E402
from .solvers import ROS34PW2 as ROS34PW2  # noqa: E402
from .solvers import AdaptiveSteps as AdaptiveSteps  # noqa: E402
from .solvers import Latching as Latching  # noqa: E402
from .solvers import Rodas3 as Rodas3  # noqa: E402
from .solvers import Rodas4 as Rodas4  # noqa: E402
from .solvers import Tsit5 as Tsit5  # noqa: E402
from .solvers import TwoStep as TwoStep  # noqa: E402
from .solvers import choose_solver as choose_solver  # noqa: E402
from .tools import ImplausibleWarning as ImplausibleWarning  # noqa: E402
from .tools import compile_cache as compile_cache  # noqa: E402
from .tools import jit as jit  # noqa: E402

if _TYPE_CHECKING:
    from .design import optimise_design as optimise_design
    from .orbits import OrbitBranch as OrbitBranch
    from .orbits import PeriodicOrbit as PeriodicOrbit
    from .orbits import continue_orbit as continue_orbit
    from .orbits import load_branch as load_branch
    from .orbits import lyapunov_spectrum as lyapunov_spectrum
    from .orbits import periodic_orbit as periodic_orbit
    from .sweeps import Store as Store
    from .sweeps import explain as explain
    from .sweeps import follow as follow
    from .sweeps import lyapunov_sweep as lyapunov_sweep
    from .sweeps import open_store as open_store
    from .sweeps import orbit_sweep as orbit_sweep
    from .sweeps import processes as processes
    from .sweeps import refined as refined
    from .sweeps import repeat as repeat
    from .sweeps import sample_box as sample_box
    from .sweeps import sweep as sweep

_ROOMS = (
    "analysis",
    "bench",
    "cli",
    "design",
    "flow",
    "model",
    "orbits",
    "plots",
    "solvers",
    "studies",
    "sweeps",
    "tools",
)
_LATER = {
    "optimise_design": "design",
    "OrbitBranch": "orbits",
    "PeriodicOrbit": "orbits",
    "continue_orbit": "orbits",
    "load_branch": "orbits",
    "lyapunov_spectrum": "orbits",
    "periodic_orbit": "orbits",
    "Store": "sweeps",
    "explain": "sweeps",
    "follow": "sweeps",
    "lyapunov_sweep": "sweeps",
    "open_store": "sweeps",
    "orbit_sweep": "sweeps",
    "processes": "sweeps",
    "refined": "sweeps",
    "repeat": "sweeps",
    "sample_box": "sweeps",
    "sweep": "sweeps",
}
"""Names of rooms that are imported at their first use, as those above that only a type checker sees."""


def __getattr__(name: str) -> _Any:
    # rooms that nothing above needs, such as `slipperjax.plots` with matplotlib, are imported at their first use
    if name in _ROOMS:
        return _importlib.import_module(f".{name}", __name__)
    if name in _LATER:
        return getattr(_importlib.import_module(f".{_LATER[name]}", __name__), name)
    if name == "__version__":
        return _metadata.version("slipperjax")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_ROOMS, *_LATER, "__version__"})
