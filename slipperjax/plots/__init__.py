"""Pictures: trajectories, bifurcation diagrams, Lyapunov exponents, regime maps, sections and animations."""

from .animations import animate as animate
from .animations import instant as instant
from .bifurcations import bifurcation as bifurcation
from .bifurcations import bifurcations as bifurcations
from .files import png as png
from .regimes import exponents as exponents
from .regimes import regime_map as regime_map
from .sections import section as section
from .style import COLORS as COLORS
from .style import POINT_COLORS as POINT_COLORS
from .style import REGIME_COLORS as REGIME_COLORS
from .style import STYLE as STYLE
from .style import axis_label as axis_label
from .style import shown as shown
from .style import styled as styled
from .style import typeset as typeset
from .titles import case_title as case_title
from .trajectories import contact_forces as contact_forces
from .trajectories import highest_forces as highest_forces
from .trajectories import history as history
from .trajectories import overview as overview
from .trajectories import phase_portrait as phase_portrait
from .trajectories import spectrum as spectrum
