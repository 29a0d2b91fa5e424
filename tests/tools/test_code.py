"""Digests of code: those of what a function uses, in any process."""

import functools
import os
import subprocess
import sys

import equinox as eqx
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.tools.code import classes_of, code_digest

FUNCTION = """
import numpy as np
{above}
def f(x, y=2):
    return {body}
"""


def digest(body, above=""):
    known = {"__name__": "of_a_user"}
    exec(compile(FUNCTION.format(above=above, body=body), above, "exec"), known)
    return code_digest(known["f"])


@pytest.mark.parametrize(
    ("body", "first", "second"),
    [
        ("g(x)", "g = lambda x: x + 1", "g = lambda x: x + 2"),
        ("[g(x) for _ in y]", "def g(x): return h * x\nh = 1", "def g(x): return h * x\nh = 2"),
        ("x * table", "table = np.arange(3)", "table = np.arange(1, 4)"),
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


@pytest.mark.full
def test_digests_are_the_same_in_any_process():
    program = (
        "from slipperjax.tools.code import code_digest\nimport slipperjax as sj\n"
        "def f(x): return x in x in {'a', 'b', 'c', 'd', 'e', 'f', 'g', 'h'}\n"
        "class Law(sj.model.Flores): force = f\n"
        "print(code_digest(f), code_digest(Law))"
    )
    run = functools.partial(subprocess.run, [sys.executable, "-c", program], capture_output=True, check=True)
    assert len({run(env=os.environ | {"PYTHONHASHSEED": seed}).stdout for seed in "12"}) == 1


def test_classes_of_users_inside_values_are_found():
    class Law(eqx.Module):
        stiffness: float = 1.0

    found = set(classes_of({"scene": [sj.paper_scene(), (Law(),)], "others": (np.ones(2), len)}))
    assert found == {Law}
