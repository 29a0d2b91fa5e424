"""Periodic motions and Lyapunov exponents of one slipper."""

from .branch_data import BranchEvent as BranchEvent
from .branches import InterruptedBranch as InterruptedBranch
from .branches import OrbitBranch as OrbitBranch
from .branches import continue_orbit as continue_orbit
from .branches import load_branch as load_branch
from .branches import steps_of_branch as steps_of_branch
from .critical import CriticalOrbit as CriticalOrbit
from .critical import InterruptedCurve as InterruptedCurve
from .critical import OrbitCurve as OrbitCurve
from .critical import continue_event as continue_event
from .critical import critical_orbit as critical_orbit
from .exponents import check_count as check_count
from .exponents import lyapunov_spectrum as lyapunov_spectrum
from .motions import Settled as Settled
from .motions import check_forcing as check_forcing
from .motions import recurs as recurs
from .periodic import DIVISOR as DIVISOR
from .periodic import TOLERANCE as TOLERANCE
from .periodic import PeriodicOrbit as PeriodicOrbit
from .periodic import periodic_orbit as periodic_orbit
from .signature import Signature as Signature
from .signature import Touchdown as Touchdown
