"""Public names of the top level; each stands in the module that is named here, and is imported at its first use."""

from . import (
    analysis as analysis,
    bench as bench,
    cli as cli,
    design as design,
    explorer as explorer,
    fitting as fitting,
    flow as flow,
    model as model,
    orbits as orbits,
    plots as plots,
    solvers as solvers,
    studies as studies,
    sweeps as sweeps,
    tools as tools,
)
from .design.optimise import optimise_design as optimise_design
from .explorer.launch import explore as explore
from .fitting.fit import fit as fit
from .flow.datasets import (
    load_environment as load_environment,
    load_run as load_run,
    load_scene as load_scene,
    load_sensors as load_sensors,
    load_start as load_start,
)
from .flow.simulate import Trajectory as Trajectory, period_map as period_map, simulate as simulate
from .flow.status import Interrupted as Interrupted, Status as Status
from .model.contact import (
    AbstractContactLaw as AbstractContactLaw,
    AbstractIntegratedMemory as AbstractIntegratedMemory,
    AbstractMemory as AbstractMemory,
    ConstantDamping as ConstantDamping,
    EventLatch as EventLatch,
    Flores as Flores,
    HertzSpring as HertzSpring,
    HuntCrossley as HuntCrossley,
    LankaraniNikravesh as LankaraniNikravesh,
    PeakRateLatch as PeakRateLatch,
    SmoothSwitch as SmoothSwitch,
)
from .model.dang2024 import paper_scene as paper_scene, paper_section as paper_section, table_2_start as table_2_start
from .model.dynamics import (
    Args as Args,
    Reactions as Reactions,
    State as State,
    reactions as reactions,
    vector_field as vector_field,
)
from .model.kinematics import ModalMotion as ModalMotion, Motion as Motion, SledMotion as SledMotion
from .model.loads import (
    AbstractFriction as AbstractFriction,
    AbstractLoad as AbstractLoad,
    AerodynamicLoad as AerodynamicLoad,
    AppliedLoad as AppliedLoad,
    Coulomb as Coulomb,
    FadingFriction as FadingFriction,
    SumLoad as SumLoad,
    TabulatedLoad as TabulatedLoad,
)
from .model.modes import Modes as Modes, load_modes as load_modes
from .model.parameters import PARAMETERS as PARAMETERS
from .model.payload import SledMass as SledMass
from .model.rails import SampledTrack as SampledTrack, TrackSet as TrackSet
from .model.random_rails import RandomRails as RandomRails, RandomTrack as RandomTrack
from .model.scene import Scene as Scene
from .model.section import Section as Section
from .model.sensors import Sensor as Sensor
from .model.sled import Mount as Mount, Sled as Sled
from .model.slipper import Slipper as Slipper
from .model.starts import AtRest as AtRest, initial_state as initial_state
from .model.step_size import (
    contact_duration as contact_duration,
    default_steps_per_period as default_steps_per_period,
)
from .model.surveys import load_rail as load_rail, load_speed as load_speed
from .model.thrust import RocketSled as RocketSled, WaterBrake as WaterBrake
from .model.tracks import (
    AbstractTrack as AbstractTrack,
    FourierTrack as FourierTrack,
    HarmonicTrack as HarmonicTrack,
    Irregularity as Irregularity,
    LocalTrack as LocalTrack,
    StraightTrack as StraightTrack,
    SumTrack as SumTrack,
    TwoRails as TwoRails,
)
from .model.travel import SpeedProgramme as SpeedProgramme, Stage as Stage
from .model.wear import AbstractWear as AbstractWear, Wear as Wear, WearTable as WearTable
from .orbits.branches import OrbitBranch as OrbitBranch, continue_orbit as continue_orbit, load_branch as load_branch
from .orbits.exponents import lyapunov_spectrum as lyapunov_spectrum
from .orbits.periodic import PeriodicOrbit as PeriodicOrbit, periodic_orbit as periodic_orbit
from .solvers.adaptive import AdaptiveSteps as AdaptiveSteps
from .solvers.explicit import RK4 as RK4, Tsit5 as Tsit5
from .solvers.impulse import ImpulseRK4 as ImpulseRK4
from .solvers.latching import Latching as Latching
from .solvers.rosenbrock import ROS34PW2 as ROS34PW2, Rodas4 as Rodas4
from .solvers.twostep import TwoStep as TwoStep
from .sweeps.compare import compare as compare
from .sweeps.environment import environment as environment
from .sweeps.explain import explain as explain
from .sweeps.follow import follow as follow
from .sweeps.grid import sample_box as sample_box
from .sweeps.runs import run as run
from .sweeps.store import Store as Store, open_store as open_store, processes as processes
from .sweeps.sweep import lyapunov_sweep as lyapunov_sweep, orbit_sweep as orbit_sweep, sweep as sweep
from .tools.cache import compile_cache as compile_cache
from .tools.checks import ImplausibleWarning as ImplausibleWarning
from .tools.compile import jit as jit

__version__: str
