"""Programmes of speeds from thrust, drag, friction and water brakes, against closed forms."""

import re

import numpy as np
import pytest

import slipperjax as sj

G = 9.80665


def sled(**more):
    return sj.model.RocketSled([0.0, 2.0], [6e4, 6e4], mass=300.0, **more)


def worst(programme, distance, speed):
    """Give the largest relative error of the speeds at some distances."""
    return np.max(np.abs(np.asarray(programme.at(distance)) / speed - 1))


def test_constant_thrust_against_drag_is_a_tanh():
    programme = sled(drag_area=1.0).programme()
    k = 0.5 * 1.225
    limit = np.sqrt(6e4 / k)
    times = np.linspace(0.1, 1.99, 97)
    speed = limit * np.tanh(times * limit * k / 300)
    distance = 300 / k * np.log(np.cosh(times * limit * k / 300))
    # measured 2.3e-6, between the places of the programme; 3e-9 at them
    assert worst(programme, distance, speed) < 1e-5
    # measured 9e-7 s
    seconds = np.asarray(programme.seconds(distance)) - float(programme.seconds(distance[0]))
    np.testing.assert_allclose(seconds, times - 0.1, rtol=0, atol=5e-6)


def test_burning_propellant_makes_a_logarithm():
    programme = sled(propellant=100.0).programme()
    times = np.linspace(0.1, 2.0, 50)
    # constant thrust burns 50 kg a second
    left = 300 - 50 * times
    speed = 6e4 / 50 * np.log(300 / left)
    distance = 6e4 / 50 * (times - left / 50 * np.log(300 / left))
    # measured 4.4e-6
    assert worst(programme, distance, speed) < 1e-5


def test_coasting_and_braking_fall_exponentially():
    brake = sj.model.WaterBrake(2000.0, 2500.0, area=2e-4, turn=np.pi)
    assert brake.force_by_square == pytest.approx(0.4)
    programme = sled(drag_area=0.1, brakes=[brake], friction=0.1, begin=100.0).programme()
    burnout = float(programme.distance[np.argmax(np.asarray(programme.speed))])
    assert 450.0 < burnout < 550.0

    def coasted(distance, place, speed, force_by_square):
        """From d(v^2)/dx = -2 mu g - 2 k v^2 / m."""
        rate = 2 * force_by_square / 300
        level = 2 * 0.1 * G / rate
        return np.sqrt((speed**2 + level) * np.exp(-rate * (distance - place)) - level)

    drag = 0.5 * 1.225 * 0.1
    into = float(programme.at(burnout))
    before = np.linspace(burnout, 2000.0, 50)
    # measured 1.1e-7, and below 9.5e-7 and 1.2e-6
    assert worst(programme, before, coasted(before, burnout, into, drag)) < 5e-6
    inside = np.linspace(2000.0, 2500.0, 50)
    entered = coasted(2000.0, burnout, into, drag)
    assert worst(programme, inside, coasted(inside, 2000.0, entered, drag + 0.4)) < 5e-6
    left = coasted(2500.0, 2000.0, entered, drag + 0.4)
    # until the sled stops
    last = float(programme.distance[-1])
    after = np.linspace(2500.0, last, 50)
    assert worst(programme, after, coasted(after, 2500.0, left, drag)) < 5e-6
    assert float(programme.speed[-1]) == pytest.approx(1.0, abs=1e-8)
    assert last > 2600.0


def test_friction_holds_the_sled_until_the_thrust_exceeds_it():
    slow = sj.model.RocketSled([0.0, 10.0, 10.1], [0.0, 6e4, 0.0], mass=300.0, friction=0.5)
    programme = slow.programme()
    free = 0.5 * 300 * G / 6e3  # when it begins to move
    times = np.linspace(free + 1.0, 10.0, 40)
    speed = 20.0 * (times - free) ** 2 / 2
    # measured 1.0e-4 at the first of them, where the acceleration grows from zero, and less later
    assert worst(programme, 20.0 * (times - free) ** 3 / 6, speed) < 3e-4
    with pytest.raises(ValueError, match="`thrust` must move the sled against its friction, but is 6000"):
        sj.model.RocketSled([0.0, 1.0], [0.0, 6e3], mass=900.0, friction=1.0).programme()


def test_spikes_are_not_passed_over():
    """The impulse of a spike of 2 ms in a curve of 4 s makes its share of the speed."""
    time = np.array([0.0, 0.1, 1.999, 2.0, 2.001, 4.0])
    programme = sj.model.RocketSled(time, [0.0, 1e4, 1e4, 1e7, 1e4, 1e4], mass=500.0).programme()
    # without resistance the speed at the end is the impulse over the mass; the integration allows 1e-9 in each step,
    # measured 1e-9 and on another processor 1.5e-8
    impulse = 0.5 * 0.1 * 1e4 + 3.9 * 1e4 + 0.001 * (1e7 - 1e4)
    assert float(programme.speed[-1]) == pytest.approx(impulse / 500.0, rel=1e-7)
    assert float(programme.distance[-1]) == pytest.approx(1e5)


TABLE = """[speed]
thrust = "thrust.csv"
mass = "300 kg"
propellant = "80 kg"
drag_area = "0.1 m^2"
friction = 0.1
begin = "100 m"
brakes = [{ begin = "2 km", end = "2.5 km", area = "10 cm^2" }]
"""


def test_a_thrust_with_a_pause_moves_the_sled_twice():
    times, thrust = np.array([0.0, 0.001, 1.0, 1.001]), [0.0, 1e4, 1e4, 0.0]
    more = dict(mass=500.0, friction=0.5)
    once = sj.model.RocketSled(times, thrust, **more).programme()
    twice = sj.model.RocketSled(np.append(times, times + 6.0), thrust * 2, **more).programme()
    # behind 1 m/s the sled slides on once, v^2 / (2 g friction)
    way = 2 * float(once.distance[-1]) + 1 / G
    # found: 2.4e-7 m
    assert float(twice.distance[-1]) == pytest.approx(way, abs=1e-4)
    ((begin, _, duration),) = [stop for stop in twice.stops if stop[0] > 1.0]
    assert begin == pytest.approx(float(once.distance[-1]), abs=1e-3)
    assert duration == pytest.approx(6.0 - float(once.time[-1]), abs=0.1)


def test_a_thrust_in_a_file_makes_the_programme(tmp_path):
    (tmp_path / "thrust.csv").write_text("time [s], thrust [kN]\n0, 60\n2, 60\n2.1, 0\n")
    (tmp_path / "sled.toml").write_text(f'base = "paper"\n{TABLE}')
    scene = sj.load(tmp_path / "sled.toml").scene
    brake = sj.model.WaterBrake(2000.0, 2500.0, area=1e-3)
    more = dict(mass=300.0, propellant=80.0, drag_area=0.1, friction=0.1, begin=100.0, brakes=[brake])
    expected = sj.model.RocketSled.from_file(tmp_path / "thrust.csv", **more).programme()
    np.testing.assert_allclose(scene.speed.speed, expected.speed, rtol=1e-12)
    np.testing.assert_allclose(scene.speed.distance, expected.distance, rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("300 kg", "30 kg", "line 5: Argument `propellant` must be less than the mass, but is 80"),
        ("friction", "frction", "line 7: `frction` is none of"),
        ("2.5 km", "1 km", "line 8: Argument `end` must lie beyond `begin`, 2000 m, but is 1000"),
        (" area = ", " aera = ", "Did you mean area?"),
        ('mass = "300 kg"\n', "", "Argument `speed` must have `mass`"),
        ('"thrust.csv"', '"none.csv"', "none.csv"),
        ('"thrust.csv"', "5", "`thrust` must be"),
        (
            "thrust =",
            'stages = [{ acceleration = "1 g", length = "5 m" }]\nstart = "5 m/s"\nthrust =',
            "must not be given here",
        ),
    ],
)
def test_faults_of_the_table_are_one_line(old, new, words, tmp_path):
    (tmp_path / "thrust.csv").write_text("time [s], thrust [kN]\n0, 60\n2, 60\n2.1, 0\n")
    (tmp_path / "sled.toml").write_text('base = "paper"\n' + TABLE.replace(old, new))
    with pytest.raises((ValueError, OSError), match=re.escape(words)):
        _ = sj.load(tmp_path / "sled.toml").scene


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: sj.model.RocketSled([0.0, 1.0], [1.0, -1.0], mass=1.0),
            "`thrust` must be zero or positive, but is -1 N",
        ),
        (lambda: sled(brakes=[5]), r"`brakes` must be a list of slipperjax.model.WaterBrake\(...\), but is \[5\]"),
    ],
)
def test_bad_sleds_name_what_is_wrong(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_times_of_a_clock_are_refused_and_a_load_cells_noise_is_none(tmp_path):
    for make in (
        lambda: sj.model.RocketSled([1.7e9, 1.7e9 + 1], [9e4, 0.0], mass=300.0),
        lambda: sj.model.TabulatedLoad(np.zeros((2, 3)), time=[1.7e9, 1.7e9 + 1]),
        lambda: sj.SpeedProgramme.over_time([1.7e9, 1.7e9 + 1], [100.0, 110.0]),
    ):
        with pytest.raises(
            ValueError, match=r"`time` must .*not be times of a clock: subtract .*, but is 1700000001 s"
        ):
            make()
    (tmp_path / "thrust.csv").write_text("time [s], thrust [kN]\n-0.5, -0.3\n0, 60\n2, 60\n2.1, -0.1\n")
    sled = sj.model.RocketSled.from_file(tmp_path / "thrust.csv", mass=300.0)
    np.testing.assert_allclose(sled.thrust, [0.0, 6e4, 6e4, 0.0])
    (tmp_path / "thrust.csv").write_text("time [s], thrust [kN]\n0, 60\n2, -60\n2.1, 0\n")
    with pytest.raises(ValueError, match="`thrust` must be zero or positive, but is -60000 N"):
        sj.model.RocketSled.from_file(tmp_path / "thrust.csv", mass=300.0)


def test_motors_in_the_format_of_rasp_are_read(tmp_path):
    file = tmp_path / "motor.eng"
    head = "; Estes D12\nD12 24 70 0-3-5-7 0.0211 0.0426 Estes\n"
    file.write_text(head + "   0.049 2.569\n   0.116 9.369\n 0.20 29.73 ; peak\n   1.7 0.0\n;\n")
    sled = sj.model.RocketSled.from_file(file, mass=0.5)
    # the thrust rises from zero
    np.testing.assert_array_equal(sled.time, [0.0, 0.049, 0.116, 0.2, 1.7])
    np.testing.assert_array_equal(sled.thrust, [0.0, 2.569, 9.369, 29.73, 0.0])
    for text in (head, "0.1 5\n0.2 0\n", head + "0.1 5\n0.2 x\n", head + "0.1 5\n0.2 0\n" + head + "0.1 5\n0.2 0\n"):
        file.write_text(text)
        with pytest.raises(ValueError, match=r"motor\.eng is no RASP file that can be read"):
            sj.model.RocketSled.from_file(file, mass=0.5)
