"""Errors of derivatives against their cost: the second picture of docs/lab/solvers.md.

    pytest -m benchmark -s tests/benchmarks/test_slopes.py

Derivatives of the ten states after one period by clearance and restitution, of which the worse one counts: its
greatest error in multiples of 1 mm, 10 mrad, 1 m/s and 10 rad/s, relative to its greatest value. Errors are geometric
means over the scenes of test_steps.py. The cost is that of one derivative in one call, on one core: with one tangent,
or of two runs for central differences, whose step is at each point the one of `DIFFERENCES` with the least error.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.layout import coordinate_rows
from slipperjax.plots.style import png
from slipperjax.tools.compile import jit

from ..bench.methods import Case
from ..bench.work_precision import Point, draw, table
from ..common import SCALES
from .peers import CppProgram, plain_numbers
from .test_steps import SCENES
from .timing import in_turns

pytestmark = pytest.mark.benchmark
DEFAULT = "ImpulseRK4"
METHODS = {
    DEFAULT: (sj.solvers.ImpulseRK4(), sj.model.EventLatch()),
    "RK4": (sj.solvers.RK4(), sj.model.EventLatch()),
    "Tsit5": (sj.solvers.Tsit5(), sj.model.EventLatch()),
    "Rodas4": (sj.solvers.Rodas4(), sj.model.EventLatch()),
    "smooth: RK4": (sj.solvers.RK4(), sj.model.SmoothSwitch()),
}
RK4_DIFFERENCES, CPP_DIFFERENCES = "differences of RK4", "differences of C++"
SHOWN = {
    DEFAULT: "ImpulseRK4,\nthe default",
    "RK4": "RK4",
    "Rodas4": "Rodas4",
    "smooth: RK4": "RK4, smooth switch",
    "Tsit5": "Tsit5",
    CPP_DIFFERENCES: "C++ RK4,\ncentral differences",
    RK4_DIFFERENCES: "RK4,\ncentral differences",
}
STEPS, FINE = (25, 50, 100, 200, 400), 12_800
DIFFERENCES = (3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
"""Relative steps of central differences."""
COPIES = 9
"""Copies of each scene in a call."""
CASE = "derivatives of the state after a period by clearance and restitution"
NAMES, START = ("clearance", "restitution"), sj.table_2_start()


def programs(solver, memory):
    """Of all scenes at once: the states after a period, and their derivative along a change of the parameters."""
    one = [dataclasses.replace(scene, memory=memory) for scene in SCENES]
    scenes = jax.tree.map(lambda *leaves: jnp.stack(leaves * COPIES), *one)
    values = jnp.array([[float(scene.value(name)) for name in NAMES] for scene in one] * COPIES)

    def states(values, scene, steps):
        changed = scene.replace(**dict(zip(NAMES, values, strict=True)))
        end = PeriodMap(changed, ConstantSteps(steps=steps), solver, 1)(sj.initial_state(changed, START))
        return coordinate_rows(end) / SCALES

    plain = jit(jax.vmap(states, (0, 0, None)))
    tangent = jit(
        jax.vmap(lambda v, s, n, way: jax.jvp(lambda x: states(x, s, n), (v,), (v * way,))[1], (0, 0, None, None))
    )
    run = lambda steps, factors: plain(values * factors, scenes, float(steps))
    slope = lambda steps, way: tangent(values, scenes, float(steps), way)
    return run, slope


def of_both(slope):
    """Derivatives (parameters, scenes, 10) from a function that gives one along a direction."""
    return np.stack([np.asarray(slope(way))[: len(SCENES)] for way in np.eye(len(NAMES))])


def central(run, step):
    return of_both(lambda way: (np.asarray(run(1 + step * way)) - np.asarray(run(1 - step * way))) / (2 * step))


def off(found, exact):
    worst = np.max(np.abs(found - exact), axis=2) / np.max(np.abs(exact), axis=2)
    worst = np.max(np.where(np.isfinite(worst), worst, np.inf), axis=0)
    return float(np.exp(np.mean(np.log(worst))))


def micros(call, repeats=7):
    """Best microseconds per scene of a call."""
    times = in_turns({"": call}, repeats - 1)[""].later
    cost = np.array([min(times), np.median(times)]) * 1e6 / (COPIES * len(SCENES))
    return float(cost[0]), float(cost[1])


def cpp_points(folder, exact):
    """Central differences of the C++ program, and its derivatives with the finest steps."""
    program, numbers = CppProgram(folder), [plain_numbers(Case("", scene, 1, START)) or {} for scene in SCENES]
    points, found = [], np.empty(0)
    for steps in (*STEPS, 4 * FINE):
        taken = []

        def run(factors, steps=steps, taken=taken):
            ends = []
            for scene, of_scene in zip(SCENES, numbers, strict=True):
                changed = of_scene | {n: of_scene[n] * f for n, f in zip(NAMES, factors, strict=True)}
                states, each = program(float(scene.speed), changed, 1, steps)
                ends.append(states[0] / SCALES)
                taken.append(each * steps)
            return np.array(ends)

        by_step = {h: central(run, h) for h in DIFFERENCES}
        best = min(by_step, key=lambda h: off(by_step[h], exact))
        found = by_step[best]
        cost = (2 * min(taken), 2 * float(np.median(taken)))
        points.append(Point(CASE, CPP_DIFFERENCES, f"{steps} steps, {best:.0e}", off(found, exact), {1: cost}))
    return points[:-1], found


def test_errors_of_derivatives(tmp_path):
    made = {name: programs(*method) for name, method in METHODS.items()}
    finest = lambda name, steps: of_both(lambda way: made[name][1](steps, way))
    exact = finest(DEFAULT, FINE)
    theirs, cpp = cpp_points(tmp_path, exact)
    for name, found in {
        f"{DEFAULT}, {FINE // 2} steps": finest(DEFAULT, FINE // 2),
        f"Tsit5, {4 * FINE} steps": finest("Tsit5", 4 * FINE),
        f"RK4, {4 * FINE} steps": finest("RK4", 4 * FINE),
        f"C++, {4 * FINE} steps, differences": cpp,
    }.items():
        print(f"{name}: {off(found, exact):.1e} from {DEFAULT} with {FINE} steps")
        assert off(found, exact) < 3e-5
    lanes = COPIES * len(SCENES)
    points = []
    for name, (run, slope) in made.items():
        for steps in STEPS:
            found = of_both(lambda way, n=steps, slope=slope: slope(n, way))
            cost = micros(lambda n=steps, slope=slope: slope(n, np.eye(2)[0]))
            points.append(Point(CASE, name, f"{steps} steps", off(found, exact), {lanes: cost}))
            if name == "RK4":
                errors = {h: off(central(lambda f, n=steps, run=run: run(n, f), h), exact) for h in DIFFERENCES}
                best = min(errors, key=lambda h: errors[h])
                print(steps, {h: f"{e:.1e}" for h, e in errors.items()})
                cost = tuple(2 * c for c in micros(lambda n=steps, run=run: run(n, np.ones(2))))
                points.append(Point(CASE, RK4_DIFFERENCES, f"{steps} steps, {best:.0e}", errors[best], {lanes: cost}))
    print("\n" + table(points + theirs))
    path = tmp_path / "slopes.png"
    error = "relative error of derivatives"
    path.write_bytes(png(draw(points + theirs, shown=SHOWN, error=error)[0, 0].figure, 150))
    print(path)
