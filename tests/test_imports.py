"""Importing the package takes no more than JAX and diffrax; and names in texts lead somewhere."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import slipperjax

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


def leads_somewhere(name: str) -> bool:
    """Whether a dotted name is that of a module, or of something in one, down to a field of a class."""
    parts, found = name.split("."), slipperjax
    for k, part in enumerate(parts[1:], 2):
        if not hasattr(found, part) and part in getattr(found, "__annotations__", {}):
            return True
        try:
            found = getattr(found, part) if hasattr(found, part) else importlib.import_module(".".join(parts[:k]))
        except ImportError:
            return False
    return True


def test_names_in_texts_lead_somewhere():
    root = Path(slipperjax.__file__).parent
    texts = [*root.rglob("*.py"), *(root.parent / "docs").rglob("*.md"), *root.parent.glob("*.md")]
    named = {(file.name, name) for file in texts for name in re.findall(r"`(slipperjax(?:\.\w+)+)", file.read_text())}
    assert len(named) > 50
    assert [(file, name) for file, name in sorted(named) if not leads_somewhere(name)] == []
