"""Bad input: one clear error that names argument, value and need, before anything is compiled."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.cli import main

NAN = float("nan")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: sj.paper_scene(speed=0.0), "`speed` must be positive, but is 0 m/s"),
        (lambda: sj.paper_scene(speed=-5.0), "`speed` must be positive, but is -5 m/s"),
        (lambda: sj.paper_scene(clearance=-1e-3), "`clearance` must be zero or positive, but is -0.001 m"),
        (lambda: sj.paper_scene(length=0.0), "`length` must be positive, but is 0 m"),
        (lambda: sj.paper_scene(stiffness=-1.0), "`stiffness` must be positive, but is -1"),
        (lambda: sj.paper_scene(restitution=0.0), "`restitution` must be above 0 and at most 1, but is 0"),
        (lambda: sj.paper_scene(restitution=1.1), "`restitution` must be above 0 and at most 1, but is 1.1"),
        (lambda: sj.paper_scene(speed=NAN), "`speed` must be positive, but is nan"),
        (lambda: sj.paper_scene(amplitude=NAN), "`amplitude` must be finite, but is nan"),
        (lambda: sj.paper_scene(speed="fast"), "`speed` must be positive, but is 'fast'"),
        (lambda: sj.paper_scene(wavelengths=()), "`wavelengths` must be a sequence of one or more"),
        (
            lambda: sj.Slipper(mass=-1.0, inertia=(1, 1, 1), length=1.0),
            "`mass` must be positive, but is -1 kg",
        ),
        (lambda: sj.Slipper(mass=1.0, inertia=(1, 0, 1), length=1.0), "`inertia` must be positive, but is 0"),
        (lambda: sj.simulate(sj.paper_scene(), 0), "`periods` must be a whole number of 1 or more, but is 0"),
        (
            lambda: sj.simulate(sj.paper_scene(), 1, steps_per_period=2.5),
            "`steps_per_period` must be a whole",
        ),
        (
            lambda: sj.simulate(sj.paper_scene(), 1, steps_per_period=50, saves_per_period=7),
            "`saves_per_period` must divide steps_per_period = 50, but is 7",
        ),
        (
            lambda: sj.simulate(sj.paper_scene(), 1, start=sj.Motion(y=NAN)),
            "`start` must be finite, but its y is nan",
        ),
        (lambda: sj.simulate(sj.paper_scene(), 1, start=3), "slipperjax.State or a slipperjax.Trajectory, but is 3"),
        (
            lambda: sj.simulate(sj.paper_scene(), 1, solver="RK5"),
            "`solver` must be one of RK4, Tsit5, Rodas4, ROS34PW2, TwoStep, or a solver of diffrax",
        ),
        (lambda: sj.sweep(sj.paper_scene(), {"speed": []}), "`speed` must be a list of one or more values"),
        (lambda: sj.sweep(sj.paper_scene(), {}), "`grid` must name one or more parameters"),
        (
            lambda: sj.sweep(sj.paper_scene(), {"speed": [1000.0, -1.0]}),
            "`speed` must be positive, but is -1 m/s",
        ),
        (lambda: sj.sweep(sj.paper_scene(), {"sped": [1.0]}), "`sped` is no parameter; the names are speed"),
        (
            lambda: sj.sweep(sj.paper_scene(), {"gravity": [-9.81]}),
            "`gravity` must be zero or positive, but is -9.81",
        ),
        (
            lambda: sj.sweep(sj.paper_scene(), {"speed": [1.0]}, record="all"),
            "`record` must be one of sections",
        ),
    ],
)
def test_errors_name_argument_value_and_need(call, words):
    with pytest.raises(ValueError, match=r"^Argument ") as caught:
        call()
    assert words in str(caught.value)


def test_solvers_that_cannot_be_latched_are_refused():
    import diffrax

    with pytest.raises(ValueError, match=r"`solver` must be a one-step method.*but is LeapfrogMidpoint"):
        sj.simulate(sj.paper_scene(), 1, solver=diffrax.LeapfrogMidpoint())
    with pytest.raises(ValueError, match=r"`stepsize_controller` must be a diffrax controller, but is 1e-05"):
        sj.simulate(sj.paper_scene(), 1, stepsize_controller=1e-5)
    with pytest.raises(ValueError, match=r"`solver` must be one with an error estimate for adaptive steps"):
        sj.simulate(sj.paper_scene(), 1, stepsize_controller=sj.AdaptiveSteps())
    with pytest.raises(ValueError, match=r"`tolerance` must be positive, but is 0"):
        sj.AdaptiveSteps(0.0)
    with pytest.raises(ValueError, match=r"`rho_inf` must be from 0 to 1, but is 1.5"):
        sj.TwoStep(rho_inf=1.5)


def test_traced_values_are_checked_at_run_time():
    with pytest.raises(Exception, match="`speed` must be positive"):
        jax.block_until_ready(jax.jit(lambda v: sj.paper_scene(speed=v).period)(-1.0))
    assert np.isclose(jax.jit(lambda v: sj.paper_scene(speed=v).period)(1250.0), 6.4e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "--clearance", "-1"], "`clearance` must be zero or positive, but is -0.001 m"),
        (["simulate", "--length", "0"], "`length` must be positive, but is 0 m"),
        (["simulate", "--spede", "100"], "No such option"),
        (["simulate", "--speed", "fast"], "--speed"),
        (["simulate", "--solver", "Euler4"], "`solver` must be one of RK4"),
        (["simulate", "--solver", "AbstractERK"], "`solver` must be one of RK4"),
        (["simulate", "--memory", "none"], "--memory must be event or smooth, but is 'none'"),
        (["bifurcation", "--over", "width", "1", "2", "3"], "--over must begin with one of speed"),
        (["bifurcation", "--over", "speed", "100", "2500", "0"], "number of values of 1 or more, but is 0"),
        (
            ["bifurcation", "--over", "speed", "-100", "2500", "3"],
            "`speed` must be positive, but is -100 m/s",
        ),
        (["simulate", "--out", f"{__file__}/run"], "--out must name a place that can be written"),
        (["reproduce", "--out", __file__], "--out must name a place that can be written"),
        (["bench", "--out", f"{__file__}/run"], "--out must name a place that can be written"),
        (["bifurcation"], "--over"),
        (["orbits"], "orbits"),
    ],
)
def test_command_line_errors_are_one_line_and_code_2(arguments, words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    error = capsys.readouterr().err.strip()
    assert stopped.value.code == 2
    assert error.count("\n") == 0
    assert words in error


def test_a_file_that_cannot_be_written_is_one_line_and_code_2(tmp_path, capsys, monkeypatch):
    def write(**options):
        (tmp_path / "run.nc").mkdir()
        (tmp_path / "run.nc").write_text("")

    monkeypatch.setattr("slipperjax.cli.app", write)
    with pytest.raises(SystemExit) as stopped:
        main([])
    error = capsys.readouterr().err.strip()
    assert stopped.value.code == 2
    assert error.count("\n") == 0
    assert "run.nc" in error
