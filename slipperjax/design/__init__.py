"""Design: objectives, their sensitivities, and parameters chosen by them."""

from .checks import event_margins as event_margins
from .checks import surroundings as surroundings
from .ensembles import Spread as Spread
from .maps import objective_sweep as objective_sweep
from .methods import AbstractMethod as AbstractMethod
from .methods import Descent as Descent
from .methods import TrustRegion as TrustRegion
from .objectives import OBJECTIVES as OBJECTIVES
from .objectives import AbstractCourseObjective as AbstractCourseObjective
from .objectives import AbstractObjective as AbstractObjective
from .objectives import ContactLoad as ContactLoad
from .objectives import ContactWork as ContactWork
from .objectives import DriveForce as DriveForce
from .objectives import Excursion as Excursion
from .objectives import Exponent as Exponent
from .objectives import Functional as Functional
from .objectives import GrazingDistance as GrazingDistance
from .objectives import ImpactImpulse as ImpactImpulse
from .objectives import PeakForce as PeakForce
from .objectives import RMSAcceleration as RMSAcceleration
from .objectives import SoftExcursion as SoftExcursion
from .objectives import SoftImpactImpulse as SoftImpactImpulse
from .objectives import SoftPeakForce as SoftPeakForce
from .optimise import Design as Design
from .pareto import pareto_front as pareto_front
from .sensitivities import sensitivities as sensitivities
