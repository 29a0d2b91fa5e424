"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import jax as _jax

_jax.config.update("jax_enable_x64", True)

from .compilation import jit as jit  # noqa: E402
from .contact import ConstantDamping as ConstantDamping  # noqa: E402
from .contact import EventLatch as EventLatch  # noqa: E402
from .contact import Flores as Flores  # noqa: E402
from .contact import HertzSpring as HertzSpring  # noqa: E402
from .contact import HuntCrossley as HuntCrossley  # noqa: E402
from .contact import LankaraniNikravesh as LankaraniNikravesh  # noqa: E402
from .contact import SmoothSwitch as SmoothSwitch  # noqa: E402
from .dynamics import Args as Args  # noqa: E402
from .dynamics import Reactions as Reactions  # noqa: E402
from .dynamics import State as State  # noqa: E402
from .dynamics import initial_state as initial_state  # noqa: E402
from .dynamics import reactions as reactions  # noqa: E402
from .dynamics import vector_field as vector_field  # noqa: E402
from .kinematics import Motion as Motion  # noqa: E402
from .kinematics import table_2_start as table_2_start  # noqa: E402
from .scene import PARAMETERS as PARAMETERS  # noqa: E402
from .scene import Scene as Scene  # noqa: E402
from .scene import Slipper as Slipper  # noqa: E402
from .scene import contact_duration as contact_duration  # noqa: E402
from .scene import default_steps_per_period as default_steps_per_period  # noqa: E402
from .scene import paper_scene as paper_scene  # noqa: E402
from .section import Section as Section  # noqa: E402
from .section import paper_section as paper_section  # noqa: E402
from .simulate import Trajectory as Trajectory  # noqa: E402
from .simulate import period_map as period_map  # noqa: E402
from .simulate import simulate as simulate  # noqa: E402
from .solvers import RK4 as RK4  # noqa: E402
from .solvers import ROS34PW2 as ROS34PW2  # noqa: E402
from .solvers import AdaptiveSteps as AdaptiveSteps  # noqa: E402
from .solvers import Latching as Latching  # noqa: E402
from .solvers import Rodas3 as Rodas3  # noqa: E402
from .solvers import Rodas4 as Rodas4  # noqa: E402
from .solvers import Tsit5 as Tsit5  # noqa: E402
from .solvers import TwoStep as TwoStep  # noqa: E402
from .solvers import choose_solver as choose_solver  # noqa: E402
from .spectra import lyapunov_spectrum as lyapunov_spectrum  # noqa: E402
from .spectra import lyapunov_sweep as lyapunov_sweep  # noqa: E402
from .sweep import follow as follow  # noqa: E402
from .sweep import sweep as sweep  # noqa: E402
from .track import AbstractTrack as AbstractTrack  # noqa: E402
from .track import HarmonicTrack as HarmonicTrack  # noqa: E402
from .track import StraightTrack as StraightTrack  # noqa: E402
