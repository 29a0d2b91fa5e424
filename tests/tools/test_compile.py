"""In the programs of others: their settings of JAX, and an import where something is traced."""

import os
import subprocess
import sys

import pytest

SMALL = """
import jax
import numpy as np
def slope(speed):
    import slipperjax as sj
    scene = sj.paper_scene(1000.0)
    state = sj.initial_state(scene, sj.table_2_start())
    return sj.period_map(scene.replace(speed=speed), state, steps_per_period=40).motion.v_z
"""
STRICT = (
    SMALL
    + """
import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
assert sj.simulate(sj.paper_scene(1000.0), periods=1).status == 0
assert np.isfinite(jax.jit(jax.grad(slope))(1000.0))
scene = sj.paper_scene(1000.0)
state = sj.initial_state(scene, sj.table_2_start())
assert np.isfinite(jax.jit(lambda state: PeriodMap(scene, 40)(state).motion.v_z)(state))
rail = sj.RandomTrack.sled(length=200.0).prepared()
assert np.isfinite(jax.jit(lambda x: rail.irregularity(x).vertical)(9.0))
assert np.all(sj.sweep(scene, {"speed": [900.0, 950.0]}, transient=1, periods=2)["status"] == 0)
try:
    jax.numpy.ones(2) + jax.numpy.ones(2, int)
except Exception as error:
    assert "strict" in str(error)  # the user's own code stays so
else:
    raise AssertionError
"""
)
INSIDE = (
    SMALL
    + """
jax.config.update("jax_enable_x64", True)
assert np.isfinite(jax.jit(slope)(1000.0))  # imports it
import slipperjax as sj
assert np.isclose(sj.simulate(sj.paper_scene(1000.0), periods=1).end.motion.v_z, slope(1000.0), rtol=1e-9)
from slipperjax.tools.tracing import is_transformed
assert not is_transformed()
"""
)


def run(code, **environment):
    words = [sys.executable, "-W", "error::UserWarning", "-c", code]
    return subprocess.run(words, env=os.environ | environment, capture_output=True, text=True)


@pytest.mark.full
def test_the_users_code_may_be_strict_about_types():
    done = run(STRICT, JAX_NUMPY_DTYPE_PROMOTION="strict")
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.full
def test_the_first_import_may_be_inside_a_traced_function():
    done = run(INSIDE)
    assert done.returncode == 0, done.stderr[-2000:]


LEFT_OPEN = """
import jax
from slipperjax import jit
jax.config.update("jax_num_cpu_devices", 2)  # an error where a backend is there
assert len(jax.devices()) == 2
"""


def test_the_import_leaves_the_choice_of_a_backend_open():
    done = run(LEFT_OPEN)
    assert done.returncode == 0, done.stderr[-2000:]
