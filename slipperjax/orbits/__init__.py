"""Events of branches of periodic orbits, critical orbits and their curves over two parameters, signatures, shocks."""

from .branches import BranchEvent as BranchEvent, OrbitBranch as OrbitBranch
from .critical import (
    CurvePoint as CurvePoint,
    OrbitCurve as OrbitCurve,
    continue_event as continue_event,
    critical_orbit as critical_orbit,
    event_sensitivities as event_sensitivities,
    orbit_form as orbit_form,
)
from .own_branches import branch_result as branch_result
from .periodic import PeriodicOrbit as PeriodicOrbit
from .shocks import orbit_shock as orbit_shock
from .signature import Signature as Signature, Touchdown as Touchdown
from .simulate import Peak as Peak, Probe as Probe, Trajectory as Trajectory
