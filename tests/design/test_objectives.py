"""Objectives on curves in closed form."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.design.objectives import OBJECTIVES, objective_named
from slipperjax.flow.numbers import RECORDS, OnePoint, PowerMean, Record
from slipperjax.model.quantities import Quantity

from ..flow.made_up import made_up_course, wave

PEAK, ROLL = OBJECTIVES["peak_force"], OBJECTIVES["excursion_roll"]


NET = [wave(60.0, -0.5), wave(20.0), *[wave(7.0, 0.5)] * 3]
"""Net force along y, which is greatest downwards, and z, and net moments."""


def spread(curve, shape=()):
    """A wave at many places."""
    return tuple(np.broadcast_to(a.reshape(-1, *[1] * len(shape)), (len(a), *shape)) for a in curve)


def some_course(**curves):
    parts = dict(coordinates=spread(wave(2e-3), (10,)), acceleration=spread(wave(100.0), (5,)))
    parts |= dict(force=spread(wave(50.0, 1.0), (2, 10)), gap=spread(wave(1e-4, 1.5, 2), (2, 10)))
    parts |= dict(power=spread(wave(0.0), (2, 10)), drive_force=wave(3.0, 2.0))
    parts |= dict(slipper_load=tuple(np.stack(each, axis=-1) for each in zip(*NET, strict=True)))
    return made_up_course(**(parts | curves))


def values(objectives, *courses):
    """The numbers of several objectives, by one program."""

    def every(courses):
        made = [some_course(**curves) for curves in courses]
        kept = lambda one: jnp.stack([one.of(course) for course in made])
        return jnp.stack([one.total(kept(one)) for one in objectives])

    return np.asarray(jax.jit(every)(courses or ({},)))


def power_mean(order):
    """Of |sin|: (1/pi) B((p + 1)/2, 1/2), to the power 1/p."""
    beta = math.lgamma((order + 1) / 2) + math.lgamma(0.5) - math.lgamma(order / 2 + 1)
    return (math.exp(beta) / math.pi) ** (1 / order)


SINES = [
    (PEAK, 100.0),
    (OnePoint(RECORDS["peak_force"], "C2"), 100.0),
    (OBJECTIVES["peak_slipper_force"], 90.0),
    (objective_named("peak_slipper_force_z"), 20.0),
    (PowerMean(objective_named("peak_slipper_force_z"), 64), 20 * power_mean(64)),
    (OBJECTIVES["rms_a_y"], 100 / math.sqrt(2)),
    (ROLL, 2e-3),
    (PowerMean(ROLL, 8), 2e-3 * power_mean(8)),
    (PowerMean(ROLL, 64), 2e-3 * power_mean(64)),
    (OBJECTIVES["contact_load"], 20 * 50.0),
    (OBJECTIVES["contact_work"], 0.0),
    (OBJECTIVES["drive_force"], 6.0),
    (OBJECTIVES["impact_impulse"], 50.0 * 8.0 / 1250.0),
    (OBJECTIVES["impact_impulse"].smooth, 20 ** (1 / 32) * 50.0 * 8.0 / 1250.0),
    (OBJECTIVES["grazing_distance"], 0.5e-4),
    (Record(Quantity("square", "N^2", ""), lambda c: c.drive_force.mean_square, "mean"), 9 * 4.5),
]


def test_objectives_of_sines_are_those_in_closed_form():
    objectives, expected = zip(*SINES, strict=True)
    # the cubics through 64 steps of a sine miss it by 1e-7 of its amplitude
    np.testing.assert_allclose(values(objectives), expected, rtol=3e-6, atol=1e-12)


@pytest.mark.parametrize("shift", [0.5, -0.5])
def test_an_excursion_counts_both_sides(shift):
    result = values([ROLL, ROLL.smooth], dict(coordinates=spread(wave(2e-3, shift), (10,))))
    np.testing.assert_allclose(result[0], 3e-3, rtol=3e-6)  # 1 mrad to the other side
    assert 0.9 < result[1] / result[0] < 1


def test_the_greatest_of_several_periods_counts_and_means_are_taken():
    weak = dict(force=spread(wave(10.0, 1.0), (2, 10)))
    peak, load, softer = values([PEAK, OBJECTIVES["contact_load"], PowerMean(PEAK, 128)], weak, {})
    assert peak == pytest.approx(100.0, rel=1e-6)
    assert load == pytest.approx(20 * 30.0, rel=1e-9)
    # 20 points at once: the sum over them raises it, by 20^(1/p)
    np.testing.assert_allclose(softer / 20 ** (1 / 128), 98, rtol=0.03)


@pytest.mark.full
def test_without_contact_forces_are_zero_and_have_a_derivative():
    force, acceleration = spread(wave(50.0, 1.0), (2, 10)), spread(wave(100.0), (5,))
    objectives = PEAK.smooth, OBJECTIVES["rms_a_z"], OBJECTIVES["impact_impulse"].smooth

    def scaled(scale):
        less = lambda curve: tuple(a * scale for a in curve)
        course = some_course(force=less(force), acceleration=less(acceleration))
        result = jnp.stack([one.total(one.of(course)[None]) for one in objectives])
        return result, result

    slopes, result = jax.jit(jax.jacrev(scaled, has_aux=True))(0.0)
    np.testing.assert_array_equal(result, 0.0)
    assert np.all(np.isfinite(slopes)), slopes


def test_names_are_those_of_the_table_and_equal_objectives_are_one():
    for name, objective in OBJECTIVES.items():
        assert objective_named(name) is objective
        assert objective.name == name
    point = objective_named("peak_force_A1")
    assert point == OnePoint(RECORDS["peak_force"], "A1") != objective_named("peak_force_A2")
    assert point.name == "peak_force_A1"
    assert hash(PowerMean(PEAK, 16)) == hash(PowerMean(PEAK, 16))
    assert objective_named(RECORDS["peak_force"]) == PEAK
    assert objective_named(lambda course: course.steps * 1.0).quantity.unit == "1"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: objective_named("rms_a_x"), "Argument `objective` must be one of peak_slipper_force, "),
        (lambda: objective_named(RECORDS["impulse"]), "Argument `objective` must be one of peak_slipper_force"),
        (lambda: PowerMean(RECORDS["rms_a_y"]), "Argument `record` must have samples"),
        (lambda: OnePoint(RECORDS["impulse"]), "Argument `record` must be a greatest or least of points"),
        (lambda: values([objective_named("peak_force_Q7")]), "Argument `point` must be one of A1, "),
    ],
)
def test_wrong_choices_are_refused(make, words):
    with pytest.raises(ValueError, match=f"^{words}"):
        make()
