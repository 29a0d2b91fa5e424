"""Objectives on curves in closed form, and on motions."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.objectives import (
    OBJECTIVES,
    Excursion,
    Functional,
    PeakForce,
    RMSAcceleration,
    SoftExcursion,
    SoftPeakForce,
    objective_named,
)
from slipperjax.flow.course import Course, Courses, Curve
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.stepping import ConstantSteps

STEPS = 64


def wave(amplitude, shift=0.0, turns=1, shape=()):
    """amplitude (sin(2 pi turns t) + shift) at the ends of steps, with its slopes."""
    t = np.arange(STEPS + 1) / STEPS
    values = amplitude * (np.sin(2 * np.pi * turns * t) + shift)
    slopes = amplitude * 2 * np.pi * turns / STEPS * np.cos(2 * np.pi * turns * t)
    full = lambda a: jnp.asarray(np.broadcast_to(a.reshape(-1, *[1] * len(shape)), (STEPS + 1, *shape)))
    return Curve(full(values), full(slopes))


def some_course(**curves):
    parts = dict(
        coordinates=wave(2e-3, shape=(10,)),
        acceleration=wave(100.0, shape=(5,)),
        force=wave(50.0, 1.0, shape=(2, 10)),
        gap=wave(1e-4, 1.5, 2, shape=(2, 10)),
        power=wave(0.0, shape=(2, 10)),
        drive_force=wave(3.0, 2.0),
    )
    return Course(sj.paper_scene(), STEPS, **(parts | curves))


def value(objective, *courses):
    kept = jax.tree.map(lambda *a: jnp.stack(a), *(objective.of_course(one) for one in courses))
    return float(objective.total(kept))


def power_mean(order):
    """Of |sin|: (1/pi) B((p + 1)/2, 1/2), to the power 1/p."""
    beta = math.lgamma((order + 1) / 2) + math.lgamma(0.5) - math.lgamma(order / 2 + 1)
    return (math.exp(beta) / math.pi) ** (1 / order)


# the cubics through 64 steps of a sine miss it by 1e-7 of its amplitude
@pytest.mark.parametrize(
    ("objective", "expected"),
    [
        (PeakForce(), 100.0),
        (PeakForce("C2"), 100.0),
        (RMSAcceleration("a_y"), 100 / math.sqrt(2)),
        (Excursion("roll"), 2e-3),
        (SoftExcursion("roll", 8), 2e-3 * power_mean(8)),
        (SoftExcursion("roll", 64), 2e-3 * power_mean(64)),
        (OBJECTIVES["contact_load"], 20 * 50.0),
        (OBJECTIVES["contact_work"], 0.0),
        (OBJECTIVES["drive_force"], 6.0),
        (OBJECTIVES["impact_impulse"], 50.0 * 8.0 / 1250.0),
        (OBJECTIVES["grazing_distance"], 0.5e-4),
        (Functional(lambda c: c.mean(c.drive_force.samples**2), "square", "N^2"), 9 * 4.5),
    ],
)
def test_objectives_of_sines_are_those_in_closed_form(objective, expected):
    assert value(objective, some_course()) == pytest.approx(expected, rel=3e-6, abs=1e-12)


def test_the_greatest_of_several_periods_counts_and_means_are_taken():
    weak, strong = some_course(force=wave(10.0, 1.0, shape=(2, 10))), some_course()
    assert value(PeakForce(), weak, strong, weak) == pytest.approx(100.0, rel=1e-6)
    assert value(OBJECTIVES["contact_load"], weak, strong) == pytest.approx(20 * 30.0, rel=1e-9)
    soft = [value(SoftPeakForce(order=p), weak, strong) for p in (8, 32, 128)]
    assert value(SoftPeakForce(), strong) > soft[1]  # half of the time it is weaker
    # 20 points at once: the sum over them raises it, by 20^(1/p)
    np.testing.assert_allclose(
        [s / 20 ** (1 / p) for s, p in zip(soft, (8, 32, 128), strict=True)][-1], 98, rtol=0.03
    )


def test_without_contact_forces_are_zero_and_have_a_derivative():
    nothing = wave(0.0, shape=(2, 10))
    assert value(SoftPeakForce(), some_course(force=nothing)) == 0.0
    assert value(RMSAcceleration(), some_course(acceleration=wave(0.0, shape=(5,)))) == 0.0
    for objective in (SoftPeakForce(), RMSAcceleration(), OBJECTIVES["impact_impulse"].smooth):
        scaled = lambda s, o=objective: value_of_scale(o, s)
        assert np.isfinite(float(jax.grad(scaled)(0.0))), objective


def value_of_scale(objective, scale):
    course = some_course(
        force=jax.tree.map(lambda a: a * scale, wave(50.0, 1.0, shape=(2, 10))),
        acceleration=jax.tree.map(lambda a: a * scale, wave(50.0, 1.0, shape=(5,))),
    )
    return objective.total(jax.tree.map(lambda a: a[None], objective.of_course(course)))


def test_names_are_those_of_the_table_and_equal_objectives_are_one():
    for name, objective in OBJECTIVES.items():
        assert objective_named(name) is objective
        assert objective.name == name
        assert objective.unit
        assert objective.quantity.long_name
    assert PeakForce("A1") == PeakForce("A1") != PeakForce("A2")
    assert hash(SoftPeakForce(order=16)) == hash(SoftPeakForce(order=16))
    assert PeakForce("A1").name == "peak_force_A1"
    found = objective_named(lambda course: course.steps * 1.0)
    assert isinstance(found, Functional)
    assert found.unit == "1"


def test_wrong_choices_are_refused():
    for make, words in [
        (lambda: RMSAcceleration("a_x"), "Argument `direction` must be one of a_y, a_z"),
        (lambda: Excursion("x"), "Argument `coordinate` must be one of y, z"),
        (lambda: SoftPeakForce(order=0), "Argument `order` must be positive"),
        (lambda: value(PeakForce("Q7"), some_course()), "Argument `point` must be one of A1, "),
    ]:
        with pytest.raises(ValueError, match=f"^{words}"):
            make()


def test_on_a_motion_they_agree_with_its_loads():
    """Peaks, impulses and impulses' sums of `simulate`, over the same steps and cubics."""
    scene = sj.paper_scene()
    run = sj.simulate(scene, 3, steps_per_period=100)
    asked = PeakForce(), OBJECTIVES["impact_impulse"], OBJECTIVES["contact_load"]
    step = PeriodMap(scene, ConstantSteps(100))
    recorder = Courses(tuple(one.of_course for one in asked))
    start = jax.tree.map(lambda a: a[0], run.state)
    kept = sj.jit(lambda: step.run(start, periods=3, recorder=recorder).record)()
    peak, impulse, load = (float(one.total(rows)) for one, rows in zip(asked, kept, strict=True))
    assert peak == pytest.approx(float(run.peak.force), rel=1e-9)
    assert impulse == pytest.approx(float(jnp.max(run.loads.impulse)), rel=1e-9)
    assert load == pytest.approx(float(jnp.sum(run.loads.impulse) / (3 * scene.period)), rel=1e-9)
