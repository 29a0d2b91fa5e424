"""Travel whose speed changes with the place: programmes of speeds."""

import contextlib
import dataclasses

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.starts import state_and_penetration


@pytest.mark.full
@pytest.mark.parametrize("memory", [sj.model.EventLatch(), sj.model.SmoothSwitch()])
def test_rates_and_reactions_are_those_of_a_constant_speed_there(memory):
    faster = sj.SpeedProgramme.over_distance([0.0, 80.0], [1250.0, 2000.0])
    scene = dataclasses.replace(sj.paper_scene(memory=memory), speed=faster)
    start, args = sj.initial_state(scene, sj.Motion(z=-8e-4, v_z=-0.5)), sj.model.Args(scene, 3.0)
    there = sj.paper_scene(float(scene.travel(3.25).speed), memory=memory)
    rates = [
        jax.tree.leaves(sj.model.vector_field(s).evaluate(0.25, start, sj.model.Args(s, 3.0)).motion)
        for s in (scene, there)
    ]
    np.testing.assert_allclose(*rates, rtol=1e-12)
    forces = [sj.model.reactions(0.25, start, a).contact_force for a in (args, args._replace(scene=there))]
    assert np.max(forces[0]) > 0
    np.testing.assert_allclose(*forces, rtol=1e-12)


PROGRAMME = sj.SpeedProgramme.stages(
    [sj.Stage(200.0, speed=900.0), sj.Stage(0.0, length=300.0), sj.Stage(-100.0, duration=2.0)], start=50.0
)


def test_stages_are_constant_accelerations():
    length = (900.0**2 - 50.0**2) / 400.0
    np.testing.assert_allclose(PROGRAMME.distance, [0.0, length, length + 300.0, length + 300.0 + 1600.0])
    np.testing.assert_allclose(PROGRAMME.speed, [50.0, 900.0, 900.0, 700.0])
    at = np.array([0.0, 500.0, length + 100.0, length + 1000.0])
    np.testing.assert_allclose(PROGRAMME.acceleration(at), [200.0, 200.0, 0.0, -100.0])
    np.testing.assert_allclose(PROGRAMME.at(at)[1], np.sqrt(50.0**2 + 400.0 * 500.0))
    # 4.25 s of thrust, a third of a second, 2 s of brakes
    np.testing.assert_allclose(PROGRAMME.seconds(PROGRAMME.distance), [0.0, 4.25, 4.25 + 1 / 3, 6.25 + 1 / 3])


def test_times_are_integrals_of_the_pace():
    places = np.linspace(-20.0, float(PROGRAMME.distance[-1]) + 50.0, 200_001)
    middle = (places[1:] + places[:-1]) / 2
    time = np.concatenate([[0.0], np.cumsum(np.diff(places) / np.asarray(PROGRAMME.at(middle)))])
    seconds = np.asarray(PROGRAMME.seconds(places))
    np.testing.assert_allclose(seconds - seconds[0], time, rtol=1e-7)  # measured 3e-9
    # accelerations are half the slope of the square of the speed
    square = np.asarray(PROGRAMME.at(places)) ** 2
    slope = np.diff(square) / np.diff(places) / 2
    kinks = np.abs(middle[:, None] - np.asarray(PROGRAMME.distance)).min(axis=1) < 0.05
    np.testing.assert_allclose(slope[~kinks], PROGRAMME.acceleration(middle)[~kinks], atol=1e-3)


def test_speeds_over_time_are_linear_in_time():
    programme = sj.SpeedProgramme.over_time([0.0, 1.0, 3.0], [100.0, 300.0, 200.0])
    np.testing.assert_allclose(programme.distance, [0.0, 200.0, 700.0])
    way = lambda t: 100.0 * t + 100.0 * t**2
    np.testing.assert_allclose(programme.seconds(np.array([way(0.3), way(0.9)])), [0.3, 0.9])
    np.testing.assert_allclose(programme.at(np.array([way(0.3)])), [160.0])


def test_what_stands_still_is_passed_at_the_least_speed():
    # 0.6 s on the ground, 2 s of thrust, a brake to a stop, a pause, a push, and a stop at the end
    time = np.array([2.0, 2.6, 4.6, 6.6, 7.6, 8.6, 9.6])
    speed = np.array([-0.02, 0.0, 200.0, 0.0, 0.0, 20.0, 0.0])
    programme = sj.SpeedProgramme.over_time(time, speed)
    ends = [0.0, 200.0, 400.0, 410.0, 420.0]
    # 1 m/s is reached after 5 mm at 100 m/s^2, and 25 mm at 20 m/s^2
    places = [0.0, 0.005, 200.0, 400.0 - 0.005, 400.025, 410.0, 420.0 - 0.025, 420.0]
    np.testing.assert_allclose(programme.distance, places, rtol=1e-12)
    np.testing.assert_allclose(programme.speed, [1.0, 1.0, 200.0, 1.0, 1.0, 20.0, 1.0, 1.0], rtol=1e-12)
    # times are those of the history, also beside the pause
    np.testing.assert_allclose(
        programme.seconds(np.array([0.0, 0.005, 200.0, 400.025, 420.0])), [2.0, 2.61, 4.6, 7.65, 9.6]
    )
    halfway = 0.5 * 100.0 * 1.0**2
    np.testing.assert_allclose(programme.seconds(halfway), 3.6, rtol=1e-12)
    stands = programme.stands(
        np.array([0.0, 1.0, 399.0, 399.999, 400.5, 419.0]), np.array([1.0, 399.0, 400.0, 401.0, 419.0, 420.0])
    )
    assert stands.tolist() == [True, False, True, True, False, True]
    # beyond a stop it stands for ever, and before a standstill, too
    assert programme.stands(np.array([-5.0, 425.0]), np.array([-4.0, 426.0])).tolist() == [True, True]
    assert not np.any(PROGRAMME.stands(np.array([-5.0]), np.array([9999.0])))
    assert programme.least(ends[0], ends[-1]) == 1.0
    # the same speeds by their places, and by stages
    by_place = sj.SpeedProgramme.over_distance([0.0, 200.0, 400.0], [0.0, 200.0, 0.0])
    by_stage = sj.SpeedProgramme.stages([sj.Stage(100.0, speed=200.0), sj.Stage(-100.0, length=200.0)], start=0.0)
    for other in (by_place, by_stage):
        for name in ("distance", "speed"):
            last = 400.0 if name == "distance" else 1.0
            np.testing.assert_allclose(getattr(other, name), [*getattr(programme, name)[:4], last], rtol=1e-12)
        np.testing.assert_allclose(other.time, [0.0, 0.01, 2.0, 3.99, 4.0], rtol=1e-12)


DIP = sj.SpeedProgramme.over_distance([0.0, 800.0, 816.0, 824.0, 840.0], [1000.0, 1000.0, 50.0, 50.0, 1000.0])
"""Braked to 50 m/s for one forcing period, the 103rd."""


@pytest.mark.parametrize("programme", [PROGRAMME, DIP, dataclasses.replace(DIP, scale=1.3)])
def test_the_least_speed_of_a_stretch_is_that_of_all_its_places(programme):
    rng, far = np.random.default_rng(0), float(programme.distance[-1]) * 1.2
    stretches = [(0.0, 8.0), (-50.0, far), (790.0, 850.0), (818.0, 820.0), *np.sort(rng.uniform(-50, far, (20, 2)))]
    for begin, end in stretches:
        least = np.min(programme.at(np.linspace(begin, end, 20_001)))
        exact = float(programme.least(begin, end))
        assert exact <= least * (1 + 1e-12)
        # the places are up to 0.25 m apart; measured 5.8e-3 at the dip
        np.testing.assert_allclose(exact, least, rtol=2e-2)


@pytest.mark.parametrize("place", [0.0, 640.0, 804.0, 820.0, 2000.0])
def test_starts_are_judged_by_the_speed_at_their_place(place):
    scene = dataclasses.replace(sj.paper_scene(), speed=DIP)
    there = sj.paper_scene(speed=float(DIP.at(place)))
    start = sj.Motion(z=-1.5e-3)
    depths = [state_and_penetration(s, start, place / 8.0)[1] for s in (scene, there)]
    np.testing.assert_allclose(*depths, rtol=1e-12)
    outside = pytest.warns(sj.ImplausibleWarning, match="outside the")
    with outside if place == 820.0 else contextlib.nullcontext():
        sj.initial_state(scene, start, place / 8.0)


def test_a_programme_is_differentiable_and_swept():
    of_scale = lambda scale: dataclasses.replace(PROGRAMME, scale=scale).seconds(np.float64(1000.0))
    slopes = jax.jit(lambda scale: [f(of_scale)(scale) for f in (lambda f: f, jax.jacfwd, jax.grad)])(1.0)
    np.testing.assert_allclose(slopes[1:], -float(slopes[0]), rtol=1e-12)  # time is as 1 / scale
    scene = dataclasses.replace(sj.paper_scene(), speed=PROGRAMME)
    assert float(scene.replace(**{"speed.scale": 2.0}).travel(0.0).speed) == 100.0
    with pytest.raises(ValueError, match="`speed` cannot be set: the scene has no constant travelling speed"):
        scene.replace(speed=1000.0)


def stages(*rows, start=50.0):
    return lambda: sj.SpeedProgramme.stages(list(rows), start=start)


def over_time(*columns):
    return lambda: sj.SpeedProgramme.over_time(*columns)


NOISE = (
    "`speed` must not be below -1 m/s, which is noise that the `cutoff` of a file removes, but is -3 m/s at time 0 s"
)
TWICE = [0.0, 1.0, 2.0], [0.0, 0.0, 9.0]
BAD = {
    "Argument `speed` must be positive, but is 0": lambda: sj.SpeedProgramme([0.0, 1.0], [0.0, 2.0]),
    "`speed` must not be zero at two": lambda: sj.SpeedProgramme.over_distance(*TWICE),
    "`speed` must reach 1 m/s": over_time([0.0, 1.0], [0.0, 0.5]),
    NOISE: over_time([0.0, 1.0], [-3.0, 6.0]),
    "`speed` must have one value for each of two or more": over_time([0.0, 1.0], [6.0]),
    "`stages` must have one stage or more, but has none": stages(),
    "`stages` must have a length, a duration or a speed each": stages(sj.Stage(9.0)),
    "`stages` must reach their speed from 50 m/s": stages(sj.Stage(-9.0, speed=90.0)),
    "must go on to their ends from 50 m/s, and not stop before": stages(sj.Stage(-90.0, length=99.0)),
    "`stages` must go on to their ends from 0 m/s": stages(sj.Stage(0.0, length=9.0), start=0.0),
    "`stages` must not turn back from 50 m/s": stages(sj.Stage(-10.0, duration=9.0)),
}


@pytest.mark.parametrize("words", BAD)
def test_bad_programmes_name_what_is_wrong(words):
    with pytest.raises(ValueError, match=words):
        BAD[words]()


@pytest.mark.full
@pytest.mark.parametrize("solver", [None, "Rodas4", "TwoStep"])
def test_free_flight_takes_the_time_of_a_programme(solver):
    scene = dataclasses.replace(sj.paper_scene(clearance=30e-3), speed=PROGRAMME.over_distance([0, 32], [900, 1000]))
    run = sj.simulate(scene, 4, start=sj.Motion(v_y=0.1), solver=solver, steps_per_period=100)
    seconds = 32.0 / 950.0
    assert float(run.time[-1]) == pytest.approx(seconds)
    # measured 1e-8 with TwoStep, of second order
    np.testing.assert_allclose(run.end.motion.y, 0.1 * seconds, rtol=1e-6 if solver == "TwoStep" else 1e-12)
    with pytest.raises(ValueError, match="Argument `scene` must have a constant speed"):
        sj.periodic_orbit(scene)


@pytest.mark.full
def test_a_sled_is_driven_by_its_mass_times_the_acceleration():
    scene = dataclasses.replace(sj.paper_scene(clearance=30e-3), track=sj.model.StraightTrack(), speed=PROGRAMME)
    args, state = sj.model.Args(scene, 10.0), sj.initial_state(scene, sj.Motion())
    assert float(sj.model.reactions(0.5, state, args).drive_force) == pytest.approx(14.0 * 200.0, rel=1e-12)
    drag = dataclasses.replace(scene, load=sj.model.AppliedLoad(force_by_square=[-0.02, 0.0, 0.0]))
    force = float(sj.model.reactions(0.5, state, sj.model.Args(drag, 10.0)).drive_force)
    assert force == pytest.approx(14.0 * 200.0 + 0.02 * (50.0**2 + 400.0 * 84.0), rel=1e-12)


def test_bad_programmes_in_files_name_the_line(tmp_path):
    (tmp_path / "scene.toml").write_text('base = "paper"\n[speed]\nstart = "5 m/s"\nstages = [5]\n')
    with pytest.raises(ValueError, match="line 4: `stages` must be a list of tables"):
        _ = sj.load(tmp_path / "scene.toml").scene


def test_motions_without_end_need_a_constant_speed_and_no_wear():
    scene = sj.paper_scene()
    worn = dataclasses.replace(scene, wear=sj.model.Wear(1e-12))
    for one, words in ((dataclasses.replace(scene, speed=PROGRAMME), "a constant speed"), (worn, "no wear here")):
        with pytest.raises(ValueError, match=f"Argument `scene` must have {words}"):
            sj.lyapunov_spectrum(one, 1)
        with pytest.raises(ValueError, match=f"Argument `scene` must have {words}"):
            sj.follow(one, {"clearance": [1e-3, 2e-3]})
