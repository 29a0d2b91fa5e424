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
FACES = (("J", "A"), ("B", "C"), ("D", "E"), ("F", "G"), ("H", "I"))
AT = {"speed": [1250.0]}
SHORT = dict(transient=0, periods=10, steps_per_period=100)
"""Options of short runs, which share their programs with test_cli."""


def by_words(*rows):
    """Parameters of a test with one row for each words: the words first, and what is called or typed."""
    return pytest.mark.parametrize(("words", "given"), rows, ids=[f"{k}: {row[0]}" for k, row in enumerate(rows)])


def slipper(**values):
    return sj.Slipper(**(dict(mass=14.0, inertia=(0.051, 0.060, 0.086), length=0.2) | values))


def section(**values):
    return sj.Section(**(dict(points=POINTS, play=np.full(5, 5e-4)) | values))


def scene(**parts):
    track = sj.HarmonicTrack((8.0,), 1e-3, 3e-3)
    default = dict(speed=1250.0, slipper=slipper(), section=section(), track=track, contact=sj.model.Flores(1e8, 0.9))
    return sj.Scene(**(default | parts))


def simulate(case=PAPER, **options):
    return sj.simulate(case, **(dict(periods=3, steps_per_period=50) | options))


def started(**coordinates):
    return simulate(start=sj.Motion(**coordinates))


def sweep(grid=AT, case=PAPER, **options):
    return sj.sweep(case, grid, **(SHORT | options))


def jump(path=AT, **options):
    return find_jump(PAPER, path, **(SHORT | options))


FINE = dict(solver=sj.solvers.Tsit5(), stepsize_controller=sj.solvers.AdaptiveSteps())


@by_words(
    # counts
    *((rf"`periods` must be a whole number of \d+ or more, but is {n!r}", lambda n=n: simulate(periods=n))
      for n in (-1, True, "3", 2.5)),
    ("`count` must be at most 10", lambda: sj.lyapunov_spectrum(PAPER, **SHORT, align=0, count=11)),
    ("`steps_per_period` must have one number or one for each case", lambda: sweep(steps_per_period=[50, 50])),
    ("`saves_per_period` must divide steps_per_period = 100", lambda: sweep(record="history", saves_per_period=7)),
    # parameters and parts of the scene
    *((f"`speed` must be positive, but is {words}", lambda v=v: sj.paper_scene(speed=v))
      for v, words in ((None, "None"), (INF, "inf"), (1 + 2j, r"\(1"), ("4500 kg", "'4500 kg', not a number"))),
    (r"`speed` must be of shape \(\), but has shape \(2,\)", lambda: sj.paper_scene(speed=[1.0, 2.0])),
    ("`wavelengths` must be a sequence of one or more", lambda: sj.paper_scene(wavelengths=8.0)),
    ("`clamp` must be True or False, but is 'no'", lambda: sj.paper_scene(clamp="no")),
    ("`memory` must be .*, but is <class", lambda: sj.paper_scene(memory=sj.model.SmoothSwitch)),
    ("`contact` must be .*, but is <class", lambda: scene(contact=sj.model.Flores)),
    (r"`inertia` must be of shape \(3\), but has shape \(4,\)", lambda: slipper(inertia=(1.0, 1.0, 1.0, 1.0))),
    ("`gravity` must be zero or positive, but is -9.81", lambda: scene(gravity=-9.81)),
    ("`points` must be in an order in which the faces' normals", lambda: section(points=POINTS[::-1])),
    ("`points` must have two different corners", lambda: section(points=np.zeros((10, 2)) + POINTS[0])),
    ("`points` must have two points per face", lambda: section(points=POINTS.T)),
    ("`play` must have one value per face", lambda: section(play=1e-3)),
    ("`names` must ", lambda: section(names=("A", "A", *"CDEFGHIJ"))),
    *(("`faces` must ", lambda face=face: section(faces=(face, *FACES[1:]))) for face in (("J", "A", "B"), FACES[1])),
    ("`faces` must name points, but is [(][(]'Z'", lambda: section(faces=(("Z", "A"), *FACES[1:]))),
    # other values of named parameters
    ("`sped` is no parameter; the names are speed", lambda: PAPER.replace(sped=1.0)),
    ("`speed` must be ", lambda: PAPER.replace(speed=[])),
    ("`steps_per_period` must be given: the default", lambda: sj.simulate(PAPER.replace(restitution=1e-6), 3)),
    # starts
    ("`start` must be finite, but its w_y is inf", lambda: started(w_y=INF)),
    ("`start` must have one finite number for each .* its v_z is", lambda: started(v_z=[0.5, 0.5])),
    ("`start` must have .* its q_x is 'x'", lambda: sweep(start=sj.Motion(q_x="x"))),
    ("`state` must be .*, but is", lambda: sj.period_map(PAPER, sj.Motion())),
    # solvers, controllers, other options
    ("`solver` must be a solver, as in RK4.*, but is the class", lambda: simulate(solver=sj.solvers.RK4)),
    ("`solver` must be one of RK4, .* but is 'rk4'", lambda: sj.follow(PAPER, AT, **SHORT, solver="rk4")),
    ("`solver` must be a one-step method .* but is S", lambda: simulate(solver=diffrax.SemiImplicitEuler())),
    ("`solver` must be one with an error estimate", lambda: simulate(stepsize_controller=sj.solvers.AdaptiveSteps())),
    ("`adjoint` must be .*, but is 'forward'", lambda: simulate(**FINE, adjoint="forward")),
    ("`rho_inf` must be from 0 to 1, but is nan", lambda: sj.solvers.TwoStep(rho_inf=NAN)),
    ("`probe` must be 0 under jit", lambda: jax.jit(lambda v: simulate(PAPER.replace(speed=v), probe=1))(9.0)),
    ("`steps_per_period` must be", lambda: jax.jit(lambda n: simulate(steps_per_period=n))(50)),
    # grids and paths
    ("`grid` must have lists of one length", lambda: sweep(AT | {"length": [0.2, 0.3]}, product=False)),
    ("`speed` must have a list of one or more values", lambda: sweep({"speed": [[1250.0, 1300.0]]})),
    ("`speed` must have a list of one or more values", lambda: sweep({"speed": []})),
    ("`restitution` must be above 0 and at most 1, but is 1.5", lambda: sweep({"restitution": [0.9, 1.5]})),
    ("`start_y` must be finite, but is nan", lambda: sweep({"start_y": [NAN]})),
    ("`v_y` is no parameter.* Did you mean start_v_y?", lambda: sweep({"v_y": [1.0]})),
    ("`record` must give each variable once", lambda: sj.follow(PAPER, AT, **SHORT, record=["sections", "strobe"])),
    ("`path` must name one parameter", lambda: sj.follow(PAPER, {"speed": [1300.0, 1250.0]}, **SHORT)),
    ("`path` must name one parameter with increasing values", lambda: jump({"speed": [1250.0] * 2})),
    ("`direction` must be one of up, down, but is 'left'", lambda: jump(direction="left")),
    ("`within` must be .*, but is 0", lambda: jump(within=0.0)),
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_errors_are_one_line_that_names_the_argument(words, given):
    with pytest.raises(ValueError, match=words) as caught:
        given()
    assert re.fullmatch("(Argument|Option) .*", str(caught.value))


def counted_wrong(run, grid):
    """Grids are looked at before they run, here until a wrong count."""
    with pytest.raises(ValueError, match="`steps_per_period` must be"):
        run(PAPER, grid, steps_per_period=0)


def outside(**coordinates):
    return sj.initial_state(PAPER, sj.Motion(**coordinates))


GRAMS = (51, 60, 86)


@pytest.mark.full
@by_words(
    # millimetres, degrees, grams and the like
    *((f"`{name}` is {shown}.*; plausible are .* Is the unit right", lambda n=name, v=v: sj.paper_scene(**{n: v}))
      for name, v, shown in (
        ("length", 200.0, "200 m"), ("clearance", 1.0, "1 m"), ("amplitude", 1.0, "1 m"),
        ("roll_amplitude", 0.2, "0.2 rad"), ("speed", 1.25, "1.25 m/s"), ("stiffness", 1e8 / 10**4.5, "3162.28 N/m"),
        ("wavelengths", (8000.0,), "8000 m"))),
    ("`gravity` is 9810 m/s", lambda: scene(gravity=9810.0)),
    ("`inertia` is 86000 kg", lambda: scene(slipper=slipper(inertia=(51e3, 60e3, 86e3)))),
    ("`points` is 48 m", lambda: section(points=POINTS * 1e3)),
    ("`points` has its origin, .* outside of the section", lambda: section(points=POINTS + np.array([0.0, 0.1]))),
    ("`mass` is 14000 kg; plausible are 0.1", lambda: scene(slipper=slipper(mass=14e3, inertia=GRAMS))),
    ("radius of gyration of .* slipper lengths", lambda: scene(slipper=slipper(inertia=GRAMS))),
    ("`inertia` has a moment greater than the sum", lambda: slipper(inertia=(0.05, 0.06, 0.2))),
    ("`relaxation` is 1 s", lambda: sj.model.SmoothSwitch(relaxation=1.0)),
    ("`slowest` is 1000 m/s", lambda: sj.model.EventLatch(slowest=1e3)),
    ("`speed` is 0.001 m/s", lambda: PAPER.replace(speed=[1250.0, 1e-3])),
    ("`clearance` is 2 m", lambda: counted_wrong(sj.sweep, {"clearance": [1.0, 2.0]})),
    ("`start_v_y` is 500 m/s", lambda: counted_wrong(sj.sweep, {"start_v_y": [500.0]})),
    ("`length` is 200 m", lambda: counted_wrong(sj.follow, {"length": [200.0]})),
    ("`amplitude` is 2 m", lambda: counted_wrong(sj.lyapunov_sweep, {"amplitude": [1.0, 2.0]})),
    # one, though a batch has eight
    ("^A start lies outside the play", lambda: sweep(start=sj.Motion(y=5e-3))),
    *(("start lies outside the play", lambda of=of: outside(**of)) for of in ({"y": 1.0}, {"q_x": 2.0})),
)  # fmt: skip
def test_wrong_units_are_warned_of(words, given):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        given()
    assert {warning.category for warning in caught} == {sj.ImplausibleWarning}
    assert any(re.search(words, str(warning.message)) for warning in caught)


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
@by_words(
    (Status.NOT_FINITE, lambda: started(v_y=1e6)),
    (Status.NOT_FINITE, lambda: simulate(sj.paper_scene(roll_amplitude=1.6))),
    (Status.PRESSED_IN, lambda: started(v_y=500.0)),
    (Status.NO_CONTACT, lambda: simulate(sj.paper_scene(clearance=1.0))),
    (Status.NO_CONTACT, lambda: sweep(case=sj.paper_scene(clearance=1.0))),
    (Status.TOO_FEW_STEPS, lambda: simulate(PAPER.replace(stiffness=1e13))),
    (Status.TOO_FEW_STEPS, lambda: simulate(PAPER.replace(mass=0.01))),
    (Status.TOO_FEW_STEPS, lambda: sweep(case=PAPER.replace(stiffness=1e13))),
)
def test_lost_runs_have_a_status(words, given):
    found = set(np.ravel(given().status).tolist())
    # that of too long steps may be that of lost numbers as well
    assert found <= {int(words), int(Status.NOT_FINITE)}
    assert found == {int(words)} or words == Status.TOO_FEW_STEPS


def strobe(*given, **options):
    return sweep(*given, **options)["strobe"].values.ravel()


@pytest.mark.full
def test_odd_but_clear_inputs_give_the_right_number():
    plain = strobe()
    for odd in ({"speed": 1250}, {"speed": range(1250, 1251)}):
        np.testing.assert_array_equal(strobe(odd), plain)
    np.testing.assert_array_equal(strobe({"speed": [1250.0] * 2}), np.tile(plain, 2))
    np.testing.assert_allclose(strobe(workers=500, chunk=5), plain, rtol=1e-9)
    falling, rising = (sweep({"speed": values})["strobe"].values for values in ([1300.0, 1250.0], [1250.0, 1300.0]))
    np.testing.assert_array_equal(falling[::-1], rising)


OVER = ["bifurcation", "--over", "speed", "100"]
REGIMES = ["lyapunov", "--over", "speed", "1000", "1200", "2"]


@by_words(
    ("`speed` must be positive, but is inf m/s", ["simulate", "--speed", "inf"]),
    ("--speed", ["simulate", "--speed"]),
    ("`clearance` must be in a unit like m, but is in 'kg'", ["simulate", "--clearance", "1 kg"]),
    ("No such file", ["simulate", "--scene", "/no/scene.toml"]),
    ("/proc: must be a store of slipperjax", ["simulate", "--scene", "/proc"]),
    ("no TOML file or netCDF file", ["simulate", "--scene", "/proc/version"]),
    ("`path` must be a path", ["simulate", "--scene", "a\0b"]),
    *((f"--out must name files, as ./result does, but is the folder '{out}'", ["simulate", "--out", out])
      for out in (".", "/")),
    ("--out", ["simulate", "--out", ""]),
    ("--set must be a name and a value", ["simulate", "--set", "mass"]),
    ("`mass` must be positive, but is '3 m', not a number in kg", ["simulate", "--set", "mass=3 m"]),
    ("`wieght` is no parameter", ["simulate", "--set", "wieght=3"]),
    ("must have a number of 0 to 4", ["simulate", "--set", "section.play.9=1e-3"]),
    ("--set must not give speed, which another option", ["simulate", "--speed", "800", "--set", "speed=900"]),
    ("'--periods': 0 is not in the range x>=1", ["simulate", "--periods", "0"]),
    ("`saves_per_period` must divide", ["simulate", "--steps-per-period", "20", "--saves-per-period", "50"]),
    ("`solver` must be one of RK4", ["simulate", "--solver", "RESULTS"]),
    ("`begin` must be finite, but is inf m", ["simulate", "--begin", "inf"]),
    ("`steps_per_period` must be given: the default would be", ["simulate", "--stiffness", "1e30"]),
    ("--over", [*OVER, "2500"]),
    ("`speed` must be a number with a unit", [*OVER, "fast", "3"]),
    ("`speed` must be in a unit like m/s, but is in 'mm'", [*OVER, "3 mm", "3"]),
    ("`speed` must be positive, but is nan", [*OVER, "nan", "3"]),
    ("--log must name a parameter of --over or --by", [*OVER, "2500", "3", "--log", "length"]),
    ("--over must have values above zero", ["bifurcation", "--over", "speed", "0", "9", "3", "--log", "speed"]),
    ("No such option '--by'", [*OVER, "2500", "3", "--by", "length", "1", "2", "2"]),
    ("--by must name another parameter than --over", [*REGIMES, "--by", "speed", "1", "2", "2"]),
    ("`count` must be at most 10", [*REGIMES, "--count", "11"]),
    ("`transient` must be a whole number of 20 or more, but is 5", [*REGIMES, "--transient", "5"]),
    ("`figures` must be one of 4", ["reproduce", "3"]),
    ("--speed", ["--speed", "1250"]),
    ("No such command", [""]),
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_command_line_errors_are_one_line_and_code_2(words, given, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert words in error_of(given, capsys)
    assert list(tmp_path.iterdir()) == []
