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


def each(make, name, need, *cases):
    """Rows of errors of one argument, by values and their words in the error, or None for the value itself."""
    return [
        refused(f"`{name}` must {need}, but is {shown or re.escape(repr(value))}", make, **{name: value})
        for value, shown in cases
    ]


FINE = dict(solver=sj.Tsit5(), stepsize_controller=sj.AdaptiveSteps())
WHOLE = r"be a whole number of \d+ or more"
POSITIVE = "be positive"
RISING = "`path` must name one parameter with increasing values"

ERRORS = [
    # counts
    *each(simulate, "periods", WHOLE, (-1, None), (True, None), ("3", None), (2.5, None)),
    refused("`count` must be at most 10", spectrum, count=11),
    refused("`steps_per_period` must have one number or one for each case", sweep, steps_per_period=[50, 50]),
    refused("`saves_per_period` must divide steps_per_period = 100", sweep, record="history", saves_per_period=7),
    # parameters of the scene
    *each(sj.paper_scene, "speed", POSITIVE, (None, None), (True, None), (INF, "inf"), (1 + 2j, None)),
    *each(sj.paper_scene, "speed", POSITIVE, ("4500 km/h", "'4500 km/h', not a number in m/s.")),
    refused(r"`speed` must be of shape \(\), but has shape \(2,\)", sj.paper_scene, speed=[1.0, 2.0]),
    refused("`wavelengths` must be a sequence of one or more", sj.paper_scene, wavelengths=8.0),
    refused("`clamp` must be True or False, but is 'no'", sj.paper_scene, clamp="no"),
    *each(sj.paper_scene, "memory", "be .*", ("smooth", None), (sj.SmoothSwitch, "<class")),
    # parts of the scene
    *each(slipper, "inertia", POSITIVE, (np.diag([0.05, 0.06, 0.09]), "0")),
    refused(r"`inertia` must be of shape \(3\), but has shape \(4,\)", slipper, inertia=(1.0, 1.0, 1.0, 1.0)),
    *each(scene, "gravity", "be zero or positive", (-9.81, None), (NAN, None)),
    *each(scene, "contact", "be .*", (sj.Flores, "<class")),
    refused("`points` must be in an order in which the faces' normals point out", section, points=POINTS[::-1]),
    refused("`points` must have two different corners", section, points=np.zeros((10, 2)) + POINTS[0]),
    refused("`points` must have two points per face", section, points=POINTS.T),
    refused("`points` must be of shape", section, points=POINTS[:, [0, 1, 1]]),
    refused("`play` must have one value per face", section, play=1e-3),
    *(refused("`names` must ", section, names=names) for names in (None, ("A", "A", *"CDEFGHIJ"))),
    *(refused("`faces` must ", section, faces=(face, *FACES[1:])) for face in (("J", "A", "B"), FACES[1])),
    refused("`faces` must name points, but is [(]'Z'", section, faces=(("Z", "A"), *FACES[1:])),
    # other values of named parameters
    refused("`sped` is no parameter; the names are speed", PAPER.replace, sped=1.0),
    refused("`wavelengths` is no parameter", PAPER.replace, wavelengths=(8.0,)),
    refused("`speed` must be ", PAPER.replace, speed=[]),
    # defaults of scenes whose units are wrong
    refused(
        "`steps_per_period` must be given: the default would", sj.simulate, scene=PAPER.replace(restitution=1e-6)
    ),
    # starts
    refused("`start` must be finite, but its w_y is inf", started, w_y=INF),
    refused("`start` must be .* its v_z is", started, v_z=[0.5, 0.5]),
    refused("`start` must be .* its q_x is 'x'", sweep, start=sj.Motion(q_x="x")),
    refused("`start` must be finite, but its q_", lambda: simulate(start=sj.Motion.from_euler(pitch=NAN))),
    refused("`state` must be .*, but is", sj.period_map, scene=PAPER, state=REST),
    # solvers, controllers, other options
    refused("`solver` must be a solver, as in RK4.*, but is the class", simulate, solver=sj.RK4),
    refused("`solver` must be one of RK4, .* but is 'rk4'", follow, solver="rk4"),
    refused("`solver` must be a one-step method .* but is S", simulate, solver=diffrax.SemiImplicitEuler()),
    refused("`solver` must be a one-step method .* but is NoneType", sj.Latching, solver=None),
    refused("`solver` must be one with an error estimate", simulate, stepsize_controller=sj.AdaptiveSteps()),
    refused("`adjoint` must be .*, but is 'forward'", simulate, **FINE, adjoint="forward"),
    refused("`rho_inf` must be from 0 to 1, but is nan", sj.TwoStep, rho_inf=NAN),
    refused("`probe` must be 0 under jit", lambda: jax.jit(lambda v: simulate(PAPER.replace(speed=v), probe=1))(9.0)),
    refused("`steps_per_period` must be", lambda: jax.jit(lambda n: simulate(steps_per_period=n))(50)),
    # grids
    refused("`grid` must have lists of one length", sweep, grid=AT | {"length": [0.2, 0.3]}, product=False),
    *(
        refused(f"`{name}` {words}", sweep, grid={name: values})
        for name, values, words in (
            ("speed", [[1250.0, 1300.0]], "must have a list of one or more values"),
            ("speed", [], "must have a list of one or more values"),
            ("speed", {1250.0}, "must be positive, but is {1250.0}"),
            ("restitution", [0.9, 1.5], "must be above 0 and at most 1, but is 1.5"),
            ("start_y", [NAN], "must be finite, but is nan"),
            *((name, [1.0], "is no parameter") for name in ("Speed", 1, "roll", "start_roll")),
            ("v_y", [1.0], "is no parameter.* Did you mean start_v_y?"),
        )
    ),
    refused("`record` must give each variable once, but gives `strobe`", follow, record=["sections", "strobe"]),
    # paths
    *(
        refused(RISING, follow, path=path)
        for path in ({"speed": [1300.0, 1250.0]}, {"speed": [1250.0] * 2}, AT | {"length": [0.2]}, {"start_y": [0.0]})
    ),
    refused(RISING, jump, path={"speed": [1300.0, 1250.0]}),
    refused("`direction` must be one of up, down, but is 'left'", jump, direction="left"),
    *each(jump, "within", "be .*", (0.0, "0"), ([1.0, 2.0], None)),
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


def outside(**coordinates):
    return sj.initial_state(PAPER, sj.Motion(**coordinates))


OUTSIDE = "start lies outside the play"
GRAMS = (51, 60, 86)


WARNINGS = [
    # millimetres, degrees, grams and the like
    *(
        implausible(name, shown, sj.paper_scene, **{name: value})
        for name, value, shown in (
            ("length", 200.0, "200 m"),
            ("clearance", 1.0, "1 m"),
            ("amplitude", 1.0, "1 m"),
            ("roll_amplitude", 0.2, "0.2 rad"),  # the paper's value in degrees
            ("speed", 1.25e6, r"1.25e\+06 m/s"),
            ("speed", 1e-300, "1e-300 m/s"),
            ("speed", 1.25, "1.25 m/s"),  # in km/s
            ("stiffness", 1e8 / 10**4.5, "3162.28 N/m"),
            ("wavelengths", (8000.0,), "8000 m"),
            ("wavelengths", (8e-3,), "0.008 m"),
        )
    ),
    implausible("window", "1e-300 m", scene, window=1e-300),
    implausible("gravity", "9810 m/s", scene, gravity=9810.0),
    implausible("inertia", "86000 kg", lambda: scene(slipper=slipper(inertia=(51e3, 60e3, 86e3)))),
    implausible("points", "48 m", section, points=POINTS * 1e3),
    implausible("points", "4.8e-05 m", section, points=POINTS * 1e-3),
    (*given(section, points=POINTS + np.array([0.0, 0.1])), "`points` has its origin, .* outside of the section"),
    ("grams", lambda: scene(slipper=slipper(mass=14e3, inertia=GRAMS)), "`mass` is 14000 kg; plausible are 0.1"),
    (
        "an inertia in g m^2",
        lambda: scene(slipper=slipper(inertia=GRAMS)),
        "radius of gyration of .* slipper lengths",
    ),
    ("a fourth of a body", lambda: slipper(inertia=(0.05, 0.06, 0.2)), "`inertia` has a moment greater than the sum"),
    implausible("width", "1 m", sj.SmoothSwitch, width=1.0),
    implausible("relaxation", "1 s", sj.SmoothSwitch, relaxation=1.0),
    implausible("slowest", "1000 m/s", sj.SmoothSwitch, slowest=1e3),
    implausible("slowest", "1000 m/s", sj.EventLatch, slowest=1e3),
    # other values of named parameters
    implausible("mass", "14000 kg", PAPER.replace, mass=14e3),
    implausible("speed", "0.001 m/s", PAPER.replace, speed=[1250.0, 1e-3]),
    # grids are looked at before they run, here until a wrong count
    implausible("clearance", "2 m", lambda: stopped(sweep, {"clearance": [1.0, 2.0]})),
    implausible("start_v_y", "500 m/s", lambda: stopped(sweep, {"start_v_y": [500.0]})),
    implausible("length", "200 m", lambda: stopped(follow, {"length": [200.0]})),
    implausible("amplitude", "2 m", lambda: stopped(exponents, {"amplitude": [1.0, 2.0]})),
    # starts outside the play
    *((*given(outside, **place), OUTSIDE) for place in ({"y": 1.0}, {"z": 5e-3}, {"q_x": 2.0})),
    ("a start of a sweep", lambda: sweep(start=sj.Motion(y=5e-3)), f"^A {OUTSIDE}"),  # one, though a batch has eight
    ("a pitch in degrees", lambda: sj.initial_state(PAPER, sj.Motion.from_euler(pitch=5.0)), OUTSIDE),
]


def stopped(run, grid, wrong="steps_per_period"):
    with pytest.raises(ValueError, match=f"`{wrong}` must be"):
        run(grid, **{wrong: 0})


@pytest.mark.full
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
    (*given(simulate, case=PAPER.replace(stiffness=1e13)), Status.TOO_FEW_STEPS),
    (*given(simulate, case=PAPER.replace(restitution=1e-3)), Status.TOO_FEW_STEPS),
    ("a small mass", lambda: simulate(PAPER.replace(mass=0.01)), Status.TOO_FEW_STEPS),
    (*given(simulate, steps_per_period=1), Status.TOO_FEW_STEPS),
    ("strong damping", lambda: simulate(scene(contact=sj.ConstantDamping(1e8, 1e5))), Status.NOT_FINITE),
    ("a sweep of a clearance in mm", lambda: sweep(case=sj.paper_scene(clearance=1.0)), Status.NO_CONTACT),
    (*given(sweep, case=PAPER.replace(stiffness=1e13)), Status.TOO_FEW_STEPS),
]


@pytest.mark.full
@pytest.mark.parametrize(("label", "call", "status"), STATUSES, ids=[row[0] for row in STATUSES])
def test_lost_runs_have_a_status(label, call, status):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.ImplausibleWarning)
        found = np.ravel(call().status)
    # that of too long steps may be that of lost numbers as well
    also = {status, Status.NOT_FINITE} if status == Status.TOO_FEW_STEPS else {status}
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


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # no play of 1e-300 m is made
@pytest.mark.parametrize(("label", "odd", "plain"), SAME, ids=[row[0] for row in SAME])
def test_odd_but_clear_inputs_give_the_right_number(label, odd, plain):
    np.testing.assert_allclose(odd(), plain(), rtol=1e-9, err_msg=label)


OVER = ["bifurcation", "--over"]
REGIMES = ["lyapunov", "--over", "speed", "1000", "1200", "2"]
LINES = [
    # simulate
    (["simulate", "--speed", "inf"], "`speed` must be positive, but is inf m/s"),
    (["simulate", "--speed"], "--speed"),
    (["simulate", "--clearance", "1 kg"], "`clearance` must be in a unit like m, but is in 'kg'"),
    (["simulate", "--restitution", "90"], "`restitution` must be above 0 and at most 1, but is 90"),
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
    ([*OVER, "speed", "0", "2500", "3", "--log", "speed"], "--over must have values above zero where --log names"),
    ([*OVER, "speed", "1", "2500", "3", "--log", "length"], "--log must name a parameter of --over or --by"),
    (["simulate", "--periods", "0"], "'--periods': 0 is not in the range x>=1"),
    (["simulate", "--periods", "2.5"], "--periods"),
    (["simulate", "--steps-per-period", "20", "--saves-per-period", "50"], "`saves_per_period` must divide"),
    (["simulate", "--probe", "-1"], "'--probe': -1 is not in the range x>=0"),
    (["simulate", "--solver", "LeapfrogMidpoint"], "`solver` must be a one-step method"),
    (["simulate", "--solver", "RESULTS"], "`solver` must be one of RK4"),
    (["simulate", "--out", ""], "--out"),
    (["simulate", "--begin", "inf"], "`begin` must be finite, but is inf m"),
    (["simulate", "--scene", "a\0b"], "`path` must be a path"),
    (["simulate", "--stiffness", "1e30"], "`steps_per_period` must be given: the default would be"),
    # bifurcation
    ([*OVER, "speed", "100", "2500"], "--over"),
    ([*OVER, "speed", "100", "fast", "3"], "`speed` must be a number with a unit"),
    ([*OVER, "speed", "100", "3 mm", "3"], "`speed` must be in a unit like m/s, but is in 'mm'"),
    ([*OVER, "speed", "nan", "2500", "3"], "`speed` must be positive, but is nan"),
    ([*OVER, "speed", "100", "2500", "3", "--by", "length", "1", "2", "2"], "No such option '--by'"),
    # lyapunov
    ([*REGIMES, "--by", "speed", "1", "2", "2"], "--by must name another parameter than --over"),
    ([*REGIMES, "--by", "length", "nan", "0.2", "2"], "`length` must be positive, but is nan"),
    ([*REGIMES, "--count", "11"], "`count` must be at most 10"),
    ([*REGIMES, "--transient", "5"], "`transient` must be a whole number of 20 or more, but is 5"),
    ([*REGIMES, "--certify", "no"], "no"),
    # reproduce
    (["reproduce", "3"], "`figures` must be one of 4"),
    (["reproduce", "5", "--fast"], "No such option '--fast'"),
    # bench
    (["bench", "--scene", "paper"], "`cases` must be one of nominal"),
    (["bench", "--method", "RK5"], "`methods` must be one of RK4"),
    (["bench", "--batch", "0"], "'--batch': 0 is not in the range x>=1"),
    # one number by two options
    (["simulate", "--speed", "800", "--set", "speed=900"], "--set must not give speed, which another option gives"),
    # no commands
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
