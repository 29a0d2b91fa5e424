"""Loads and friction against independent evaluations, closed forms, and the balance of energy of a run."""

import dataclasses
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.model import contact_points, contacts, rail_frame, scene_from_toml
from slipperjax.model.dynamics import contact_forces
from slipperjax.model.sliding import tractions
from slipperjax.model.travel import Travel
from slipperjax.solvers.named import resolve_solver

from ..common import among

SCENE = dataclasses.replace(sj.paper_scene(), gravity=9.81)
FAST = sj.SpeedProgramme.over_distance([0.0, 16.0], [1200.0, 1300.0])
LOAD = sj.model.AppliedLoad([0.0, 20.0, -500.0], [1.0, -2.0, 3.0], [-0.02, 0.0, 1e-4], [0.0, 1e-5, 0.0])
LOADED = dataclasses.replace(SCENE, load=LOAD, friction=sj.model.FadingFriction(0.3, 1e6, 0.5), speed=FAST)
POINTS = 20


def some_motion():
    return sj.Motion.from_euler(
        y=2e-4, z=-6e-4, roll=3e-3, pitch=-4e-3, yaw=2e-3, v_y=0.3, v_z=-0.8, w_x=4, w_y=-9, w_z=6
    )


def test_tractions_oppose_the_sliding_in_the_faces():
    """Against cross products and rotation matrices of NumPy and SciPy."""
    m, phase = some_motion(), 0.3
    speed = LOADED.travel(phase).speed
    force = np.linspace(0.0, 4e4, POINTS)

    @jax.jit
    def found(m, force):
        frame = rail_frame(LOADED, phase)
        return frame, contact_points(LOADED), tractions(LOADED.friction, frame, m, force, speed)

    frame, points, ((f_x, f_y, f_z), moment, heat) = found(m, force)
    q = [float(v) for v in (m.q_x, m.q_y, m.q_z)]
    turn = Rotation.from_quat([*q, np.sqrt(1 - np.sum(np.square(q)))])
    spin = np.array([m.w_x, m.w_y, m.w_z], float)
    for k in range(POINTS):
        arm = np.array([a[k] for a in points.arm], float)
        normal = np.array([n[k] for n in frame.normal], float)
        velocity = np.array([speed, m.v_y, m.v_z], float) + turn.apply(np.cross(spin, arm))
        along = velocity - (velocity @ normal) * normal
        size = np.linalg.norm(along)
        traction = -0.3 * (1 + force[k] * size / 1e6) ** -0.5 * along / size
        np.testing.assert_allclose([f_x[k], f_y[k], f_z[k]], traction, rtol=1e-12)
        np.testing.assert_allclose(
            [v[k] for v in moment], np.cross(arm, turn.inv().apply(traction)), rtol=0, atol=1e-15
        )
        assert float(heat[k]) == pytest.approx(-traction @ along, rel=1e-12)


@pytest.mark.parametrize("solver", among({name: name for name in ("ImpulseRK4", "Rodas4")}, "ImpulseRK4"))
def test_what_is_off_adds_no_operation(solver):
    scene = sj.paper_scene()
    state = sj.initial_state(scene, sj.table_2_start())
    of = lambda scene: jax.make_jaxpr(PeriodMap(scene, 4, resolve_solver(scene, solver)))(state)
    plain, off = str(of(scene)), str(of(dataclasses.replace(scene, load=None, friction=None)))
    assert plain == off
    assert len(str(of(dataclasses.replace(scene, friction=sj.model.Coulomb(0.1))))) > len(plain)


def test_loads_push_a_free_slipper():
    scene = dataclasses.replace(sj.paper_scene(clearance=30e-3), load=LOAD, speed=1000.0)
    rates = (
        sj.model.vector_field(scene).evaluate(0.0, sj.initial_state(scene, sj.Motion()), sj.model.Args(scene)).motion
    )
    per_second = [float(v) / float(scene.period) for v in (rates.v_y, rates.v_z, rates.w_x, rates.w_y, rates.w_z)]
    j = np.asarray(scene.slipper.inertia)
    np.testing.assert_allclose(
        per_second, [20 / 14, (-500 + 100) / 14, 1 / j[0], (-2 + 10) / j[1], 3 / j[2]], rtol=1e-12
    )


def at_speed(speed):
    return Travel(jnp.asarray(speed), jnp.asarray(8.0))


def test_tables_are_linear_between_their_rows():
    table = sj.model.TabulatedLoad([[0, 0, 10.0], [-4.0, 0, 30.0]], speed=[100.0, 300.0])
    force, moment = table.wrench(at_speed(150.0))
    np.testing.assert_allclose(force, [-1.0, 0.0, 15.0])
    np.testing.assert_allclose(moment, 0.0)
    np.testing.assert_allclose(table.wrench(at_speed(900.0))[0], [-4.0, 0.0, 30.0])


ROWS = np.array([[0, 0, 10.0], [-4.0, 0, 30.0]])


BAD = {
    "`force` must have one value per speed": lambda: sj.model.TabulatedLoad(ROWS[:1], speed=[1.0, 2.0]),
    "`moment` must have one value per time": lambda: sj.model.TabulatedLoad(ROWS, ROWS[:1], time=[1.0, 2.0]),
    "`force` must go by one of distance, time, speed, but is by none": lambda: sj.model.TabulatedLoad(ROWS),
    "time, speed, but is by time, speed": lambda: sj.model.TabulatedLoad(ROWS, speed=[1, 2], time=[1, 2]),
    "`drag_coefficient` must be one number, or have `mach`": lambda: sj.model.AerodynamicLoad(1.0, [0.1, 0.2]),
    "must have one value per mach": lambda: sj.model.AerodynamicLoad(1.0, [0.1, 0.2], mach=[1.0]),
    "`loads` must be loads such as": lambda: sj.model.SumLoad([sj.model.Coulomb(0.1)]),
}


@pytest.mark.parametrize("words", BAD)
def test_bad_tables_name_what_is_wrong(words):
    with pytest.raises(ValueError, match=words):
        BAD[words]()


def test_drag_and_lift_of_the_air():
    load = sj.model.AerodynamicLoad(0.5, [0.4, 0.8], 0.1, 0.2, mach=[0.5, 1.5], arm=[0.1, 0.0, 0.3], density=1.2)
    pressure = 0.5 * 1.2 * 340.3**2  # at Mach 1, where the drag coefficient is 0.6
    force, moment = load.wrench(at_speed(340.3))
    drag, side, lift = 0.3 * pressure, 0.1 * pressure, 0.05 * pressure
    np.testing.assert_allclose(force, [-drag, side, lift], rtol=1e-14)
    # drag above the centre lifts the nose, and so does lift ahead of it
    np.testing.assert_allclose(moment, [-0.3 * side, -0.3 * drag - 0.1 * lift, 0.1 * side], rtol=1e-14)


@pytest.mark.full
def test_loads_are_added_and_named():
    drag = sj.model.AerodynamicLoad(0.5, 0.4)
    scene = dataclasses.replace(SCENE, load=sj.model.SumLoad([LOAD, drag]))
    here = at_speed(500.0)
    for both, one, other in zip(*(load.wrench(here) for load in (scene.load, LOAD, drag)), strict=True):
        np.testing.assert_array_equal(both, one + other)
    half = scene.replace(**{"load.loads.1.area": 0.25, "load.loads.0.force.2": -300.0})
    assert float(half.value("load.loads.1.area")) == 0.25
    assert float(half.load.loads[0].force[2]) == -300.0
    # more drag takes more drive, and changes nothing else; measured 2e-16
    swept = dict(record=["drive_force", "peak_force"], transient=0, periods=1, steps_per_period=40)
    ds = sj.sweep(scene, {"load.loads.1.area": [0.5, 1.0]}, **swept)
    np.testing.assert_allclose(np.diff(ds["drive_force"].values), 0.5 * 0.4 * 0.5 * 1.225 * 1250.0**2, rtol=1e-12)
    np.testing.assert_array_equal(*ds["peak_force"].values)
    for name, words in (
        ("load.loads.2.area", "must have a number of 0 to 1 in place of '2'"),
        ("load.loads", "leads to no number: load.loads is tuple"),
    ):
        with pytest.raises(ValueError, match=f"`{name}` {words}"):
            scene.replace(**{name: 1.0})


@pytest.mark.parametrize("axis", ["time", "distance"])
def test_loads_by_place_and_time_meet_the_run(axis):
    """The drive along a straight rail balances the load there, at the programme's own times and distances."""
    speed = sj.SpeedProgramme.over_time([0.0, 1.0, 3.0], [100.0, 300.0, 300.0], begin=50.0)
    thrust = sj.model.TabulatedLoad(
        [[0, 0, 0], [1000.0, 0, 0]], **{axis: [0.0, {"time": 4.0, "distance": 1000.0}[axis]]}
    )
    scene = dataclasses.replace(
        sj.paper_scene(clearance=30e-3), track=sj.model.StraightTrack(), speed=speed, load=thrust, window=1.0
    )
    state = sj.initial_state(scene, sj.Motion())
    # a second after the first place it has gone 200 m, and 300 m a second later
    for place, time, mass_times_acceleration in ((150.0, None, 14.0 * 200.0), (550.0, 2.0, 0.0)):
        if time is None:
            time = (-100.0 + np.sqrt(100.0**2 + 2 * 200.0 * 100.0)) / 200.0
        expected = mass_times_acceleration - (250.0 * time if axis == "time" else place)
        drive = sj.model.reactions(0.0, state, sj.model.Args(scene, place)).drive_force
        assert float(drive) == pytest.approx(expected, rel=1e-12)
    for ask in (sj.periodic_orbit, lambda scene: sj.lyapunov_spectrum(scene, 1)):
        with pytest.raises(ValueError, match="`scene` must have a load by the speed alone here"):
            ask(dataclasses.replace(scene, speed=100.0))
    assert float(dataclasses.replace(scene, speed=100.0).travel(550.0).seconds) == 5.5


@pytest.mark.full
def test_the_energy_of_a_run_balances():
    """Kinetic and potential energy against the integral of the power of all forces, over two forcing periods.

    The power is formed in NumPy from forces at both ends of every step, and integrated by Simpson's rule.
    """
    steps = 3200
    run = sj.simulate(LOADED, 2, start=some_motion(), steps_per_period=steps, saves_per_period=steps)
    phases = np.arange(2 * steps + 1) / steps

    @jax.jit
    @jax.vmap
    def forces(phase, state):
        frame = rail_frame(LOADED, phase)
        now = contacts(frame, state.motion)
        force = contact_forces(LOADED, now, state.memory)
        travel = LOADED.travel(phase)
        friction = tractions(LOADED.friction, frame, state.motion, force, travel.speed)
        return force, frame.normal, now.lever, friction, travel.speed, LOADED.load.wrench(travel)

    force, normal, lever, (shear, turn, heat), speed, (push, twist) = jax.tree.map(
        np.asarray, forces(jnp.asarray(phases), run.state)
    )
    m = jax.tree.map(np.asarray, run.state.motion)
    velocity, spin = (m.v_y, m.v_z), (m.w_x, m.w_y, m.w_z)
    power = sum(v * push[:, k + 1] for k, v in enumerate(velocity))
    power = power + sum(w * twist[:, k] for k, w in enumerate(spin))
    # contacts and their friction, without what they do along x, which the drive balances
    along = sum(v[:, None] * (normal[k + 1] + shear[k + 1]) for k, v in enumerate(velocity))
    about = sum(w[:, None] * (lever[k] + turn[k]) for k, w in enumerate(spin))
    power = power + np.sum(force * (along + about), 1)
    j = np.asarray(LOADED.slipper.inertia)
    energy = 7.0 * (m.v_y**2 + m.v_z**2) + 0.5 * (j @ np.square(spin)) + 14.0 * 9.81 * m.z
    pace = power * 8.0 / speed
    work = np.sum((pace[:-2:2] + 4 * pace[1:-1:2] + pace[2::2]) / (3 * steps))
    size = np.sum(np.abs(pace)) / steps
    assert np.max(force) > 1e4
    assert np.sum(force * heat) > 0
    # measured 5e-9 of the energy that flows
    assert abs(energy[-1] - energy[0] - work) < 1e-6 * size


@pytest.mark.full
def test_derivatives_agree_in_both_modes_and_with_differences():
    """By friction, a load, a programme of speeds, and the mass of a sled on springs."""
    sled = sj.model.Payload(100.0, [2e6, 8e6], [0.0, 0.0])
    scene = dataclasses.replace(LOADED, payload=sled)
    names = ("friction.coefficient", "load.force.2", "speed.scale", "speed.speed.1", "payload.mass")
    there = jnp.array([scene.value(name) for name in names])
    state = sj.initial_state(scene, some_motion())

    @jax.jit
    def end(relative):
        changed = scene.replace(**dict(zip(names, there * (1 + relative), strict=True)))
        return PeriodMap(changed, 100, sj.solvers.RK4())(state).motion.w_y

    none, steps = jnp.zeros(5), 1e-5 * jnp.eye(5)
    difference = [(end(step) - end(-step)) / 2e-5 for step in steps]
    assert np.all(np.abs(difference) > 1e-6)
    for mode in (jax.jacfwd, jax.grad):
        np.testing.assert_allclose(mode(end)(none), difference, rtol=1e-4)


FILE = """test 12, bottle 3
t [ms], thrust [lbf], force_z [N], remark
0, 0, 10, ignition
100, 2000, 20,
2000, 1500, 30, burnout
"""


def test_a_load_is_read_from_a_file_with_its_units(tmp_path):
    (tmp_path / "thrust.csv").write_text(FILE)
    with pytest.warns(sj.ImplausibleWarning, match="remark"):
        load = sj.model.TabulatedLoad.from_file(tmp_path / "thrust.csv", arm=[0.0, 0.0, 0.5])
    np.testing.assert_allclose(load.time, [0.0, 0.1, 2.0])
    pound = 0.45359237 * 9.80665
    np.testing.assert_allclose(load.force, [[0, 0, 10], [2000 * pound, 0, 20], [1500 * pound, 0, 30]], rtol=1e-12)
    assert load.moment is None
    text = 'base = "paper"\n[[load]]\ntype = "TabulatedLoad"\nfile = "thrust.csv"\narm = ["0 m", "0 m", "50 cm"]\n'
    (tmp_path / "sled.toml").write_text(text)
    with pytest.warns(sj.ImplausibleWarning, match="remark"):
        scene = sj.load(tmp_path / "sled.toml").scene
    assert eqx.tree_equal(scene.load, sj.model.SumLoad([load]))
    # scenes hold the numbers, and need no file
    assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time [s], lift [N]\n0, 1\n", "no line of names with units"),
        ("time [s], speed [m/s]\n0, 1\n", "must have distance or time or speed, and force_x or force_y"),
        ("time [s], thrust [N]\n0, 1\n0, 2\n", "line 3: time 0 s does not exceed 0 s of line 2"),
        ("time [s], thrust [kg]\n0, 1\n1, 2\n", "line 1: `thrust` must be in a unit like N, but is in 'kg'"),
    ],
)
def test_faults_of_a_file_of_loads_name_the_line(text, words, tmp_path):
    (tmp_path / "thrust.csv").write_text(text)
    with pytest.raises(ValueError, match=re.escape(words)):
        sj.model.TabulatedLoad.from_file(tmp_path / "thrust.csv")
