"""Sleds on several slippers: one slipper is today's, mirror images, closed forms of linear ones, elastic modes."""

import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.model.kinematics import contacts, rail_frame

from ..common import CORNERS, sled_on

PAPER = sj.paper_scene()
BODY = dict(mass=14.0, inertia=(0.051, 0.060, 0.086))
SLED = sled_on()
LEVEL = sj.model.TwoRails(sj.model.StraightTrack(), sj.model.StraightTrack())
SPRINGS = dataclasses.replace(
    PAPER, slipper=SLED, track=LEVEL, contact=sj.model.HertzSpring(1e8), gravity=9.81, speed=100.0
)
WEIGHT = 400.0 * 9.81


def with_mounts(scene, *mounts, **body):
    return dataclasses.replace(scene, slipper=sj.Sled(**(BODY | body), mounts=mounts))


def operations(function, *args):
    """How often each primitive occurs in a program, those inside its loops and calls included."""
    found = collections.Counter()

    def count(jaxpr):
        for equation in jaxpr.eqns:
            found[equation.primitive.name] += 1
            for inner in jax.extend.core.jaxprs_in_params(equation.params):
                count(inner)

    count(jax.make_jaxpr(function)(*args).jaxpr)
    return found


# --- one slipper ----------------------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("more", [{}, {"gravity": 9.81, "friction": sj.model.Coulomb(0.2)}])
def test_one_mount_is_a_slipper_to_the_bit_and_to_the_operation(more):
    scene = dataclasses.replace(PAPER, **more)
    one = with_mounts(scene, sj.Mount())
    state = sj.initial_state(scene, sj.table_2_start())
    step = lambda scene: lambda state: PeriodMap(scene, 100)(state)
    assert operations(step(scene), state) == operations(step(one), state)
    ends = [PeriodMap(which, 100, periods=3)(state) for which in (scene, one)]
    for ours, theirs in zip(*map(jax.tree.leaves, ends), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    loads = [sj.simulate(which, 3, steps_per_period=100).ds["peak_force"] for which in (scene, one)]
    assert loads[1].dims == ("slipper", "end", "point")
    np.testing.assert_array_equal(loads[0].values, loads[1].values[0])


@pytest.mark.full
def test_two_slippers_at_one_place_with_half_the_stiffness_are_one():
    two = with_mounts(PAPER, sj.Mount(rail="left"), sj.Mount(rail="right")).replace(stiffness=0.5e8)
    one, ours = (sj.simulate(scene, 3, steps_per_period=200, solver="RK4").end for scene in (PAPER, two))
    scales = sj.model.MOTION_SCALES
    apart = jax.tree.map(lambda a, b, scale: abs(a - b) / scale, one.motion, ours.motion, scales)
    assert max(jax.tree.leaves(apart)) < 1e-12  # measured 1e-13


def rail(sign, seed):
    """A rail of three waves, mirrored with a sign of -1."""
    lateral, vertical, roll, *phases = np.random.default_rng(seed).normal(size=(6, 3))
    phases = dict(zip(("lateral_phase", "vertical_phase", "roll_phase"), phases, strict=True))
    lateral, vertical, roll = 2e-4 * sign * lateral, 2e-4 * vertical, 1e-3 * sign * roll
    return sj.model.FourierTrack([8.0, 3.1, 1.7], lateral, vertical, roll, **phases)


@pytest.mark.full
def test_mirrored_rails_mirror_the_motion():
    scene = dataclasses.replace(SPRINGS, contact=PAPER.contact, speed=300.0)
    start = sj.Motion(v_y=0.1, v_z=-0.2, w_x=0.1, w_z=0.05)
    mirrored = sj.Motion(v_y=-0.1, v_z=-0.2, w_x=-0.1, w_z=-0.05)
    pair, image = sj.model.TwoRails(rail(1, 1), rail(1, 2)), sj.model.TwoRails(rail(-1, 2), rail(-1, 1))
    run = lambda track, start: sj.simulate(
        dataclasses.replace(scene, track=track), 2, start=start, steps_per_period=400
    )
    one, other = run(pair, start), run(image, mirrored)
    flipped = {"y", "v_y", "q_x", "w_x", "q_z", "w_z"}
    for name in flipped | {"z", "q_y", "v_z", "w_y"}:
        sign = -1 if name in flipped else 1
        ours, theirs = (np.asarray(getattr(motion.state.motion, name)) for motion in (one, other))
        # measured 1e-11 of the greatest
        np.testing.assert_allclose(ours, sign * theirs, rtol=0, atol=1e-10 * np.abs(ours).max(), err_msg=name)
    forces = [motion.ds["peak_force"] for motion in (one, other)]
    # point A on the left is J on the right
    again = forces[1].values[[2, 3, 0, 1], :, ::-1]
    np.testing.assert_allclose(forces[0].values, again, rtol=1e-9)  # measured 2e-13
    assert len(np.unique(np.round(forces[0].max(("end", "point")).values))) == 4


# --- closed forms ---------------------------------------------------------------------------------------------------


def rates_of(scene):
    """Natural frequencies [rad/s] of a sled at rest on level rails, of what its contacts hold."""
    state = sj.initial_state(scene, sj.AtRest())
    flat, unflatten = jax.flatten_util.ravel_pytree(state.motion)
    field, args = sj.model.vector_field(scene), sj.model.Args(scene)
    rates = lambda x: field.evaluate(0.0, sj.State(unflatten(x), state.memory), args).motion
    evaluate = lambda x: jax.flatten_util.ravel_pytree(rates(x))[0]
    eigenvalues = np.linalg.eigvals(np.asarray(jax.jit(jax.jacfwd(evaluate))(flat))) / float(scene.period)
    found = np.sort(eigenvalues.imag)
    return found[found > 1.0]


def contact_stiffness():
    """Of each of the sixteen points on the upper faces, which carry the weight [N/m]."""
    depth = (WEIGHT / 16 / 1e8) ** (2 / 3)
    return 1.5 * 1e8 * np.sqrt(depth), depth


@pytest.mark.full
def test_natural_frequencies_of_a_sled_on_its_contacts():
    k, _ = contact_stiffness()
    # levers of the points of the upper faces, at both ends and on both sides
    x = np.add.outer([1.2, -1.2], [0.1, -0.1]).ravel()
    y = np.add.outer([0.9, -0.9], [0.03, -0.03]).ravel()
    height = -0.2 + 0.013
    heave = np.sqrt(16 * k / 400.0)
    # the weight on contacts below the centre of mass takes from the stiffness of turning
    pitch = np.sqrt((4 * k * np.sum(x**2) + WEIGHT * height) / 300.0)
    roll = np.sqrt((4 * k * np.sum(y**2) + WEIGHT * height) / 150.0)
    # measured 1.4e-7, by the tilt of the faces and what centres the start
    np.testing.assert_allclose(rates_of(SPRINGS), np.sort([heave, pitch, roll]), rtol=1e-6)


def test_natural_frequencies_of_an_elastic_sled():
    k, _ = contact_stiffness()
    shape, own = 0.03, 2 * np.pi * 40.0
    modes = sj.model.Modes([40.0], [0.0], np.broadcast_to([0.0, 0.0, shape], (1, 4, 3)))
    scene = dataclasses.replace(SPRINGS, slipper=dataclasses.replace(SLED, modes=modes))
    # heave and bending together
    stiffness = 16 * k * np.array([[1 / 400.0, shape / np.sqrt(400.0)], [shape / np.sqrt(400.0), shape**2]])
    stiffness[1, 1] += own**2
    both = np.sqrt(np.linalg.eigvalsh(stiffness))
    found = rates_of(scene)
    for rate in both:
        assert np.min(np.abs(found / rate - 1)) < 1e-6  # measured 1.4e-8 and 7e-9


@pytest.mark.full
def test_slippers_share_the_weight_by_their_levers():
    mounts = [sj.Mount(1.0, 0.9, rail="left"), sj.Mount(-0.5, 0.9, rail="left"), sj.Mount(0.2, -0.9, rail="right")]
    sled = dataclasses.replace(SLED, mounts=mounts)
    scene = dataclasses.replace(SPRINGS, slipper=sled)
    force = sj.model.reactions(0.0, sj.initial_state(scene, sj.AtRest()), sj.model.Args(scene)).contact_force
    # of three slippers balance decides: half on the right, the left half by levers about the right one's place
    shares = np.array([0.1 / 1.5 + 0.1, 0.0, 0.5])
    shares[1] = 0.5 - shares[0]
    found = np.asarray(sled.static_shares)
    np.testing.assert_allclose(found @ [1.0, 1.0, 1.0], 1.0)
    np.testing.assert_allclose(found @ [1.0, -0.5, 0.2], 0.0, atol=1e-12)
    np.testing.assert_allclose(sled.static_shares[2], 0.5)
    # measured 4.3e-3: within a slipper, forces have their centre off its middle
    np.testing.assert_allclose(np.asarray(force).sum((1, 2)) / WEIGHT, sled.static_shares, atol=6e-3)
    np.testing.assert_allclose(SLED.static_shares, 0.25)


@pytest.mark.full
def test_a_beam_sags_between_its_slippers():
    """Beside Euler and Bernoulli's static deflection of a uniform beam on two supports."""
    a, length, stiffness = 1.2, 4.0, 1e5
    modes = sj.model.Modes.beam(
        [x for x, *_ in CORNERS],
        mass=400.0,
        length=length,
        stiffness=(1e12, stiffness),
        count=60,
        places=[[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]],
    )
    scene = dataclasses.replace(SPRINGS, slipper=dataclasses.replace(SLED, modes=modes))
    bent = sj.initial_state(scene, sj.AtRest()).motion.modes.coordinate
    middle, support = np.einsum("m,mpk->pk", np.asarray(bent), np.asarray(modes.place_shapes))[:, 2]
    x = np.linspace(0.0, a, 20001)
    moment = WEIGHT / 2 * (a - x) - WEIGHT / length / 2 * (length / 2 - x) ** 2
    exact = np.trapezoid((a - x) * moment / stiffness, x)
    # measured 8e-6 with thirty symmetric modes, 2.5e-4 with ten
    np.testing.assert_allclose(support - middle, exact, rtol=2e-5)


WHEELBASE = 2.4


def answer(length, coordinate):
    """Amplitude of heave [m] or pitch [rad] of a tandem sled on a vertical sine of 1 um, at 10 Hz."""
    mounts = [sj.Mount(WHEELBASE / 2, rail="left"), sj.Mount(-WHEELBASE / 2, rail="left")]
    body = sj.Sled(mass=400.0, inertia=(150.0, 300.0, 350.0), mounts=mounts, length=0.02)
    track = sj.model.FourierTrack([length], [0.0], [1e-6])
    # dampers let the start's oscillations die, and all is closed by gravity
    contact = sj.model.ConstantDamping(1e9, hysteresis=5.0)
    scene = dataclasses.replace(SPRINGS, slipper=body, track=track, contact=contact, speed=10.0 * length)
    run = sj.simulate(scene, 30, start="rest", steps_per_period=400, saves_per_period=40)
    last = getattr(run.ds, coordinate).values[-40:]
    return 2 * np.abs(np.fft.fft(last)[1]) / 40


@pytest.mark.full
def test_wheelbases_filter_waves():
    """Heave answers a sine of length l by cos(2 pi a / l), pitch by sin(2 pi a / l), of slippers at +-a."""
    a = WHEELBASE / 2
    heaves = {length: answer(length, "z") for length in (40.0, 7.0, 4 * a, 2.9)}
    pitches = {length: answer(length, "pitch") for length in (7.0, 2 * a, 2.9)}
    for length, heave in heaves.items():
        expected = np.abs(np.cos(2 * np.pi * a / length) / np.cos(2 * np.pi * a / 40.0))
        np.testing.assert_allclose(heave / heaves[40.0], expected, atol=2e-3)  # measured 3e-4
    assert heaves[4 * a] < 1e-3 * heaves[40.0]  # 60 dB: measured 2e-5
    for length, pitch in pitches.items():
        expected = np.abs(np.sin(2 * np.pi * a / length) / np.sin(2 * np.pi * a / 7.0))
        np.testing.assert_allclose(pitch / pitches[7.0], expected, atol=2e-3)
    assert pitches[2 * a] < 1e-3 * pitches[7.0]


# --- elastic modes --------------------------------------------------------------------------------------------------


def test_beams_have_the_modes_of_textbooks():
    modes = sj.model.Modes.beam([0.0, 1.0], mass=200.0, length=3.0, stiffness=(4e6, 1e6), count=3)
    # roots of cos(x) cosh(x) = 1: 4.730041 and 7.853205, Blevins 1979, Table 8-1
    first, second = (x**2 / (2 * np.pi * 9.0) * np.sqrt(1e6 * 3.0 / 200.0) for x in (4.730041, 7.853205))
    np.testing.assert_allclose(modes.frequency, [first, 2 * first, second], rtol=1e-6)
    # the first one's middle, -1.2157 of the end's 2 for a mean square of one
    np.testing.assert_allclose(modes.shapes[0, 0], [0.0, -1.21566 / np.sqrt(200.0)], rtol=1e-4)
    np.testing.assert_allclose(modes.shapes[1, 0], [-1.21566 / np.sqrt(200.0), 0.0], rtol=1e-4)
    np.testing.assert_allclose(modes.shapes[2, 0], 0.0, atol=1e-15)
    with pytest.raises(ValueError, match=r"`places_of_mounts` must lie on the beam, within 1\.5 m of its middle"):
        sj.model.Modes.beam([2.0], mass=200.0, length=3.0, stiffness=1e6)


BEAM = sj.model.Modes.beam(
    [x for x, *_ in CORNERS], mass=400.0, length=4.0, stiffness=(2e6, 1e6), count=4, damping=0.0
)
ELASTIC = dataclasses.replace(SLED, modes=BEAM)


def energy(scene, state):
    """Of a sled on springs [J]: kinetic, elastic and of gravity."""
    m, body = state.motion, scene.slipper
    depth = jnp.maximum(-contacts(rail_frame(scene, 0.0), m).gap, 0.0)
    of_modes = jnp.sum(m.modes.rate**2 + (2 * jnp.pi * body.modes.frequency * m.modes.coordinate) ** 2)
    turning = sum(j * w**2 for j, w in zip(body.inertia, (m.w_x, m.w_y, m.w_z), strict=True))
    moving = body.mass * (m.v_y**2 + m.v_z**2) + turning + of_modes
    return 0.5 * moving + body.mass * 9.81 * m.z + 0.4 * 1e8 * jnp.sum(depth**2.5)


@pytest.mark.full
@pytest.mark.parametrize("solver", ["ImpulseRK4", "RK4", "Tsit5"])
def test_elastic_sleds_keep_their_energy(solver):
    scene = dataclasses.replace(SPRINGS, slipper=ELASTIC)
    state = sj.initial_state(scene, sj.Motion(v_z=-0.3, v_y=0.2, w_x=0.3))
    end = sj.period_map(scene, state, periods=3, steps_per_period=3000, solver=solver)
    assert float(jnp.max(jnp.abs(end.motion.modes.coordinate))) > 1e-3
    # measured 2e-9, 3e-8, 1e-8
    np.testing.assert_allclose(energy(scene, end), energy(scene, state), rtol=1e-6)


@pytest.mark.full
def test_states_with_modes_are_rows_and_come_back():
    rigid = sj.initial_state(SPRINGS, sj.AtRest())
    assert rigid.motion.modes is None
    assert sj.model.StateLayout.of(SPRINGS).size == 10
    scene = dataclasses.replace(SPRINGS, slipper=ELASTIC, contact=PAPER.contact)
    state = sj.initial_state(scene, sj.AtRest(v_z=0.1))
    layout = sj.model.StateLayout.of(scene)
    again = layout.unpack(layout.pack(state))
    for one, other in zip(*map(jax.tree.leaves, (again, state)), strict=True):
        np.testing.assert_array_equal(one, other)
    names = [q.name for q in layout.numbers]
    assert names[10:12] == ["mode_1", "mode_2"]
    assert (names[14], names[18]) == ("mode_rate_1", "memory_left1_A1")
    with pytest.raises(ValueError, match="explicit one for a scene with a sled on springs or elastic modes"):
        sj.simulate(scene, 1, solver="Rodas4", steps_per_period=10)


@pytest.mark.full
def test_derivatives_in_both_modes():
    """By places of mounts, a mode's damping and the play, against central differences."""
    names = ("slipper.mounts.0.x", "slipper.mounts.1.z", "slipper.modes.damping.0", "clearance")
    damped = dataclasses.replace(ELASTIC, modes=dataclasses.replace(BEAM, damping=[0.01] * 4))
    track = sj.model.TwoRails(rail(1, 1), rail(1, 2))
    scene = dataclasses.replace(SPRINGS, slipper=damped, contact=PAPER.contact, track=track, speed=300.0)
    state = sj.initial_state(scene, sj.Motion(v_z=-0.2))

    @jax.jit
    def end(values):
        changed = scene.replace(**dict(zip(names, values, strict=True)))
        return PeriodMap(changed, 400, sj.solvers.RK4())(state).motion.w_y

    values = jnp.array([scene.value(name) for name in names])
    steps = np.diag([1e-6, 1e-6, 1e-6, 1e-9])
    difference = [(end(values + h) - end(values - h)) / (2 * h.sum()) for h in steps]
    for slope in (jax.jacfwd(end)(values), jax.grad(end)(values)):
        np.testing.assert_allclose(slope, difference, rtol=1e-4)


# --- bad input ------------------------------------------------------------------------------------------------------


OVERLAP = "`mounts` must not overlap on a rail, but is slipper1 and"
FAR_FROM_RAILS = (
    r"must be within their play, 0\.0005 m, of the rails, whose gauge is 1\.5 m, but is left1 at y = 0\.9 m"
)
BAD = {
    OVERLAP: lambda: with_mounts(PAPER, sj.Mount(0.1), sj.Mount(0.0)),
    "`mounts` must be one slipperjax.Mount": lambda: sj.Sled(**BODY, mounts=[]),
    "`track` must be one rail for a Slipper": lambda: dataclasses.replace(SPRINGS, slipper=PAPER.slipper),
    "`mounts` must be on the rails left, right": lambda: with_mounts(SPRINGS, sj.Mount(rail="centre")),
    FAR_FROM_RAILS: lambda: dataclasses.replace(SPRINGS, track=dataclasses.replace(LEVEL, gauge=1.5)),
    "`mounts` must be on the side of their rail": lambda: with_mounts(SPRINGS, sj.Mount(y=-1.0, rail="left")),
    "`modes` must have shapes at each of the 4 mounts, but has shapes at 3": lambda: sled_on(modes=modes_at(3)),
    "`frequency` must rise from mode to mode": lambda: sj.model.Modes([40.0, 30.0], [0.01] * 2, np.zeros((2, 4, 3))),
    "`inertia` must be positive": lambda: sled_on(inertia=(0.0, 1.0, 1.0)),
    "`damping` must have one value per mode": lambda: sj.model.Modes([40.0], [0.01, 0.02], np.zeros((1, 4, 3))),
}


def modes_at(places):
    return sj.model.Modes([40.0], [0.01], np.zeros((1, places, 3)))


@pytest.mark.parametrize("text", BAD)
def test_bad_input_is_refused_in_one_line(text):
    with pytest.raises(ValueError, match=text):
        BAD[text]()


def test_runs_end_before_the_foremost_slipper_leaves_the_rail():
    rails = [sj.model.SampledTrack([0.0, 50.0], np.zeros(100), np.zeros(100), ends="error") for _ in range(2)]
    scene = dataclasses.replace(SPRINGS, track=sj.model.TwoRails(*rails))
    with pytest.raises(ValueError, match=r"`length` must end before the rail does at 50 m, but is 50\.2"):
        sj.run(scene, length=49.0)
