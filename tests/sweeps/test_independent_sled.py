"""Sleds on four slippers and two random rails, against runs that were written anew from the equations."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model import accuracy_scales

from . import independent_sled

WAVES = np.geomspace(30.0, 1.0, 16)
SIDES = ("left", "right")
GRAVITY = 9.81


def rails(seed, rms, *, bend=0.0, hill=0.0, roll=0.0):
    """The left and the right rail: random sines with amplitudes roughly proportional to their lengths.

    `rms`: of each rail's own lateral and vertical displacement, its longest wave included; that wave is then replaced
    by one of both rails, of the amplitudes `bend` and `hill`; `roll`: of each sine, over its vertical amplitude
    [rad/m].
    """
    rng, found = np.random.default_rng(seed), []
    for _ in SIDES:
        amplitudes = np.zeros((len(WAVES), 3))
        for direction in range(2):
            size = WAVES * rng.uniform(0.5, 1.0, len(WAVES))
            amplitudes[:, direction] = size * rms * np.sqrt(2 / np.sum(size**2))
        amplitudes[:, 2] = roll * amplitudes[:, 1]
        phases = rng.uniform(0, 2 * np.pi, (len(WAVES), 3))
        # so that the sled begins on the level, between two bends
        amplitudes[0], phases[0, :2] = [bend, hill, 0.0], [0.0, np.pi / 2]
        found.append(independent_sled.Rail(WAVES, amplitudes, phases))
    return found


def corners(lengths=(0.2, 0.2), forward=1.2, backward=-1.2):
    """Front and rear slipper of the left rail, then of the right one."""
    places = [(x, y, -0.2) for y in (0.9, -0.9) for x in (forward, backward)]
    return [independent_sled.Slipper(place, k // 2, lengths[k % 2]) for k, place in enumerate(places)]


def case(rails, slippers, **values):
    values = dict(speed=300.0, restitution=0.5, gravity=GRAVITY) | values
    return independent_sled.Case(mass=400.0, inertia=(60.0, 300.0, 300.0), slippers=slippers, rails=rails, **values)


def scene_of(case):
    """The same case of slipperjax."""
    tracks = [sj.model.FourierTrack(rail.wavelengths, *rail.amplitudes.T, *rail.phases.T) for rail in case.rails]
    # those that are as long as the case says need no length of their own
    length_of = lambda s: None if s.length == case.length else s.length
    mounts = [sj.Mount(*s.place, rail=SIDES[s.rail], length=length_of(s)) for s in case.slippers]
    elastic = case.modes
    modes = sj.model.Modes(elastic.frequency, elastic.damping, elastic.shapes) if len(elastic.frequency) else None
    (play,) = {s.play for s in case.slippers}
    return sj.Scene(
        speed=case.speed,
        slipper=sj.Sled(case.mass, case.inertia, mounts, modes=modes, length=case.length),
        section=sj.model.paper_section(2 * play),
        track=sj.model.TwoRails(*tracks),
        contact=sj.model.Flores(case.stiffness, case.restitution),
        memory=sj.model.EventLatch(),
        gravity=case.gravity,
    )


def both(case, distance, *, z=0.0):
    """Runs of slipperjax and of the independent one, at rest in the middle of the rails' beginning."""
    want = independent_sled.run(case, case.start(z=z), distance, tolerance=1e-12)
    record = ["peak_force", "impacts", "slipper_peak"]
    options = dict(window=10.0, steps_per_period=3000, start=sj.Motion(z=z), record=record)
    ds = sj.run(scene_of(case), length=distance, **options)
    assert int(ds["status"]) == 0
    return ds, want


def errors(case, ds, want):
    """Greatest differences of highest forces, over the highest of all, and of the end, in units of its scales."""
    forces = np.abs(ds["peak_force"].max("distance").values - want.peaks).max() / want.peaks.max()
    end = dict(zip(ds["number"].values, ds["state"].values[-1], strict=True))
    names = ["y", "z", "v_y", "v_z", "w_x", "w_y", "w_z"]
    modes = range(1, len(case.omega) + 1)
    modal = [end[f"mode_{k}"] for k in modes] + [end[f"mode_rate_{k}"] for k in modes]
    number = np.array([end[name] for name in names] + modal)
    other = np.concatenate([want.state[:7], want.state[independent_sled.MODES]])
    sizes = np.concatenate([case.sizes[:7], case.sizes[independent_sled.MODES]])
    return forces, np.abs((number - other) / sizes).max()


def net_errors(case, ds, want):
    """Greatest differences of net loads, over the greatest force and moment of all, and of where forces are [m]."""
    net = np.concatenate([ds["peak_slipper_force"], ds["peak_slipper_moment"]], axis=-1)
    # of the windows, the one with the greatest magnitude
    window = np.argmax(np.abs(net), axis=0)[None]
    net = np.take_along_axis(net, window, axis=0)[0]
    place = np.take_along_axis(ds["peak_slipper_distance"].values, window[..., :2], axis=0)[0]
    force, moment = (np.abs(net - want.net)[:, k] / np.abs(want.net[:, k]).max() for k in (slice(2), slice(2, 5)))
    return force.max(), moment.max(), np.abs(place - case.speed * want.when[:, :2]).max()


# of unit modal mass: a twist of the frame, and a bend in which its ends move sideways and a little along x
TWIST = [[0.0, 0.1, 1.0], [0.0, 0.1, -1.0], [0.0, -0.1, -1.0], [0.0, -0.1, 1.0]]
BEND = [[0.2, 1.0, 0.1], [0.2, -0.8, 0.1], [-0.2, 1.0, 0.2], [-0.2, -0.8, 0.2]]
ELASTIC = independent_sled.Modes(np.array([35.0, 80.0]), np.array([0.03, 0.02]), 0.06 * np.array([TWIST, BEND]))


@pytest.mark.full
def test_an_elastic_sled_is_that_of_an_independent_implementation():
    """Slippers of two lengths, not in the middle, on rails that roll."""
    slippers = corners(lengths=(0.3, 0.2), forward=1.4, backward=-1.0)
    sled = case(rails(2, 1e-4, bend=1e-3, hill=5e-3, roll=1.0), slippers, modes=ELASTIC)
    ds, want = both(sled, 20.0, z=5e-3)
    # of every face of each slipper, 84 of them
    np.testing.assert_array_equal(ds["impacts"].sum("distance"), want.touchdowns)
    assert want.touchdowns.sum() > 80
    forces, end = errors(sled, ds, want)
    assert forces < 2e-6  # 3e-7
    assert end < 2e-7  # 2e-8
    force, moment, place = net_errors(sled, ds, want)
    assert force < 1e-7  # 1.2e-8
    assert moment < 1e-6  # 1.4e-7
    assert place < 2e-5  # 3.7e-6 m
    assert set(np.sign(want.net).ravel()) == {-1.0, 1.0}


@pytest.mark.slow  # for half a minute
def test_adaptive_steps_resolve_a_mode_that_hardly_moves_the_sled():
    """A bend of 8 kHz, of whose errors the body's ten numbers show little."""
    fast = independent_sled.Modes(np.array([35.0, 8000.0]), ELASTIC.damping, ELASTIC.shapes)
    sled = case(rails(2, 1e-4, bend=1e-3, hill=5e-3, roll=1.0), corners(), modes=fast)
    want = independent_sled.run(sled, sled.start(z=5e-3), 0.8, tolerance=1e-9)
    assert want.touchdowns.sum() >= 4
    scene = dataclasses.replace(scene_of(sled), window=0.8)
    options = dict(
        solver="Tsit5", stepsize_controller=sj.solvers.AdaptiveSteps(1e-5), steps_per_period=400, loads=False
    )
    m = sj.simulate(scene, 1, start=sj.Motion(z=5e-3), saves_per_period=1, **options).end.motion
    found = np.array([m.y, m.z, m.v_y, m.v_z, *m.modes.coordinate, *m.modes.rate])
    apart = found - np.concatenate([want.state[:4], want.state[independent_sled.MODES]])
    scales = accuracy_scales(scene)
    sizes = [1e-3, 1e-3, 1.0, 1.0, *scales.modes.coordinate, *scales.modes.rate]
    np.testing.assert_allclose(scales.modes.coordinate, [1e-3 / 0.06] * 2)
    # 1.4e-4, of the bend's rate; 0.15 over 2 m where its error does not count
    assert np.max(np.abs(apart) / sizes) < 5e-4


@pytest.mark.slow  # for a minute
def test_a_sled_on_two_random_rails_is_that_of_an_independent_implementation():
    """Contacts of little restitution, on rails on which the motion stays predictable: 1e-8 m/s at the start change
    highest forces by 8e-7 of the highest, and the end by 1e-8. With a restitution of 0.7 it is chaotic on rails
    of 0.25 mm."""
    sled = case(rails(2, 1.4e-4, bend=1e-3, hill=3.5e-3, roll=1.0), corners())
    ds, want = both(sled, 200.0, z=3.5e-3)
    # of each of the 80 points 5 at least, together 656
    np.testing.assert_array_equal(ds["impacts"].sum("distance"), want.touchdowns)
    assert np.all(want.touchdowns >= 5)
    forces, end = errors(sled, ds, want)
    assert forces < 1e-5  # 3e-7; 6e-8 with four times as many steps
    assert end < 1e-6  # 9e-9
    force, moment, _ = net_errors(sled, ds, want)
    assert force < 1e-5
    assert moment < 1e-5
