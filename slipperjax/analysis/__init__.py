"""System-independent analysis: Lyapunov spectra, Floquet multipliers, attractors, spectra, vibration, statistics."""

from .attractor import (
    Attractors as Attractors,
    classify as classify,
    mean_turn as mean_turn,
    rotation_number as rotation_number,
    zero_one_test as zero_one_test,
)
from .basins import Basins as Basins, map_basins as map_basins
from .continuation import Branch as Branch, continue_motion as continue_motion, extend as extend, switch as switch
from .critical import (
    ConditionedMotions as ConditionedMotions,
    CriticalMotion as CriticalMotion,
    CriticalMotions as CriticalMotions,
    continue_critical as continue_critical,
    critical_motion as critical_motion,
)
from .environment import (
    Envelope as Envelope,
    VibrationEnvironment as VibrationEnvironment,
    band_edges as band_edges,
    envelope as envelope,
    resample as resample,
    running_level as running_level,
    shock_response_spectrum as shock_response_spectrum,
    tolerance_factor as tolerance_factor,
    vibration_environment as vibration_environment,
    window_densities as window_densities,
)
from .events import Event as Event
from .floquet import jacobians as jacobians, largest_exponent as largest_exponent, multipliers as multipliers
from .grazing import continue_grazing as continue_grazing, leave_grazing as leave_grazing
from .hybrid import impact_step as impact_step, return_step as return_step, switched_step as switched_step
from .kinds import KINDS as KINDS, REGIMES as REGIMES, Regime as Regime, lasting as lasting
from .leaving import switch_critical as switch_critical
from .lyapunov import (
    LyapunovSpectrum as LyapunovSpectrum,
    dimension_standard_error as dimension_standard_error,
    kaplan_yorke as kaplan_yorke,
    map_spectrum as map_spectrum,
    one_motion_standard_error as one_motion_standard_error,
    pooled_standard_error as pooled_standard_error,
    regime as regime,
    standard_error as standard_error,
    weighted_mean as weighted_mean,
)
from .newton import AbstractEquations as AbstractEquations
from .normal_forms import normal_form as normal_form
from .ode import ode_spectrum as ode_spectrum, ode_step as ode_step
from .shocks import Shock as Shock, smallest_shock as smallest_shock
from .shooting import (
    PeriodicMotions as PeriodicMotions,
    Shot as Shot,
    minimal_period as minimal_period,
    shoot as shoot,
)
from .specification import rms_of_lines as rms_of_lines, straight_lines as straight_lines
from .spectra import find_line as find_line, power_spectral_density as power_spectral_density
from .step_error import with_step_error as with_step_error
from .tori import Tori as Tori, continue_torus as continue_torus
