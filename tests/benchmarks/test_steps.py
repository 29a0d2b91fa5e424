"""Tables behind `ImpulseRK4` and the default steps: errors, lost cases, orders, derivatives, cost.

    pytest -m benchmark -s tests/benchmarks/test_steps.py

Errors are the worst of the ten states, in multiples of 1 mm, 10 mrad, 1 m/s and 10 rad/s.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.kinematics import MOTION_SCALES
from slipperjax.model.step_size import PER_CONTACT, steps_needed

from .timing import batch, in_turns, micros

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")]
SOLVERS = {"RK4": sj.solvers.RK4(), "ImpulseRK4": sj.solvers.ImpulseRK4(), "Tsit5": sj.solvers.Tsit5()}
BOTH = ("RK4", "ImpulseRK4")
SIZES = np.array(jax.tree.leaves(MOTION_SCALES))
RANDOM = 200
FORMER = 15, 50  # steps per typical impact and per period at least, when RK4 was the default
# some easy and some hard scenes about the paper's
SCENES = [
    sj.paper_scene(1250.0),
    sj.paper_scene(1480.0, restitution=0.7),
    sj.paper_scene(1255.0, 0.8e-3, 0.28),
    sj.paper_scene(1330.0),
    sj.paper_scene(1610.0, stiffness=2.5e8),
    sj.paper_scene(2300.0),
    sj.paper_scene(900.0),
]


@functools.cache
def runner(solver, periods):
    """Compiled once: the motion's ten numbers some periods on, by scene and steps per period."""

    @jax.jit
    def run(scene, state, steps):
        end = PeriodMap(scene, ConstantSteps(steps=steps), SOLVERS[solver], periods)(state)
        return jnp.stack(jax.tree.leaves(end.motion))

    return run


def end(solver, scene, steps, periods=1):
    return np.asarray(runner(solver, periods)(scene, sj.initial_state(scene, sj.table_2_start()), float(steps)))


def error(found, exact):
    size = np.max(np.abs(found - exact) / SIZES, axis=-1)
    return np.where(np.isfinite(size), size, 10.0)


def mean(errors):
    return np.exp(np.mean(np.log(np.clip(errors, 1e-12, 10.0))))


@pytest.fixture(scope="module")
def scenes():
    """Random ones, the steps of before, and states after one period by 16 and 32 times as many."""
    rng = np.random.default_rng(0)
    log = lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))
    found = []
    for _ in range(RANDOM):
        heavier = log(1 / 3, 3)
        scene = sj.paper_scene(
            log(100, 2500), log(1e-4, 5e-3), stiffness=log(1e7, 1e12), restitution=rng.uniform(0.2, 1)
        )
        inertia = {f"inertia_{a}": float(v) * heavier for a, v in zip("xyz", scene.slipper.inertia, strict=True)}
        found.append(scene.replace(mass=float(scene.slipper.mass) * heavier, **inertia))
    steps = [by_rule(s, *FORMER) for s in found]
    exact = [np.stack([end("RK4", s, k * n) for k in (16, 32)]) for s, n in zip(found, steps, strict=True)]
    return found, np.array(steps), np.array(exact)


def by_rule(scene, per_contact, least):
    """Steps per period as in `slipperjax.model.default_steps_per_period` with other constants."""
    steps = max(per_contact * float(steps_needed(scene)) / PER_CONTACT, least)
    unit = least * 2 ** max(np.ceil(np.log2(steps / (6 * least))), 0)
    return unit * np.ceil(steps / unit)


def row(name, errors):
    shown = " ".join(f"{e:8.1e}" for e in np.percentile(errors, (10, 50, 75, 90, 95)))
    print(f"{name:28} {shown}  {np.sum(errors > 0.1):3d} above 0.1, geometric mean {mean(errors):.1e}")


def test_random_scenes(scenes):
    """After one period from Table 2's start; the last of RK4's rows is the default of before."""
    found, steps, exact = scenes
    print(f"\n{len(found)} scenes, {np.median(steps):.0f} steps in the median; percentiles 10, 50, 75, 90, 95")
    row("the reference's own", error(exact[:, 0], exact[:, 1]))
    errors = {}
    for name in BOTH:
        for share in (0.5, 0.67, 1.0, 2.0):
            ends = [end(name, s, round(share * n)) for s, n in zip(found, steps, strict=True)]
            errors[name, share] = error(np.array(ends), exact[:, 1])
            row(f"{name}, {share:g} of the steps", errors[name, share])
    for share in (0.5, 0.67, 1.0, 2.0):
        plain, ours = (errors[name, share] for name in BOTH)
        worse = [np.sum((a > 2 * b) & (a > 1e-4)) for a, b in ((ours, plain), (plain, ours))]
        print(f"{share:g}: ImpulseRK4's above 1e-4 and twice RK4's in {worse[0]} scenes, RK4's in {worse[1]}")
    print("ImpulseRK4 with steps per impact and per period at least")
    for rule in (FORMER, (8, 25), (9, 30), (10, 32), (10, 40), (12, 40), (12, 50)):
        taken = np.array([by_rule(s, *rule) for s in found])
        ends = np.array([end("ImpulseRK4", s, n) for s, n in zip(found, taken, strict=True)])
        row(f"{rule}, {np.exp(np.mean(np.log(taken))):.0f} steps", error(ends, exact[:, 1]))
    default = error(
        np.array([end("ImpulseRK4", s, sj.model.default_steps_per_period(s)) for s in found]), exact[:, 1]
    )
    assert mean(default) < mean(errors["RK4", 1.0])  # measured 5.9e-4 and 1.1e-3
    assert mean(errors["ImpulseRK4", 1.0]) < 0.3 * mean(errors["RK4", 1.0])  # measured 0.15


def test_lost_cases():
    """Of 241 speeds, in 100 periods."""
    hard = sj.paper_scene(stiffness=1e9, restitution=0.5)
    for text, scene in (("the paper's scene", sj.paper_scene()), ("K 1e9, restitution 0.5", hard)):
        for steps in (25, 33, 50, 100):
            options = dict(record="strobe", transient=0, periods=100, steps_per_period=steps, progress=False)
            grid = {"speed": np.linspace(100, 2500, 241)}
            lost = [int(np.sum(sj.sweep(scene, grid, solver=name, **options)["status"] != 0)) for name in BOTH]
            print(f"{text}, {steps} steps: RK4 loses {lost[0]}, ImpulseRK4 {lost[1]}")


def table(errors, steps):
    for name, rows in errors.items():
        slope = -np.polyfit(np.log(steps[2:]), np.log(rows[2:]), 1)[0]
        print(f"{name:11} " + " ".join(f"{e:8.1e}" for e in rows) + f"  order {slope:.2f} from {steps[2]} steps on")


def test_orders():
    """Of values after two periods, and of derivatives of the state after one, by clearance and restitution."""
    steps = (25, 33, 50, 71, 100, 141, 200, 283, 400)
    print("\n" + " " * 12 + " ".join(f"{n:8d}" for n in steps))
    exact = [end("RK4", scene, 12_800, 2) for scene in SCENES]
    of_values = lambda name, n: mean([error(end(name, s, n, 2), e) for s, e in zip(SCENES, exact, strict=True)])
    values = {name: np.array([of_values(name, n) for n in steps]) for name in SOLVERS}
    table(values, steps)

    def slopes(name, scene, steps):
        def states(x):
            changed = scene.replace(clearance=1e-3 * x[0], restitution=0.8 * x[1])
            return runner(name, 1)(changed, sj.initial_state(changed, sj.table_2_start()), float(steps))

        return np.asarray(jax.jacfwd(states)(jnp.ones(2)))

    exact = [slopes("ImpulseRK4", scene, 12_800) for scene in SCENES]
    off = lambda found, right: np.max(np.abs(found - right)) / np.max(np.abs(right))
    of_slopes = lambda name, n: mean([off(slopes(name, s, n), e) for s, e in zip(SCENES, exact, strict=True)])
    table({name: np.array([of_slopes(name, n) for n in steps]) for name in BOTH}, steps)
    assert values["ImpulseRK4"][4] < 0.2 * values["RK4"][4]  # measured 0.08


@pytest.mark.parametrize("tangent", [False, True])
def test_cost(tangent):
    """Of one step and case in a batch, best of alternating runs."""
    timed = in_turns({name: batch(solver, tangent) for name, solver in SOLVERS.items()}, 12)
    print("\nfirst call with compiling [s]: " + ", ".join(f"{name} {of.first:.1f}" for name, of in timed.items()))
    best = {name: min(of.later) for name, of in timed.items()}
    for name, seconds in best.items():
        print(f"{name:11} {micros(seconds):.3f} us per step and case, {seconds / best['RK4']:.2f} of RK4's")
