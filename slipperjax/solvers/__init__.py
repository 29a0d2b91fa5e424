"""diffrax solvers with the event latch built in, and the latch as a wrapper of diffrax's own solvers."""

from .adaptive import AdaptiveSteps as AdaptiveSteps
from .explicit import RK4 as RK4, AbstractLatchingRungeKutta as AbstractLatchingRungeKutta, Tsit5 as Tsit5
from .impulse import ImpulseRK4 as ImpulseRK4
from .latching import AbstractLatchingSolver as AbstractLatchingSolver, Latching as Latching
from .named import solver_named as solver_named
from .rosenbrock import ROS34PW2 as ROS34PW2, AbstractRosenbrock as AbstractRosenbrock, Rodas4 as Rodas4
from .simplified_newton import SimplifiedNewton as SimplifiedNewton
from .twostep import TwoStep as TwoStep
