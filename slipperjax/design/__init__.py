"""Design: objectives, their sensitivities, and parameters chosen by them."""

from .checks import event_margins as event_margins
from .checks import surroundings as surroundings
from .ensembles import EnsembleSettings as EnsembleSettings
from .ensembles import RailEnsemble as RailEnsemble
from .methods import AbstractMethod as AbstractMethod
from .methods import Descent as Descent
from .methods import TrustRegion as TrustRegion
from .objectives import OBJECTIVES as OBJECTIVES
from .optimise import Design as Design
from .sensitivities import sensitivities as sensitivities
