"""Periodic motions and Lyapunov exponents of one slipper."""

from .exponents import check_count as check_count
from .exponents import lyapunov_spectrum as lyapunov_spectrum
from .periodic import PeriodicOrbit as PeriodicOrbit
from .periodic import periodic_orbit as periodic_orbit
from .signature import Signature as Signature
from .signature import Touchdown as Touchdown
