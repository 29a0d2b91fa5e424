"""Net loads of slippers: signs and places of curves, the static share at rest, balances, derivatives.

tests/sweeps/test_independent_sled.py has them beside an implementation that shares no code.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.numbers import ALIASES, RECORDS
from slipperjax.model.dynamics import forces_at, slipper_wrenches, static_loads
from slipperjax.model.kinematics import contacts

from ..common import QUICK, sled_on
from .made_up import made_up_course, wave

NET = {name: RECORDS[name] for name in ALIASES["slipper_peak"]}
LEVEL = sj.model.FourierTrack([8.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0])
TWO_LEVEL = sj.model.TwoRails(LEVEL, LEVEL)
THREE = [(1.5, 0.1, "left"), (-0.7, 0.9, "left"), (-0.9, -0.8, "right")]


def loaded(*curves):
    """Courses, one for each period, of a single slipper with given loads."""
    courses = []
    for parts in curves:
        values, slopes = (np.stack(each, axis=-1) for each in zip(*parts, strict=True))
        courses.append(made_up_course(slipper_load=(values, slopes)))
    return courses


NOTHING = wave(0.0)


def test_the_greatest_magnitude_keeps_its_sign_and_place():
    """-A (1 + 0.5) at three quarters of a period, and A (1 + 0.2) at an eighth of another one."""
    down, up = wave(2e3, -0.5), wave(1e3, 0.2, phase=np.pi / 4)
    (course,) = loaded([down, up, NOTHING, down, up])
    force, moment, place = jax.jit(lambda: [NET[name].of(course) for name in list(NET)[:3]])()
    # cubics through 64 steps of a sine miss it by 1e-7 of its amplitude
    np.testing.assert_allclose(force, [-3e3, 1.2e3], rtol=1e-6)
    np.testing.assert_allclose(moment, [0.0, -3e3, 1.2e3], rtol=1e-6)
    # lengths of 8 m: measured 1e-7
    np.testing.assert_allclose(place, [6.0, 1.0], rtol=0, atol=1e-5)
    # without contact there is no place
    (open_,) = loaded([NOTHING] * 5)
    place, force = jax.jit(lambda: [NET[f"peak_slipper_{name}"].of(open_) for name in ("distance", "force")])()
    assert np.all(np.isnan(place))
    np.testing.assert_array_equal(force, 0.0)


def test_the_greatest_of_several_periods_counts_with_its_sign():
    periods = [(1.0, -2.0), (-4.0, 2.5), (3.0, 1.0)]
    courses = loaded(*([wave(a, 0.1), wave(b, 0.1), *[NOTHING] * 3] for a, b in periods))
    record, places = NET["peak_slipper_force"], NET["peak_slipper_distance"]
    for epoch, course in enumerate(courses):
        course.args = course.args._replace(epoch=float(epoch))

    def joined(one):
        carried = one.begin(sj.paper_scene(), None)
        for course in courses:
            carried = one.add(carried, course)
        return carried

    found = jax.jit(
        lambda: (record.total(jnp.stack([record.of(c) for c in courses])), joined(record), joined(places))
    )
    total, force, place = found()
    for greatest in (total, force):
        np.testing.assert_allclose(greatest, [-4.4, 2.75], rtol=1e-6)
    # both in the second period, at a quarter of it
    np.testing.assert_allclose(places.finish(place, None, None), [8 + 2.0, 8 + 2.0], rtol=0, atol=1e-5)


def heavy(**parts):
    """A scene that stands on level rails."""
    return dataclasses.replace(sj.paper_scene(speed=50.0), gravity=9.81, **parts)


def at_rest(scene):
    """Net forces along y and z, and moments about x and y, of the slippers of a scene at rest."""

    def loads():
        args = sj.model.Args(scene)
        state = sj.initial_state(scene, sj.AtRest())
        frame = args.frame(0.0)
        at = forces_at(scene, frame, contacts(frame, state.motion), state)
        return slipper_wrenches(scene, at, args.travel(0.0))

    _, *loads_ = map(np.asarray, jax.jit(loads, compiler_options=QUICK)())
    return loads_[:4]


@pytest.mark.full
def test_the_net_load_at_rest_is_the_static_load():
    scene = heavy(track=LEVEL, friction=sj.model.Coulomb(0.2))
    ds = sj.run(scene, length=2.0, steps_per_period=200, record="slipper_peak")
    assert int(ds["status"]) == 0
    # measured 9e-7, of the spring that centres a slipper at rest
    np.testing.assert_allclose(ds["static_ratio"], 1.0, rtol=3e-6)
    np.testing.assert_allclose(ds["peak_slipper_force"].sel(axis="z"), 14 * 9.81, rtol=3e-6)


def test_three_slippers_at_rest_are_in_balance():
    """Forces, and moments about their own middles; shares leave out where in a slipper its force is."""
    y, z, about_x, about_y = at_rest(heavy(track=TWO_LEVEL, slipper=sled_on(THREE)))
    weight = 400.0 * 9.81
    x_of, y_of = np.array([place[:2] for place in THREE]).T
    assert z.sum() == pytest.approx(weight, rel=3e-6)  # measured 5e-7
    # moments about the centre of mass, over the weight [m]: measured 4e-6
    about = np.array([about_x + y_of * z + 0.2 * y, about_y - x_of * z]).sum(axis=1) / weight
    np.testing.assert_allclose(about, 0.0, atol=1.2e-5)
    assert np.abs(np.array([about_x, about_y]).sum(axis=1)).max() > 1e-4 * weight


def test_an_applied_load_is_part_of_the_static_load():
    loads = eqx.filter_jit(lambda scene: static_loads(scene, scene.travel(0.0)))
    one = heavy(track=LEVEL, load=sj.model.AppliedLoad(force=(0.0, 0.0, -100.0)))
    assert float(loads(one)) == pytest.approx(14 * 9.81 + 100)
    np.testing.assert_allclose(loads(heavy(track=TWO_LEVEL, slipper=sled_on())), 100 * 9.81, rtol=1e-12)


@pytest.mark.full
def test_net_forces_are_mass_times_acceleration():
    """Friction included, of a single slipper without weight."""
    scene = dataclasses.replace(sj.paper_scene(), friction=sj.model.Coulomb(0.3))
    record = ["slipper_peak", "peak_a_y", "peak_a_z"]
    ds = sj.run(scene, length=16.0, window=8.0, steps_per_period=100, record=record, start=sj.table_2_start())
    force = np.abs(ds["peak_slipper_force"].values)
    acceleration = np.stack([ds["peak_a_y"], ds["peak_a_z"]], axis=-1)
    np.testing.assert_allclose(force, 14.0 * acceleration, rtol=1e-9)
    assert np.all(np.isnan(ds["static_ratio"]))
    assert ds["peak_slipper_force"].dims == ("distance", "axis")
