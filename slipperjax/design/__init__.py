"""Design: objectives, their sensitivities, and parameters chosen by them."""

from .checks import event_margins as event_margins, surroundings as surroundings
from .ensembles import EnsembleSettings as EnsembleSettings, RailEnsemble as RailEnsemble
from .methods import AbstractMethod as AbstractMethod, Descent as Descent, TrustRegion as TrustRegion
from .objectives import OBJECTIVES as OBJECTIVES
from .optimise import Design as Design
from .sensitivities import OrbitSensitivities as OrbitSensitivities, sensitivities as sensitivities
