"""Pictures: trajectories, bifurcations, branches, exponents, regime maps, designs, sections and animations."""

from .branches import branches as branches
from .branches import event_curves as event_curves
from .branches import multiplier_circle as multiplier_circle
from .designs import design_margins as design_margins
from .designs import design_overview as design_overview
from .maps import attractor_map as attractor_map
from .maps import basin_map as basin_map
from .maps import bifurcation as bifurcation
from .maps import bifurcations as bifurcations
from .maps import exponents as exponents
from .maps import quantity_map as quantity_map
from .maps import regime_map as regime_map
from .picture import plot as plot
from .rails import rail as rail
from .runs import passing as passing
from .runs import run_overview as run_overview
from .sections import animate as animate
from .sections import instant as instant
from .sections import section as section
from .style import styled as styled
from .trajectories import contact_forces as contact_forces
from .trajectories import history as history
from .trajectories import overview as overview
from .trajectories import phase_portrait as phase_portrait
from .trajectories import spectrum as spectrum
