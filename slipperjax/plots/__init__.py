"""Pictures: trajectories, bifurcations, branches, exponents, regime maps, designs, sections, sleds,
environments and animations."""

from .bending import animate_bending as animate_bending, bending as bending
from .branches import branches as branches, multiplier_circle as multiplier_circle, plane as plane
from .comparisons import comparison as comparison
from .designs import design_margins as design_margins, design_overview as design_overview
from .environment import vibration as vibration
from .fits import fit_overview as fit_overview
from .loads import greatest_loads as greatest_loads
from .maps import (
    attractor_map as attractor_map,
    basin_map as basin_map,
    basin_shares as basin_shares,
    bifurcation as bifurcation,
    bifurcations as bifurcations,
    exponents as exponents,
    quantity_map as quantity_map,
    regime_map as regime_map,
)
from .rails import rail as rail
from .runs import passing as passing, run_overview as run_overview
from .sections import animate as animate, instant as instant, section as section
from .sleds import load_sharing as load_sharing, plan as plan
from .style import styled as styled
from .telemetry import record_over_model as record_over_model
from .trajectories import (
    contact_forces as contact_forces,
    history as history,
    overview as overview,
    phase_portrait as phase_portrait,
    spectrum as spectrum,
)
