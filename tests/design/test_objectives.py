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

from ..common import PERIODS, fine
from ..common import STEPS as FINE

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


def values(objectives, *courses):
    """The numbers of several objectives, by one program."""

    def every(courses):
        kept = lambda one: jax.tree.map(lambda *a: jnp.stack(a), *map(one.of_course, courses))
        return jnp.stack([one.total(kept(one)) for one in objectives])

    return np.asarray(jax.jit(every)(courses))


def power_mean(order):
    """Of |sin|: (1/pi) B((p + 1)/2, 1/2), to the power 1/p."""
    beta = math.lgamma((order + 1) / 2) + math.lgamma(0.5) - math.lgamma(order / 2 + 1)
    return (math.exp(beta) / math.pi) ** (1 / order)


SINES = [
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
]


def test_objectives_of_sines_are_those_in_closed_form():
    objectives, expected = zip(*SINES, strict=True)
    # the cubics through 64 steps of a sine miss it by 1e-7 of its amplitude
    np.testing.assert_allclose(values(objectives, some_course()), expected, rtol=3e-6, atol=1e-12)


@pytest.mark.parametrize("shift", [0.5, -0.5])
def test_an_excursion_counts_both_sides(shift):
    found = values(
        [Excursion("roll"), SoftExcursion("roll")], some_course(coordinates=wave(2e-3, shift, shape=(10,)))
    )
    np.testing.assert_allclose(found[0], 3e-3, rtol=3e-6)  # 1 mrad to the other side
    assert 0.9 < found[1] / found[0] < 1


def test_the_greatest_of_several_periods_counts_and_means_are_taken():
    weak, strong = some_course(force=wave(10.0, 1.0, shape=(2, 10))), some_course()
    peak, load, *soft = values([PeakForce(), OBJECTIVES["contact_load"], *map(soft_peak, (32, 128))], weak, strong)
    assert peak == pytest.approx(100.0, rel=1e-6)
    assert load == pytest.approx(20 * 30.0, rel=1e-9)
    assert values([SoftPeakForce()], strong)[0] > soft[0]  # half of the time it is weaker
    # 20 points at once: the sum over them raises it, by 20^(1/p)
    np.testing.assert_allclose(soft[1] / 20 ** (1 / 128), 98, rtol=0.03)


def soft_peak(order):
    return SoftPeakForce(order=order)


def test_without_contact_forces_are_zero_and_have_a_derivative():
    def scaled(scale):
        less = lambda a: a * scale
        force, acceleration = (wave(50.0, 1.0, shape=shape) for shape in ((2, 10), (5,)))
        course = some_course(force=jax.tree.map(less, force), acceleration=jax.tree.map(less, acceleration))
        kept = lambda one: jax.tree.map(lambda a: a[None], one.of_course(course))
        objectives = SoftPeakForce(), RMSAcceleration(), OBJECTIVES["impact_impulse"].smooth
        found = jnp.stack([one.total(kept(one)) for one in objectives])
        return found, found

    slopes, found = jax.jit(jax.jacrev(scaled, has_aux=True))(0.0)
    np.testing.assert_array_equal(found, 0.0)
    assert np.all(np.isfinite(slopes)), slopes


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
        (lambda: values([PeakForce("Q7")], some_course()), "Argument `point` must be one of A1, "),
    ]:
        with pytest.raises(ValueError, match=f"^{words}"):
            make()


def test_on_a_motion_they_agree_with_its_loads():
    """Peaks, impulses and impulses' sums of `simulate`, over the same steps and cubics."""
    scene = sj.paper_scene()
    run = fine(scene)
    asked = PeakForce(), OBJECTIVES["impact_impulse"], OBJECTIVES["contact_load"]
    step = PeriodMap(scene, ConstantSteps(FINE))
    recorder = Courses(tuple(one.of_course for one in asked))
    start = jax.tree.map(lambda a: a[0], run.state)
    kept = sj.jit(lambda: step.run(start, periods=PERIODS, recorder=recorder).record)()
    peak, impulse, load = (float(one.total(rows)) for one, rows in zip(asked, kept, strict=True))
    assert peak == pytest.approx(float(run.peak.force), rel=1e-9)
    assert impulse == pytest.approx(float(jnp.max(run.loads.impulse)), rel=1e-9)
    assert load == pytest.approx(float(jnp.sum(run.loads.impulse) / (PERIODS * scene.period)), rel=1e-9)
