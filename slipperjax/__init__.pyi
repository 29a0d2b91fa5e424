"""Public names of the top level; each stands in the module that is named here, and is imported at its first use."""

from . import (
    analysis as analysis,
    cli as cli,
    design as design,
    explorer as explorer,
    fitting as fitting,
    flow as flow,
    model as model,
    orbits as orbits,
    plots as plots,
    results as results,
    solvers as solvers,
    studies as studies,
    sweeps as sweeps,
    tools as tools,
)
from .design.optimise import optimise_design as optimise_design
from .explorer.launch import explore as explore
from .fitting.fit import fit as fit
from .flow.status import Interrupted as Interrupted, Status as Status
from .model.beam import Beam as Beam
from .model.dang2024 import paper_scene as paper_scene, table_2_start as table_2_start
from .model.dynamics import State as State
from .model.kinematics import Motion as Motion
from .model.parameters import PARAMETERS as PARAMETERS
from .model.random_rails import RandomTrack as RandomTrack
from .model.scene import Scene as Scene
from .model.section import Section as Section
from .model.sled import Mount as Mount, Sled as Sled
from .model.slipper import Slipper as Slipper
from .model.starts import AtRest as AtRest, initial_state as initial_state
from .model.surveys import load_rail as load_rail
from .model.tracks import HarmonicTrack as HarmonicTrack
from .model.travel import SpeedProgramme as SpeedProgramme, Stage as Stage
from .orbits.branches import continue_orbit as continue_orbit
from .orbits.exponents import lyapunov_spectrum as lyapunov_spectrum
from .orbits.periodic import periodic_orbit as periodic_orbit
from .orbits.simulate import period_map as period_map, simulate as simulate
from .results.result import Result as Result
from .sweeps.basins import basins as basins
from .sweeps.compare import compare as compare
from .sweeps.environment import environment as environment
from .sweeps.explain import explain as explain
from .sweeps.follow import follow as follow
from .sweeps.loading import load as load
from .sweeps.runs import run as run
from .sweeps.sweep import lyapunov_sweep as lyapunov_sweep, orbit_sweep as orbit_sweep, sweep as sweep
from .tools.cache import compile_cache as compile_cache
from .tools.checks import ImplausibleWarning as ImplausibleWarning
from .tools.compile import jit as jit

__version__: str
