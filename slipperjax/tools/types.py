"""Names for the kinds of arguments and results, for annotations."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array

Real = float | Array
"""A real number, which may be traced."""
AnyArray = Array | np.ndarray
"""An array of JAX or NumPy."""
Whole = int | Array
"""A whole number, which may be traced."""
Numbers = Sequence[float] | np.ndarray | Array
"""Several numbers: a list, or an array of any kind."""
