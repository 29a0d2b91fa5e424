"""The rooms: imports point strictly downward, through each room's `__init__`, anywhere in a file, without cycles."""

import ast
import graphlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import slipperjax

ROOT = Path(slipperjax.__file__).parent
FLOORS = [
    {"tools"},
    {"model", "analysis"},
    {"solvers"},
    {"flow"},
    {"orbits", "plots"},
    {"sweeps"},
    {"studies", "design", "bench"},
    {"cli"},
]
# JAX alone below; these read and write labelled data, pictures and files
HEAVY = {"xarray", "zarr", "matplotlib", "dask", "tqdm", "typer", "h5netcdf", "bokeh"}
MAY_BE_HEAVY = (
    "plots",
    "sweeps",
    "flow.datasets",
    "orbits.branch_data",
    "orbits.branches",
    "orbits.critical",
    "studies",
    "design",
    "bench",
    "cli",
)


def floor_of(room: str) -> int:
    return next(k for k, rooms in enumerate(FLOORS) if room in rooms)


def modules(root: Path) -> dict[str, Path]:
    """Files by dotted name within the package; a folder's `__init__` by the folder's name."""
    named = {path.relative_to(root).with_suffix("").as_posix().replace("/", "."): path for path in root.rglob("*.py")}
    return {name.removesuffix("__init__").removesuffix("."): path for name, path in named.items()}


def imports(root: Path, name: str, path: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """All imports in a file, inside functions too: (module, names), own modules as dotted names after a dot."""
    folder = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    folder = [part for part in folder if part]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                own = alias.name.split(".")[0] == root.name
                yield ("." + alias.name.partition(".")[2] if own else alias.name), ()
        elif isinstance(node, ast.ImportFrom):
            names = tuple(alias.name for alias in node.names)
            if node.level:
                base = folder[: len(folder) - node.level + 1]
                yield "." + ".".join([*base, *([node.module] if node.module else [])]), names
            elif node.module and node.module.split(".")[0] == root.name:
                yield "." + node.module.partition(".")[2], names
            else:
                yield node.module or "", names


def exported(path: Path) -> set[str]:
    """Names that a room's `__init__` imports or defines."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


def faults(root: Path) -> list[str]:
    """What breaks the rules, a line each."""
    known, found = modules(root), []
    inside: dict[str, set[str]] = {name: set() for name in known}
    for name, path in known.items():
        room = name.split(".")[0]
        for target, names in imports(root, name, path):
            if not target.startswith("."):
                if target.split(".")[0] in HEAVY and not f"{name}.".startswith(tuple(f"{m}." for m in MAY_BE_HEAVY)):
                    found.append(f"{name} imports {target}")
                continue
            module = target[1:]
            # `from . import x` and `from .folder import x` may mean modules
            parts = [f"{module}.{n}".lstrip(".") for n in names if f"{module}.{n}".lstrip(".") in known]
            other = (module or (parts[0] if parts else "")).split(".")[0]
            if not room:
                continue  # the package's own __init__ lists names of every room
            if not other:
                found.append(f"{name} imports the package itself")
            elif other == room:
                inside[name] |= set(parts) - {name} or ({module} if module in known else set())
            elif floor_of(other) >= floor_of(room):
                found.append(f"{name} (floor {floor_of(room)}) imports {other} (floor {floor_of(other)})")
            else:
                public = known.get(module)
                if public is None or public.name != "__init__.py" or (module != other and other != "studies"):
                    found.append(f"{name} imports {module}, which is not a room's public path")
                elif not set(names) <= exported(public):
                    found.append(f"{name} imports {sorted(set(names) - exported(public))}, not exported by {module}")
    try:
        tuple(graphlib.TopologicalSorter(inside).static_order())
    except graphlib.CycleError as error:
        found.append(f"cycle: {' -> '.join(error.args[1])}")
    return found


def test_imports_point_downward_through_public_paths():
    assert faults(ROOT) == []


def test_the_top_level_lists_names_of_rooms_only():
    for target, names in imports(ROOT, "", ROOT / "__init__.py"):
        if target.startswith("."):
            assert set(names) <= exported(ROOT / target[1:].replace(".", "/") / "__init__.py"), target


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("model/scene.py", "from ..sweeps import sweep\n", "model.scene (floor 1) imports sweeps"),
        ("model/scene.py", "def f():\n    from ..flow import Status\n", "model.scene (floor 1) imports flow"),
        ("model/scene.py", "def f():\n    import slipperjax.flow\n", "model.scene (floor 1) imports flow"),
        ("model/scene.py", "from ..analysis import classify\n", "model.scene (floor 1) imports analysis"),
        ("model/scene.py", "from .motion import Motion\n", "cycle: "),
        ("model/scene.py", "def f():\n    from .motion import Motion\n", "cycle: "),
        ("model/scene.py", "import matplotlib.pyplot\n", "model.scene imports matplotlib.pyplot"),
        ("sweeps/sweep.py", "from ..model.scene import Scene\n", "model.scene, which is not a room's public path"),
        ("sweeps/sweep.py", "from ..model import motion\n", "['motion'], not exported by model"),
        ("sweeps/sweep.py", "from ..model import Scene\n", None),
    ],
)
def test_faults_put_in_by_hand_are_found(tmp_path, file, text, words):
    root = tmp_path / "slipperjax"
    for room in ("model", "analysis", "flow", "sweeps"):
        (root / room).mkdir(parents=True)
        (root / room / "__init__.py").write_text("")
    (root / "__init__.py").write_text("")
    (root / "model" / "__init__.py").write_text("from .scene import Scene as Scene\n")
    (root / "model" / "scene.py").write_text("")
    (root / "model" / "motion.py").write_text("from .scene import Scene\n")
    (root / file).write_text(text)
    found = faults(root)
    assert found == [] if words is None else any(words in fault for fault in found), found


def test_modules_stay_small():
    for path in ROOT.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path


def test_tests_mirror_the_rooms():
    rooms = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert rooms <= {path.parent.name for path in Path(__file__).parent.glob("*/test_*.py")}
