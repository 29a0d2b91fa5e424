"""diffrax solvers of our own."""

from .explicit import RK4 as RK4
from .explicit import AbstractLatchingRungeKutta as AbstractLatchingRungeKutta
from .explicit import Tsit5 as Tsit5
