"""Long-time behaviour of one slipper: Lyapunov exponents."""

from .exponents import check_count as check_count
from .exponents import lyapunov_spectrum as lyapunov_spectrum
