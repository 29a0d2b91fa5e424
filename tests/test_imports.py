"""Importing the package takes no more than JAX and diffrax; everything else is imported where it is used."""

import subprocess
import sys

HEAVY = ("xarray", "pandas", "scipy.signal", "scipy.stats", "scipy.optimize", "scipy.sparse", "matplotlib", "tqdm")
HEAVY += ("h5netcdf", "h5py", "optax", "pint")
PROGRAM = f"""
import sys
import slipperjax as sj
import slipperjax.cli
sj.simulate
print([name for name in {HEAVY!r} if name in sys.modules])
print(callable(sj.sweep), "xarray" in sys.modules, set(sj.__all__) <= set(dir(sj)))
from slipperjax import continue_orbit
"""


def test_importing_is_light():
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout
    assert found.splitlines() == ["[]", "True True True"]
