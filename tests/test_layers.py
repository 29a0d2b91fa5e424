"""Imports point one way, and plotting and files stay out of the floors below."""

import ast
from pathlib import Path

import slipperjax

ROOT = Path(slipperjax.__file__).parent
FLOORS = [
    {"checks", "compilation", "reduction"},
    {"section", "track", "contact"},
    {"scene"},
    {"kinematics"},
    {"jacobian"},
    {"dynamics"},
    {"solvers"},
    {"simulate", "analysis"},
    {"labels", "claims"},
    {"batch"},
    {"records"},
    {"sweep"},
    {"branches"},
    {"spectra"},
    {"answers"},
    {"paper"},
    {"plots"},
    {"figures"},
    {"peers", "work_precision"},
    {"bench"},
    {"cli"},
]
UPPER = {
    "labels",
    "batch",
    "records",
    "sweep",
    "branches",
    "spectra",
    "answers",
    "paper",
    "figures",
    "plots",
    "peers",
    "work_precision",
    "bench",
    "cli",
}
HEAVY = {"xarray", "matplotlib", "tqdm", "typer", "h5netcdf"}


def floor_of(name):
    return next(k for k, names in enumerate(FLOORS) if name in names)


def imports(path):
    """Module names imported at the top of a file: (of this package, from outside)."""
    ours, others = set(), set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            if node.level:
                up = path.parent if node.level == 1 else path.parent.parent
                if up == ROOT:
                    ours |= {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
            elif node.module:
                others.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            others |= {alias.name.split(".")[0] for alias in node.names}
    return ours, others


def test_imports_point_upward_only():
    for path in ROOT.rglob("*.py"):
        name = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if name == "__init__":
            continue
        ours, others = imports(path)
        for other in ours:
            assert floor_of(other) <= floor_of(name), f"{path.name} imports {other}"
        if name not in UPPER:
            assert not others & HEAVY, f"{path.name} imports {others & HEAVY}"


def test_modules_stay_small():
    for path in ROOT.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path
