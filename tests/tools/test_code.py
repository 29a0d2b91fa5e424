"""Digests of code: those of what a function uses, in any process, and programs that are made anew."""

import functools
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

import slipperjax
import slipperjax as sj
from slipperjax.tools.code import classes_of, code_digest, package_digest

FUNCTION = """
import numpy as np
{above}
def f(x, y=2):
    return {body}
"""


def digest(body, above=""):
    known = {"__name__": "of_a_user", "own": types.ModuleType("own")}
    exec(compile(FUNCTION.format(above=above, body=body), above, "exec"), known)
    return code_digest(known["f"])


@pytest.mark.parametrize(
    ("body", "first", "second"),
    [
        ("g(x)", "g = lambda x: x + 1", "g = lambda x: x + 2"),
        ("[g(x) for _ in y]", "def g(x): return h * x\nh = 1", "def g(x): return h * x\nh = 2"),
        ("x * table", "table = np.arange(3)", "table = np.arange(1, 4)"),
        ("own.g(x)", "own.g = lambda x: x + 1", "own.g = lambda x: x + 2"),
        (
            "g(x)",
            "import functools\ng = functools.partial(max, 1)",
            "import functools\ng = functools.partial(max, 2)",
        ),
        ("g(x)", "import jax\n@jax.jit\ndef g(x): return x", "import jax\n@jax.jit\ndef g(x): return -x"),
        ("C().g(x)", "class C:\n  g = property(lambda s: 1)", "class C:\n  g = property(lambda s: 2)"),
    ],
)
def test_a_digest_is_of_all_that_a_function_uses(body, first, second):
    assert digest(body, first) == digest(body, first + "\n# a comment")
    assert digest(body, first) != digest(body, second)


def test_digests_are_the_same_in_any_process():
    program = (
        "from slipperjax.tools.code import code_digest\nimport slipperjax as sj\n"
        "def f(x): return x in x in {'a', 'b', 'c', 'd', 'e', 'f', 'g', 'h'}\n"
        "print(code_digest(f), code_digest(type(sj.paper_scene().contact)))"
    )
    run = functools.partial(subprocess.run, [sys.executable, "-c", program], capture_output=True, check=True)
    assert len({run(env=os.environ | {"PYTHONHASHSEED": seed}).stdout for seed in "12"}) == 1


def test_classes_inside_values_are_found():
    found = {kind.__name__ for kind in classes_of({"scene": [sj.paper_scene()], "others": (np.ones(2), len)})}
    assert found == {"Scene", "Slipper", "Section", "HarmonicTrack", "Flores", "EventLatch"}
    assert len(package_digest()) == 12


def test_code_is_that_of_the_import_and_not_that_of_an_edit_since(tmp_path):
    package = Path(slipperjax.__file__).parent
    shutil.copytree(package, tmp_path / "slipperjax", ignore=shutil.ignore_patterns("__pycache__"))
    program = (
        "import pathlib, slipperjax as sj\n"
        "scene = sj.paper_scene()\n"
        "file = pathlib.Path('slipperjax') / 'sweeps' / 'run.py'\n"
        "file.write_text(file.read_text() + '# edited\\n')\n"
        "sj.sweep(scene, {'speed': [1e3]}, transient=0, periods=1, store='map.zarr')\n"
    )
    options = dict(cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True)
    found = subprocess.run([sys.executable, "-c", program], check=False, **options)
    assert "RuntimeError: the source of slipperjax was edited after this process imported it" in found.stderr
    assert not (tmp_path / "map.zarr").exists()


@pytest.mark.slow
def test_a_law_that_is_replaced_in_a_process_gives_its_own_numbers():
    program = (
        "import slipperjax as sj\n"
        "scene = sj.paper_scene()\n"
        "peak = lambda: float(sj.simulate(scene, 1, steps_per_period=50).peak.force)\n"
        "law, found = type(scene.contact), [peak()]\n"
        "usual = law.force\n"
        "for new in (lambda *a: 2 * usual(*a), usual):\n"
        "    law.force = new\n"
        "    found.append(peak())\n"
        "print(*found)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True, text=True)
    first, other, again = run.stdout.split()
    assert first == again != other


def test_programs_are_made_anew_where_a_method_was_replaced(monkeypatch):
    from slipperjax.tools import code

    class Law(eqx.Module):
        def force(self, gap):
            return 2.0 * gap

    cleared = []
    monkeypatch.setattr(code.jax, "clear_caches", lambda: cleared.append(1))
    for _ in range(2):
        code.heed_new_code(Law())
    assert cleared == []
    monkeypatch.setattr(Law, "force", lambda self, gap: 3.0 * gap)
    for _ in range(2):
        code.heed_new_code(Law())
    assert cleared == [1]
