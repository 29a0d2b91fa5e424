"""A derivative in this process, with the parts of its time [s], printed as JSON: see test_derivatives.py."""

import json
import sys
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp

import slipperjax as sj

SCENE = sj.paper_scene(speed=1250.0)
START = sj.initial_state(SCENE, sj.table_2_start())
PARTS = {"jaxpr_to_mlir_module_duration": "lower", "backend_compile_duration": "compile"}
MODES = {
    "value": lambda f: f,
    "jacfwd": jax.jacfwd,
    "grad": jax.grad,
    "jacfwd of jacfwd": lambda f: jax.jacfwd(jax.jacfwd(f)),
    "hessian": jax.hessian,
}


def after_three(solver, scene=SCENE, start=START):
    """y after three periods at 100 steps [m]."""
    return sj.period_map(scene, start, periods=3, steps_per_period=100, solver=solver).motion.y


def question(what: str) -> tuple[Callable, object]:
    """A function and its argument."""
    speed = jnp.asarray(1250.0)
    if what in ("RK4", "ImpulseRK4"):
        solver = getattr(sj.solvers, what)()
        return lambda v: after_three(solver, SCENE.replace(speed=v)), speed
    if what == "scene and start":
        return lambda both: after_three(None, *both), (SCENE, START)
    if what == "start":
        return lambda motion: after_three(None, start=sj.State(motion, START.memory)), START.motion
    if what == "peak force":
        return lambda v: sj.simulate(SCENE.replace(speed=v), periods=3, steps_per_period=100).peak.force, speed
    if what == "orbit":
        return lambda v: sj.periodic_orbit(SCENE.replace(speed=v), steps_per_period=100).state.motion.y, speed
    if what == "smooth switch":
        scene = sj.paper_scene(speed=1250.0, memory=sj.model.SmoothSwitch())
        start = sj.initial_state(scene, sj.table_2_start())
        return lambda v: after_three(None, scene.replace(speed=v), start), speed
    raise ValueError(what)


def main() -> None:
    """Prints the parts of the time of the first call, and the time of a later one."""
    what, mode = sys.argv[1:]
    function, at = question(what)
    asked = MODES[mode](function)
    parts = {"lower": 0.0, "compile": 0.0}

    def heard(name: str, seconds: float, **_) -> None:
        part = PARTS.get(name.rpartition("/")[2])
        if part is not None:
            parts[part] += seconds

    jax.block_until_ready(jnp.asarray(1.0) + 1.0)
    jax.monitoring.register_event_duration_secs_listener(heard)
    begin = time.perf_counter()
    jax.block_until_ready(asked(at))
    first = time.perf_counter() - begin
    begin = time.perf_counter()
    jax.block_until_ready(asked(at))
    again = time.perf_counter() - begin
    print("ROW " + json.dumps(parts | {"first": first, "again": again}))


if __name__ == "__main__":
    main()
