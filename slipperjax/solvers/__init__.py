"""diffrax solvers with the event latch built in, and the latch as a wrapper of diffrax's own solvers."""

from .explicit import AbstractLatchingRungeKutta as AbstractLatchingRungeKutta
from .latching import AbstractLatchingSolver as AbstractLatchingSolver
from .named import solver_named as solver_named
from .rosenbrock import AbstractRosenbrock as AbstractRosenbrock
from .simplified_newton import SimplifiedNewton as SimplifiedNewton
