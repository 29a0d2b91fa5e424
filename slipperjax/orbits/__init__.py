"""Events of branches of periodic orbits, critical orbits and their curves over two parameters, contact signatures."""

from .branches import BranchEvent as BranchEvent
from .critical import OrbitCurve as OrbitCurve
from .critical import continue_event as continue_event
from .critical import critical_orbit as critical_orbit
from .critical import event_sensitivities as event_sensitivities
from .signature import Signature as Signature
from .signature import Touchdown as Touchdown
