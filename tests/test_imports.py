"""Importing the package takes no more than JAX and diffrax; everything else is imported where it is used."""

import ast
import subprocess
import sys
from pathlib import Path

import slipperjax as sj

HEAVY = ("xarray", "pandas", "scipy.signal", "scipy.stats", "scipy.optimize", "scipy.sparse", "matplotlib", "tqdm")
HEAVY += ("h5netcdf", "h5py", "optax", "pint")
PROGRAM = f"""
import sys
import slipperjax as sj
import slipperjax.cli
print([name for name in {HEAVY!r} if name in sys.modules])
print(callable(sj.sweep), "xarray" in sys.modules)
from slipperjax import continue_orbit
"""


def test_importing_is_light():
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout
    assert found.splitlines() == ["[]", "True True"]


def test_later_names_are_those_that_a_type_checker_sees():
    tree = ast.parse(Path(sj.__file__).read_text())
    seen = {}
    for block in (node for node in tree.body if isinstance(node, ast.If)):
        for node in block.body:
            assert isinstance(node, ast.ImportFrom)
            seen |= {alias.name: node.module for alias in node.names}
    assert seen == sj._LATER
    assert set(seen) <= set(dir(sj))
    for name in seen:
        assert getattr(sj, name).__name__ == name
