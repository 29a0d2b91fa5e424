"""Odd inputs, as careless users give them: wrong units, wrong types, wrong counts, wrong names.

Each ends in one line that names the argument, in an `ImplausibleWarning` with value and plausible range, in a status
other than 0, or in the right number. None is silent, and none ends in another kind of exception.
"""

import re
import warnings

import diffrax
import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.sweeps.follow import find_jump

from .commands import error_of

NAN, INF = float("nan"), float("inf")
PAPER = sj.paper_scene()
POINTS = np.asarray(PAPER.section.points)
PLAY = np.full(5, 5e-4)
FACES = (("J", "A"), ("B", "C"), ("D", "E"), ("F", "G"), ("H", "I"))
REST = sj.Motion()
AT = {"speed": [1250.0]}
SHORT = dict(transient=0, periods=10, steps_per_period=100)
"""Options of short runs, which share their programs with test_cli."""


def slipper(**values):
    return sj.Slipper(**(dict(mass=14.0, inertia=(0.051, 0.060, 0.086), length=0.2) | values))


def section(**values):
    return sj.Section(**(dict(points=POINTS, play=PLAY) | values))


def scene(**parts):
    track = sj.HarmonicTrack((8.0,), 1e-3, 3e-3)
    default = dict(speed=1250.0, slipper=slipper(), section=section(), track=track, contact=sj.Flores(1e8, 0.9))
    return sj.Scene(**(default | parts))


def simulate(case=PAPER, **options):
    return sj.simulate(case, **(dict(periods=3, steps_per_period=50) | options))


def started(**coordinates):
    return simulate(start=sj.Motion(**coordinates))


def period_map(case=PAPER, **options):
    return sj.period_map(case, sj.initial_state(PAPER, REST), **(dict(periods=1, steps_per_period=50) | options))


def sweep(grid=AT, case=PAPER, **options):
    return sj.sweep(case, grid, **(SHORT | options))


def follow(path=AT, case=PAPER, **options):
    return sj.follow(case, path, **(SHORT | options))


def jump(path=AT, case=PAPER, **options):
    return find_jump(case, path, **(SHORT | options))


def spectrum(case=PAPER, **options):
    return sj.lyapunov_spectrum(case, **(SHORT | dict(align=0) | options))


def exponents(grid=AT, case=PAPER, **options):
    return sj.lyapunov_sweep(case, grid, **(SHORT | dict(transient=20, certify=False) | options))


def given(make, /, **values):
    """A row's label, the same in every process, and its call: `make` with `values`."""
    text = ", ".join(f"{name}={value!r}" for name, value in values.items())
    label = f"{make.__name__}({text})" if values else ""
    return re.sub(r" at 0x\w+|\s+(?=\s)|\n", "", label)[:90], lambda: make(**values)


def refused(words, make, /, **values):
    """A row of errors: the call `make(**values)`, and words of its one line."""
    label, call = given(make, **values)
    return label or words, call, words


COUNTED = [
    *((simulate, "periods", value, shown) for value, shown in ((-1, "-1"), (True, "True"), ("3", "'3'"))),
    *((make, "periods", 2.5, "2.5") for make in (period_map, sweep)),
    *((make, "steps_per_period", 2.5, "2.5") for make in (simulate, jump)),
    *((make, "count", True, "True") for make in (spectrum, exponents)),
    *((make, "transient", -1, "-1") for make in (sweep, spectrum, exponents)),
    (spectrum, "align", "3", "'3'"),
    (sweep, "chunk", -1, "-1"),
    (simulate, "probe", -1, "-1"),
]
"""Whole numbers that are wrong, and how errors show them."""

ERRORS = [
    # counts
    *(
        refused(rf"`{name}` must be a whole number of \d+ or more, but is {shown}", make, **{name: value})
        for make, name, value, shown in COUNTED
    ),
    refused("`periods` must be a whole number of 1 or more, but is None", simulate, periods=None),
    refused("`count` must be a whole number of 1 or more, but is None", spectrum, count=None),
    refused("`count` must be at most 10", spectrum, count=11),
    refused("`steps_per_period` must be a whole number", sweep, steps_per_period=[50.0]),
    refused("`steps_per_period` must have one number or one for each case", sweep, steps_per_period=[50, 50]),
    refused("`saves_per_period` must divide steps_per_period = 100", sweep, record="history", saves_per_period=7),
    # parameters of the scene
    refused("`speed` must be positive, but is None", sj.paper_scene, speed=None),
    refused("`speed` must be positive, but is True", sj.paper_scene, speed=True),
    refused("`speed` must be positive, but is inf", sj.paper_scene, speed=INF),
    refused(r"`speed` must be of shape \(\), but has shape \(2,\)", sj.paper_scene, speed=[1.0, 2.0]),
    refused("`speed` must be positive, but is '4500 km/h', not a number in m/s.", sj.paper_scene, speed="4500 km/h"),
    refused("`speed` must be positive, but is '1250'", sweep, grid={"speed": "1250"}),
    refused(r"`speed` must be positive, but is \(1\+2j\)", sj.paper_scene, speed=1 + 2j),
    refused("`restitution` must be above 0 and at most 1, but is 90", sj.paper_scene, restitution=90.0),
    refused("`amplitude` must be zero or positive, but is inf", sj.paper_scene, amplitude=INF),
    refused(
        "`roll_amplitude` must be zero or positive, but is '0.2 degrees'",
        sj.paper_scene,
        roll_amplitude="0.2 degrees",
    ),
    refused("`wavelengths` must be a sequence of one or more", sj.paper_scene, wavelengths=8.0),
    refused("`wavelengths` must be a sequence of one or more", sj.paper_scene, wavelengths=[[8.0]]),
    refused("`wavelengths` must be positive, but is -8 m", sj.paper_scene, wavelengths=(-8.0,)),
    refused("`clamp` must be True or False, but is 'no'", sj.paper_scene, clamp="no"),
    refused("`memory` must be .*, but is 'smooth'", sj.paper_scene, memory="smooth"),
    refused("`memory` must be .*, but is <class", sj.paper_scene, memory=sj.SmoothSwitch),
    # parts of the scene
    refused("`inertia` must be positive, but is 0", slipper, inertia=np.diag([0.05, 0.06, 0.09])),
    refused(r"`inertia` must be of shape \(3\), but has shape \(4,\)", slipper, inertia=(1.0, 1.0, 1.0, 1.0)),
    refused("`gravity` must be zero or positive, but is -9.81", scene, gravity=-9.81),
    refused("`gravity` must be zero or positive, but is nan", scene, gravity=NAN),
    refused("`slipper` must be .*Slipper, but is None", scene, slipper=None),
    refused("`track` must be .*, but is 'straight'", scene, track="straight"),
    refused("`contact` must be .*, but is <class", scene, contact=sj.Flores),
    refused("`points` must be in an order in which the faces' normals point out", section, points=POINTS[::-1]),
    refused("`points` must have two different corners", section, points=np.zeros((10, 2)) + POINTS[0]),
    refused("`points` must have two points per face", section, points=POINTS.T),
    refused("`points` must be of shape", section, points=POINTS[:, [0, 1, 1]]),
    refused("`points` must ", section, points=0.05),
    refused("`points` must be finite, but is", section, points=[[1, 2], [3]]),
    refused("`points` must be finite, but is nan", section, points=np.where(POINTS > 0.04, NAN, POINTS)),
    refused("`play` must have one value per face", section, play=1e-3),
    refused("`play` must be zero or positive, but is -0.0005", section, play=-PLAY),
    refused("`names` must ", section, names=None),
    refused("`names` must ", section, names=("A", "A", *"CDEFGHIJ")),
    refused("`faces` must ", section, faces=5),
    refused("`faces` must ", section, faces=(("J", "A", "B"), *FACES[1:])),
    refused("`faces` must ", section, faces=(FACES[0], FACES[0], *FACES[2:])),
    refused("`faces` must name points, but is [(]'Z'", section, faces=(("Z", "A"), *FACES[1:])),
    refused("`stiffness` must be positive, but is inf", sj.HuntCrossley, stiffness=INF, restitution=0.9),
    refused("`restitution` must be above 0", sj.LankaraniNikravesh, stiffness=1e8, restitution=0.0),
    refused("`hysteresis` must be zero or positive, but is -1", sj.ConstantDamping, stiffness=1e8, hysteresis=-1.0),
    refused("`reference_length` must be positive, but is 0", sj.StraightTrack, reference_length=0.0),
    refused("`slowest` must be positive, but is 0", sj.EventLatch, slowest=0.0),
    refused("`width` must be positive, but is 0", sj.SmoothSwitch, width=0.0),
    refused("`relaxation` must be positive, but is nan", sj.SmoothSwitch, relaxation=NAN),
    # other values of named parameters
    refused("`sped` is no parameter; the names are speed", PAPER.replace, sped=1.0),
    refused("`wavelengths` is no parameter", PAPER.replace, wavelengths=(8.0,)),
    refused("`gravity` must be zero or positive, but is -9.81", PAPER.replace, gravity=-9.81),
    refused("`amplitude` must be zero or positive, but is -0.001", PAPER.replace, amplitude=-1e-3),
    refused("`mass` must be positive, but is None", PAPER.replace, mass=None),
    refused("`speed` must be ", PAPER.replace, speed=[]),
    refused("`stiffness` must be positive, but is 'hard'", PAPER.replace, stiffness="hard"),
    refused("is no parameter; the names are", PAPER.value, name=None),
    # defaults of scenes whose units are wrong
    refused(
        "`steps_per_period` must be given: the default would be", sj.simulate, scene=PAPER.replace(restitution=1e-6)
    ),
    refused(
        "`steps_per_period` must be given: the default would be",
        lambda: sj.simulate(sj.paper_scene(wavelengths=(8e6,)), 1),
    ),
    # starts
    refused("`start` must be a slipperjax.Motion, a .* but is .*y", simulate, start={"y": 0.0}),
    refused("`start` must be a slipperjax.Motion, a .* but is", simulate, start=np.zeros(10)),
    refused("`start` must be a slipperjax.Motion, a .* but is", sweep, start=sj.Motion),
    refused("`start` must be a slipperjax.Motion, a .* but is 'rest'", follow, start="rest"),
    refused("`start` must be a slipperjax.Motion, a .* but is", jump, start=[0.0] * 10),
    refused("`start` must be a slipperjax.Motion, a .* but is", spectrum, start=PAPER),
    refused("`start` must be finite, but its w_y is inf", started, w_y=INF),
    refused("`start` must be .* its y is 'left'", started, y="left"),
    refused("`start` must be .* its v_z is", started, v_z=[0.5, 0.5]),
    refused("`start` must be .* its q_x is 'x'", sweep, start=sj.Motion(q_x="x")),
    refused("`start` must be .* its y is", spectrum, start=sj.Motion(y=np.zeros(1))),
    refused("`start` must be finite, but its q_", lambda: simulate(start=sj.Motion.from_euler(pitch=NAN))),
    refused("`pitch` must be ", sj.Motion.from_euler, pitch="level"),
    refused("`motion` must be .*", lambda: sj.initial_state(PAPER, None)),
    refused("`motion` must be finite", lambda: sj.initial_state(PAPER, sj.Motion(y=NAN))),
    refused("`state` must be .*, but is None", lambda: sj.period_map(PAPER, None, steps_per_period=50)),
    refused("`state` must be .*, but is Motion", lambda: sj.period_map(PAPER, REST, steps_per_period=50)),
    # no scenes
    refused("`scene` must be a slipperjax.Scene, but is None", simulate, case=None),
    refused("`scene` must be a slipperjax.Scene, but is 'paper'", simulate, case="paper"),
    refused("`scene` must be a slipperjax.Scene, but is", sweep, case=[PAPER]),
    refused("`scene` must be a slipperjax.Scene, but is", follow, case=slipper()),
    refused("`scene` must be a slipperjax.Scene, but is 3", jump, case=3),
    refused("`scene` must be a slipperjax.Scene, but is {}", spectrum, case={}),
    refused("`scene` must be a slipperjax.Scene, but is", exponents, case=sj.Scene),
    refused("`scene` must be a slipperjax.Scene, but is None", period_map, case=None),
    refused("`scene` must be a slipperjax.Scene, but is None", sj.default_steps_per_period, scene=None),
    refused("`scene` must be a slipperjax.Scene, but is None", sj.initial_state, scene=None, motion=REST),
    # solvers, controllers, other options
    refused("`solver` must be a solver, as in RK4.*, but is the class", simulate, solver=sj.RK4),
    refused("`solver` must be a diffrax solver or the name of one, but is 4", sweep, solver=4),
    refused("`solver` must be one of RK4, .* but is 'rk4'", follow, solver="rk4"),
    refused(
        "`solver` must be a one-step method .* but is SemiImplicitEuler", simulate, solver=diffrax.SemiImplicitEuler()
    ),
    refused("`solver` must be a one-step method .* but is NoneType", sj.Latching, solver=None),
    refused("`solver` must be one with an error estimate", simulate, stepsize_controller=sj.AdaptiveSteps()),
    refused("`stepsize_controller` must be a diffrax controller", simulate, stepsize_controller=sj.AdaptiveSteps),
    refused("`stepsize_controller` must be a diffrax controller, but is 'a'", period_map, stepsize_controller="a"),
    refused(
        "`adjoint` must be .*, but is 'forward'",
        simulate,
        solver=sj.Tsit5(),
        stepsize_controller=sj.AdaptiveSteps(),
        adjoint="forward",
    ),
    refused("`tolerance` must be positive, but is nan", sj.AdaptiveSteps, tolerance=NAN),
    refused("`tolerance` must be positive, but is 'fine'", sj.AdaptiveSteps, tolerance="fine"),
    refused("`touchdown` must be positive, but is 0", sj.AdaptiveSteps, touchdown=0.0),
    refused("`per_contact` must be positive, but is '4'", sj.AdaptiveSteps, per_contact="4"),
    refused("`shortest` must be positive, but is -1", sj.AdaptiveSteps, shortest=-1.0),
    refused("`scales` must be ", sj.AdaptiveSteps, scales=None),
    refused("`rho_inf` must be from 0 to 1, but is nan", sj.TwoStep, rho_inf=NAN),
    refused("`tolerance` must be positive, but is None", sj.TwoStep, tolerance=None),
    refused("`iterations` must be a whole number of 1 or more, but is 2.5", sj.TwoStep, iterations=2.5),
    refused("`loads` must be True or False, but is 'no'", simulate, loads="no"),
    refused("`probe` must be 0 under jit", lambda: jax.jit(lambda v: simulate(PAPER.replace(speed=v), probe=1))(9.0)),
    refused("`steps_per_period` must be", lambda: jax.jit(lambda n: simulate(steps_per_period=n))(50)),
    # grids
    refused("`grid` must name one or more parameters with their values, but is None", sweep, grid=None),
    refused("`grid` must name one or more parameters", sweep, grid=["speed"]),
    refused("`grid` must have lists of one length", sweep, grid=AT | {"length": [0.2, 0.3]}, product=False),
    refused("`speed` must have a list of one or more values", sweep, grid={"speed": [[1250.0, 1300.0]]}),
    refused("`speed` must have a list of one or more values", exponents, grid={"speed": []}),
    refused("`speed` must be positive, but is nan", sweep, grid={"speed": [1250.0, NAN]}),
    refused("`speed` must be positive, but is .*fast", exponents, grid={"speed": ["fast"]}),
    refused("`speed` must be positive, but is {1250.0}", sweep, grid={"speed": {1250.0}}),
    refused("`speed` must be positive, but is None", sweep, grid={"speed": None}),
    refused("`Speed` is no parameter", sweep, grid={"Speed": [1250.0]}),
    refused("`1` is no parameter", sweep, grid={1: [1250.0]}),
    refused("`roll` is no parameter", sweep, grid={"roll": [0.1]}),
    refused("`start_y` is no parameter", sweep, grid={"start_y": [0.0]}),
    refused("`y` must be finite, but is nan", sweep, grid={"y": [NAN]}),
    refused("`restitution` must be above 0 and at most 1, but is 1.5", sweep, grid={"restitution": [0.9, 1.5]}),
    refused("`product` must be True or False, but is 'no'", sweep, product="no"),
    refused("`record` must be one of sections, strobe, history, .*but is 'section'", sweep, record="section"),
    refused("`record` must give each variable once, but gives `strobe`", follow, record=["sections", "strobe"]),
    refused("`record` must name at least one of sections", follow, record=[]),
    # paths
    refused("`path` must name one parameter with increasing values", follow, path={"speed": [1300.0, 1250.0]}),
    refused("`path` must name one parameter with increasing values", follow, path={"speed": [1250.0, 1250.0]}),
    refused("`path` must name one parameter with increasing values", follow, path=AT | {"length": [0.2]}),
    refused("`path` must name one parameter with increasing values", follow, path={"y": [0.0]}),
    refused("`path` must name one parameter with increasing values", jump, path={"speed": [1300.0, 1250.0]}),
    refused("`path` must name one parameter", jump, path=None),
    refused("`direction` must be one of up, down, but is 'left'", jump, direction="left"),
    refused("`within` must be positive, but is 0", jump, within=0.0),
    refused("`within` must be .*, but ", jump, within=[1.0, 2.0]),
    refused("`threshold` must be positive, but is 'low'", jump, threshold="low"),
]


@pytest.mark.parametrize(("label", "call", "words"), ERRORS, ids=[row[0] for row in ERRORS])
def test_errors_are_one_line_that_names_the_argument(label, call, words):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.ImplausibleWarning)
        with pytest.raises(ValueError, match=words) as caught:
            call()
    text = str(caught.value)
    assert text.startswith(("Argument ", "Option ")), label
    assert "\n" not in text, label


UNIT = r"`{}` is {}.*; plausible are .* to .*\. Is the unit right\?"


def implausible(name, shown, make, /, **values):
    """A row of warnings: the call, the argument's name, and its value as the warning shows it."""
    label, call = given(make, **values)
    return label or f"{name} {shown}", call, UNIT.format(name, shown)


def outside(case=PAPER, **coordinates):
    return sj.initial_state(case, sj.Motion(**coordinates))


WARNINGS = [
    # millimetres, degrees, grams and the like
    implausible("length", "200 m", sj.paper_scene, length=200.0),
    implausible("clearance", "1 m", sj.paper_scene, clearance=1.0),
    implausible("amplitude", "1 m", sj.paper_scene, amplitude=1.0),
    implausible("roll_amplitude", "0.2 rad", sj.paper_scene, roll_amplitude=0.2),  # the paper's value in degrees
    implausible("speed", r"1.25e\+06 m/s", sj.paper_scene, speed=1.25e6),
    implausible("speed", "1e-300 m/s", sj.paper_scene, speed=1e-300),
    implausible("stiffness", "3162.28 N/m", sj.paper_scene, stiffness=1e8 / 10**4.5),
    implausible("wavelengths", "8000 m", sj.paper_scene, wavelengths=(8000.0,)),
    implausible("wavelengths", "0.008 m", sj.paper_scene, wavelengths=(8e-3,)),
    implausible("reference_length", "1e-300 m", sj.StraightTrack, reference_length=1e-300),
    implausible("gravity", "9810 m/s", scene, gravity=9810.0),
    implausible("mass", r"1.4e\+07 kg", lambda: scene(slipper=slipper(mass=14e6))),
    implausible("inertia", "86000 kg", lambda: scene(slipper=slipper(inertia=(51e3, 60e3, 86e3)))),
    implausible("points", "48 m", section, points=POINTS * 1e3),
    implausible("points", "4.8e-05 m", section, points=POINTS * 1e-3),
    (*given(section, points=POINTS + np.array([0.0, 0.1])), "`points` has its origin, .* outside of the section"),
    implausible("speed", "1.25 m/s", sj.paper_scene, speed=1.25),  # in km/s
    (
        "grams",
        lambda: scene(slipper=slipper(mass=14e3, inertia=(51, 60, 86))),
        "`mass` is 14000 kg; plausible are 0.1",
    ),
    (
        "an inertia in g m^2",
        lambda: scene(slipper=slipper(inertia=(51, 60, 86))),
        "radius of gyration of .* slipper lengths",
    ),
    ("a fourth of a body", lambda: slipper(inertia=(0.05, 0.06, 0.2)), "`inertia` has a moment greater than the sum"),
    implausible("mass", "14000 kg", PAPER.replace, mass=14e3),
    implausible("width", "1 m", sj.SmoothSwitch, width=1.0),
    implausible("relaxation", "1 s", sj.SmoothSwitch, relaxation=1.0),
    implausible("slowest", "1000 m/s", sj.SmoothSwitch, slowest=1e3),
    implausible("slowest", "1000 m/s", sj.EventLatch, slowest=1e3),
    # other values of named parameters
    implausible("length", "200 m", PAPER.replace, length=200.0),
    implausible("speed", "0.001 m/s", PAPER.replace, speed=[1250.0, 1e-3]),
    # grids are looked at before they run, here until a wrong count
    implausible("clearance", "2 m", lambda: stopped(sweep, {"clearance": [1.0, 2.0]})),
    implausible("y", "1 m", lambda: stopped(sweep, {"y": [1.0]})),
    implausible("v_y", "500 m/s", lambda: stopped(sweep, {"v_y": [500.0]})),
    implausible("length", "200 m", lambda: stopped(follow, {"length": [200.0]})),
    implausible("amplitude", "2 m", lambda: stopped(exponents, {"amplitude": [1.0, 2.0]})),
    # starts outside the play
    (*given(outside, y=1.0), "start lies outside the play"),
    # one, though a batch has eight
    ("a start of a sweep", lambda: sweep(start=sj.Motion(y=5e-3)), "^A start lies outside the play"),
    (*given(outside, z=5e-3), "start lies outside the play"),
    (*given(outside, q_x=2.0), "start lies outside the play"),
    ("a pitch in degrees", lambda: sj.initial_state(PAPER, sj.Motion.from_euler(pitch=5.0)), "start lies outside"),
    (*given(outside, case=PAPER.replace(clearance=0.0), y=8e-3), "start lies outside the play"),
]


def stopped(run, grid, wrong="steps_per_period"):
    with pytest.raises(ValueError, match=f"`{wrong}` must be"):
        run(grid, **{wrong: 0})


@pytest.mark.parametrize(("label", "call", "words"), WARNINGS, ids=[row[0] for row in WARNINGS])
def test_wrong_units_are_warned_of(label, call, words):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    found = [str(warning.message) for warning in caught]
    assert {warning.category for warning in caught} == {sj.ImplausibleWarning}, label
    assert any(re.search(words, text) for text in found), found


STATUSES = [
    (*given(started, v_y=1e6), Status.NOT_FINITE),
    (*given(started, w_x=1e5), Status.NOT_FINITE),
    (*given(started, q_x=2.0), Status.NOT_FINITE),
    (*given(started, y=1.0), Status.PRESSED_IN),
    (*given(started, v_y=500.0), Status.PRESSED_IN),
    (*given(simulate, case=PAPER.replace(clearance=0.04)), Status.NO_CONTACT),
    ("a clearance in mm", lambda: simulate(sj.paper_scene(clearance=1.0)), Status.NO_CONTACT),
    ("a huge amplitude", lambda: simulate(sj.paper_scene(amplitude=1e300)), Status.NO_CONTACT),
    ("a roll of 90 degrees", lambda: simulate(sj.paper_scene(roll_amplitude=1.6)), Status.NOT_FINITE),
    (*given(simulate, case=PAPER.replace(stiffness=1e13)), Status.UNRESOLVED),
    (*given(simulate, case=PAPER.replace(restitution=1e-3)), Status.UNRESOLVED),
    ("a small mass", lambda: simulate(PAPER.replace(mass=0.01)), Status.UNRESOLVED),
    (*given(simulate, steps_per_period=1), Status.UNRESOLVED),
    ("strong damping", lambda: simulate(scene(contact=sj.ConstantDamping(1e8, 1e5))), Status.NOT_FINITE),
    ("a sweep of a clearance in mm", lambda: sweep(case=sj.paper_scene(clearance=1.0)), Status.NO_CONTACT),
    (*given(sweep, case=PAPER.replace(stiffness=1e13)), Status.UNRESOLVED),
]


@pytest.mark.parametrize(("label", "call", "status"), STATUSES, ids=[row[0] for row in STATUSES])
def test_lost_runs_have_a_status(label, call, status):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.ImplausibleWarning)
        found = np.ravel(call().status)
    # that of too long steps may be that of lost numbers as well
    also = {status, Status.NOT_FINITE} if status == Status.UNRESOLVED else {status}
    assert set(found.tolist()) <= {int(s) for s in also}, label


def end(trajectory):
    return float(trajectory.state.motion.y[-1])


def strobe(ds):
    return ds["strobe"].values.ravel()


SAME = [
    ("whole numbers", lambda: end(simulate(sj.paper_scene(speed=1250))), lambda: end(simulate())),
    ("numpy's counts", lambda: end(simulate(periods=np.int64(3))), lambda: end(simulate())),
    ("almost no play", lambda: end(simulate(PAPER.replace(clearance=1e-300))), lambda: end(simulate(NO_PLAY))),
    ("no replacement", lambda: end(simulate(PAPER.replace())), lambda: end(simulate())),
    ("one value", lambda: strobe(sweep({"speed": 1250.0})), lambda: strobe(sweep())),
    ("values twice", lambda: strobe(sweep({"speed": [1250.0] * 2})), lambda: np.tile(strobe(sweep()), 2)),
    ("a range", lambda: strobe(sweep({"speed": range(1250, 1251)})), lambda: strobe(sweep())),
    (
        "falling values",
        lambda: sweep({"speed": [1300.0, 1250.0]})["strobe"].values[::-1],
        lambda: sweep({"speed": [1250.0, 1300.0]})["strobe"].values,
    ),
    ("more workers than cases", lambda: strobe(sweep(workers=500)), lambda: strobe(sweep())),
    ("a larger chunk than the grid", lambda: strobe(sweep(chunk=5)), lambda: strobe(sweep())),
]
"""Odd, but clear: a label, the odd call, and a plain one of the same result."""
NO_PLAY = PAPER.replace(clearance=0.0)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # no play of 1e-300 m is made
@pytest.mark.parametrize(("label", "odd", "plain"), SAME, ids=[row[0] for row in SAME])
def test_odd_but_clear_inputs_give_the_right_number(label, odd, plain):
    np.testing.assert_allclose(odd(), plain(), rtol=1e-9, err_msg=label)


OVER = ["bifurcation", "--over"]
REGIMES = ["lyapunov", "--over", "speed", "1000", "1200", "2"]
LINES = [
    # simulate
    (["simulate", "--speed", "inf"], "`speed` must be positive, but is inf m/s"),
    (["simulate", "--speed", "1,250"], "`speed` must be"),
    (["simulate", "--speed"], "--speed"),
    (["simulate", "--speed=-5"], "`speed` must be positive, but is -5 m/s"),
    (["simulate", "--clearance", "1 kg"], "`clearance` must be in a unit like m, but is in 'kg'"),
    (["simulate", "--restitution", "90"], "`restitution` must be above 0 and at most 1, but is 90"),
    (["simulate", "--wavelength", "8", "--wavelength", "nan"], "`wavelengths` must be positive, but is nan"),
    (["simulate", "--scene", "/no/scene.toml"], "No such file"),
    (["simulate", "--scene", "/proc"], "/proc is no zarr store"),
    (["simulate", "--out", "."], "--out must name files, as ./result does, but is the folder '.'"),
    (["simulate", "--out", ".."], "--out must name files, as ./result does, but is the folder '..'"),
    (["simulate", "--out", "/"], "--out must name files, as ./result does, but is the folder '/'"),
    (["simulate", "--scene", "/proc/version"], "no TOML file or netCDF file"),
    (["simulate", "--set", "mass"], "--set must be a name and a value"),
    (["simulate", "--set", "mass=heavy"], "`mass` must be a number with a unit"),
    (["simulate", "--set", "mass=3 m"], "`mass` must be in a unit like kg"),
    (["simulate", "--set", "wieght=3"], "`wieght` is no parameter"),
    (["simulate", "--set", "section.play.9=1e-3"], "must have a number of 0 to 4"),
    (
        [*OVER, "speed", "0", "2500", "3", "--log", "speed"],
        "--over must have values above zero where --log names speed",
    ),
    ([*OVER, "speed", "1", "2500", "3", "--log", "length"], "--log must name a parameter of --over or --by"),
    (["simulate", "--periods", "0"], "'--periods': 0 is not in the range x>=1"),
    (["simulate", "--periods", "2.5"], "--periods"),
    (["simulate", "--steps-per-period", "many"], "--steps-per-period"),
    (["simulate", "--steps-per-period", "20", "--saves-per-period", "50"], "`saves_per_period` must divide"),
    (["simulate", "--probe", "-1"], "'--probe': -1 is not in the range x>=0"),
    (["simulate", "--solver", ""], "`solver` must be one of RK4"),
    (["simulate", "--solver", "LeapfrogMidpoint"], "`solver` must be a one-step method"),
    (["simulate", "--solver", "Latching"], "`solver` must be one of RK4"),
    (["simulate", "--solver", "RESULTS"], "`solver` must be one of RK4"),
    (["simulate", "--memory", "latch"], "'--memory': 'latch' is not one of 'event', 'smooth'"),
    (["simulate", "--out", "/proc/no/place"], "--out must name a place that can be written"),
    (["simulate", "--out", ""], "--out"),
    (["simulate", "--begin", "inf"], "`begin` must be finite, but is inf m"),
    (["simulate", "--scene", "a\0b"], "`path` must be a path"),
    (["simulate", "1250"], "1250"),
    (["simulate", "--gravity", "-9.81"], "`gravity` must be zero or positive, but is -9.81"),
    (["simulate", "--stiffness", "1e30"], "`steps_per_period` must be given: the default would be"),
    # bifurcation
    (["bifurcation"], "--over"),
    ([*OVER, "speed", "100", "2500"], "--over"),
    ([*OVER, "speed", "100", "fast", "3"], "`speed` must be a number with a unit"),
    ([*OVER, "speed", "100", "3 mm", "3"], "`speed` must be in a unit like m/s, but is in 'mm'"),
    ([*OVER, "speed", "100", "2500", "-1"], "'--over': -1 is not in the range x>=1"),
    ([*OVER, "speed", "nan", "2500", "3"], "`speed` must be positive, but is nan"),
    ([*OVER, "Speed", "100", "2500", "3"], "`Speed` is no parameter; the names are speed"),
    ([*OVER, "clearance", "-1", "1", "3"], "`clearance` must be zero or positive, but is -0.001 m"),
    ([*OVER, "speed", "100", "2500", "3", "--transient", "-1"], "'--transient': -1 is not in the range x>=0"),
    ([*OVER, "speed", "100", "2500", "3", "--by", "length", "1", "2", "2"], "No such option '--by'"),
    # lyapunov
    ([*REGIMES, "--by", "speed", "1", "2", "2"], "--by must name another parameter than --over"),
    ([*REGIMES, "--by", "width", "1", "2", "2"], "`width` is no parameter; the names are speed"),
    ([*REGIMES, "--by", "length", "nan", "0.2", "2"], "`length` must be positive, but is nan"),
    ([*REGIMES, "--count", "11"], "`count` must be at most 10"),
    ([*REGIMES, "--transient", "5"], "`transient` must be a whole number of 20 or more, but is 5"),
    ([*REGIMES, "--certify", "no"], "no"),
    # reproduce
    (["reproduce", "3"], "`figures` must be one of 4"),
    (["reproduce", "5", "--out", "/proc/no/place"], "--out must name a place"),
    (["reproduce", "5", "--fast"], "No such option '--fast'"),
    # bench
    (["bench", "--scene", "paper"], "`cases` must be of nominal"),
    (["bench", "--method", "RK5"], "`methods` must be of RK4"),
    (["bench", "--batch", "0"], "'--batch': 0 is not in the range x>=1"),
    (["bench", "--out", "/proc/no/place"], "--out must name a place"),
    # one number by two options
    (["simulate", "--speed", "800", "--set", "speed=900"], "--set must not give speed, which another option gives"),
    (["simulate", "--set", "speed=800", "--set", "speed=900"], "--set must not give speed, which another option"),
    (["simulate", "--mass", "14", "--set", "slipper.mass=15"], "`mass` must not be given with `slipper.mass`"),
    # no commands
    (["simulat"], "simulat"),
    (["--speed", "1250"], "--speed"),
    ([""], "No such command"),
]


@pytest.mark.parametrize(("arguments", "words"), LINES, ids=[" ".join(row[0]) for row in LINES])
def test_command_line_errors_are_one_line_and_code_2(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.ImplausibleWarning)
        assert words in error_of(arguments, capsys)
    assert not any(path.is_file() for path in tmp_path.rglob("*"))
