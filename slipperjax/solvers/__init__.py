"""diffrax solvers with the event latch built in, and the latch as a wrapper of diffrax's own solvers."""

from .adaptive import AdaptiveSteps as AdaptiveSteps
from .choose import Choice as Choice
from .choose import check_error_estimate as check_error_estimate
from .choose import choose_solver as choose_solver
from .choose import resolve_controller as resolve_controller
from .choose import resolve_solver as resolve_solver
from .choose import solver_named as solver_named
from .explicit import RK4 as RK4
from .explicit import AbstractLatchingRungeKutta as AbstractLatchingRungeKutta
from .explicit import Tsit5 as Tsit5
from .latching import AbstractLatchingSolver as AbstractLatchingSolver
from .latching import Latching as Latching
from .latching import calls_lapack as calls_lapack
from .latching import differentiable as differentiable
from .latching import estimates_error as estimates_error
from .latching import is_explicit as is_explicit
from .latching import solver_name as solver_name
from .rosenbrock import ROS34PW2 as ROS34PW2
from .rosenbrock import AbstractRosenbrock as AbstractRosenbrock
from .rosenbrock import Rodas3 as Rodas3
from .rosenbrock import Rodas4 as Rodas4
from .simplified_newton import SimplifiedNewton as SimplifiedNewton
from .simplified_newton import with_root_finder as with_root_finder
from .twostep import TwoStep as TwoStep
from .twostep import two_step_weights as two_step_weights
