"""The rooms: imports lead to the module where a name is written, downward, anywhere in a file, without cycles.

Imports by a text, such as those of `importlib.import_module`, count, too.
"""

import ast
import collections
import graphlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import slipperjax

ROOT = Path(slipperjax.__file__).parent
ROOMS = "tools; model analysis; solvers; flow; plots; results; orbits; sweeps; studies design fitting explorer; cli"
FLOORS = [set(rooms.split()) for rooms in ROOMS.split(";")]
BY_NAME = {"import_module", "__import__", "find_spec", "load", "attach"}
"""Functions of importlib and of lazy loaders, whose texts name modules."""
EXPORTING = {"analysis", "design", "fitting", "flow", "model", "orbits", "plots", "results", "solvers", "sweeps"}
# JAX alone below; these read and write labelled data, pictures and files
HEAVY = {"xarray", "zarr", "matplotlib", "dask", "tqdm", "click", "h5netcdf", "bokeh"}
MAY_BE_HEAVY = ("plots", "results", "sweeps", "studies", "design", "fitting", "explorer", "cli")
MAY_BE_HEAVY += (
    "tools.progress",
    "tools.tables",
    "flow.datasets",
    "orbits.branches",
    "orbits.critical",
    "orbits.own_branches",
)


def floor_of(room: str) -> int:
    # files beside the package's own __init__ stand above all rooms
    return next((k for k, rooms in enumerate(FLOORS) if room in rooms), len(FLOORS))


def modules(root: Path) -> dict[str, Path]:
    """Files by dotted name within the package; a folder's `__init__` by the folder's name."""
    named = {path.relative_to(root).with_suffix("").as_posix().replace("/", "."): path for path in root.rglob("*.py")}
    return {name.removesuffix("__init__").removesuffix("."): path for name, path in named.items()}


def absolute(folder: list[str], level: int, module: str) -> str:
    """An own module as a dotted name after a dot, from one with `level` dots before it in a file of `folder`."""
    return "." + ".".join([*folder[: len(folder) - level + 1], *filter(None, [module])])


def imports(root: Path, name: str, path: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """All imports in a file, inside functions too: (module, names), own modules as dotted names after a dot."""
    folder = name.split(".") if path.name.startswith("__init__.py") else name.split(".")[:-1]
    folder = [part for part in folder if part]
    for node in ast.walk(ast.parse(path.read_text())):
        texts, names = [], ()
        if isinstance(node, ast.Import):
            texts = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            texts = ["." * node.level + (node.module or "")]
            names = tuple(alias.name for alias in node.names)
        elif isinstance(node, ast.Call) and (function := ast.unparse(node.func).split(".")[-1]) in BY_NAME:
            # lazy loaders take names of modules in their own folder
            dot = "." if function == "attach" else ""
            constants = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
            texts = [dot + text for text in constants if isinstance(text, str)]
        for text in texts:
            module = text.lstrip(".")
            if level := len(text) - len(module):
                yield absolute(folder, level, module), names
            else:
                own = module.split(".")[0] == root.name
                yield ("." + module.partition(".")[2] if own else module), names


def faults(root: Path) -> list[str]:
    """Breaches of the rules, a line each."""
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
            meant = {f"{module}.{n}".lstrip(".") for n in names} & set(known) or {module}
            for other in meant:
                if floor_of(room) == len(FLOORS):
                    continue  # the package's own files may import any room
                if not other:
                    found.append(f"{name} imports the package itself")
                elif other.split(".")[0] == room:
                    inside[name] |= {other} - {name}
                elif floor_of(other.split(".")[0]) >= floor_of(room):
                    floors = floor_of(room), floor_of(other.split(".")[0])
                    found.append(f"{name} (floor {floors[0]}) imports {other} (floor {floors[1]})")
                if other in known and known[other].name == "__init__.py" and path.name != "__init__.py":
                    found.append(f"{name} imports {other}, and not the module where the name is written")
            private = [n for n in names if n.startswith("_") and not n.endswith("__")]
            if private:
                found.append(f"{name} imports {', '.join(private)} from {module}, which are its own")
    try:
        tuple(graphlib.TopologicalSorter(inside).static_order())
    except graphlib.CycleError as error:
        found.append(f"cycle: {' -> '.join(error.args[1])}")
    return found


def test_imports_lead_downward_to_the_module_of_a_name():
    assert faults(ROOT) == []


def test_each_public_name_has_one_place():
    exported = [name for _, names in imports(ROOT, "", ROOT / "__init__.pyi") for name in names]
    for room in modules(ROOT):
        init = ROOT / room.replace(".", "/") / "__init__.py"
        if room and init.exists():
            names = [name for target, names in imports(ROOT, room, init) if target.startswith(".") for name in names]
            assert (room in EXPORTING or room == "cli") or not names, room
            exported += names if room in EXPORTING else []
    assert [name for name, count in collections.Counter(exported).items() if count > 1] == []
    assert all(getattr(slipperjax, name) is not None for name in slipperjax.__all__)


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("model/scene.py", "from ..sweeps.sweep import sweep\n", "model.scene (floor 1) imports sweeps"),
        ("model/scene.py", "def f():\n    from ..flow.status import Status\n", "model.scene (floor 1) imports flow"),
        ("model/scene.py", "def f():\n    from .motion import Motion\n", "cycle: "),
        ("model/scene.py", "import matplotlib.pyplot\n", "model.scene imports matplotlib.pyplot"),
        ("sweeps/sweep.py", "from ..model import Scene\n", "sweeps.sweep imports model, and not the module"),
        ("sweeps/sweep.py", "from ..model.scene import _checked\n", "imports _checked from model.scene"),
        ("sweeps/sweep.py", "from ..model.scene import Scene\n", None),
        (
            "model/scene.py",
            "from importlib import import_module\nimport_module('slipperjax.sweeps.sweep')\n",
            "sweeps",
        ),
        ("model/scene.py", "import importlib\nx = importlib.import_module('..flow', __package__)\n", "imports flow"),
        ("model/scene.py", "def f():\n    return __import__('matplotlib')\n", "model.scene imports matplotlib"),
        ("model/scene.py", "import lazy_loader\nplt = lazy_loader.load('matplotlib.pyplot')\n", "imports matplotlib"),
        ("model/scene.py", "import lazy_loader\nlazy_loader.attach(__name__, ['motion'])\n", "cycle: "),
        ("model/scene.py", "from .. import beyond\n", "imports beyond (floor"),
        ("beyond.py", "def f():\n    from . import sweeps\n", None),
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
    (root / "beyond.py").write_text("")
    (root / file).write_text(text)
    found = faults(root)
    assert found == [] if words is None else any(words in fault for fault in found), found


def test_tests_mirror_the_rooms():
    rooms = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert rooms <= {path.parent.name for path in Path(__file__).parent.glob("*/test_*.py")}
