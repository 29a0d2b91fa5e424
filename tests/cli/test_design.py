"""The command that chooses parameters by an objective."""

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli.design import OBJECTIVE_UNITS
from slipperjax.design.ensembles import Spread
from slipperjax.design.objectives import OBJECTIVES, PeakForce
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import Problem
from slipperjax.flow.load import load_call

from ..design.bowl import judged
from ..plots.test_designs import legend
from .commands import call, dataset, names, picture

CLEARANCE = ["design", "--vary", "clearance", 0.2, 3, "--steps-per-period", 50, "--no-check", "--no-margins"]
GIVEN = [*CLEARANCE, "--minimise", "peak_force", "--vary", "length", 0.12, 0.5]


@pytest.fixture
def bowl(monkeypatch):
    monkeypatch.setattr(Problem, "judged", judged)


def test_the_help_names_every_objective_with_its_unit(capsys):
    assert {name: one.quantity.display_unit for name, one in OBJECTIVES.items()} == OBJECTIVE_UNITS
    text = " ".join(call(["design", "--help"], capsys)[0].split())
    assert "The objective: peak_force [kN], rms_a_y [m/s^2]" in text
    assert "repeat for several. Parameters: speed [m/s], clearance [mm], length [m]" in text


def test_options_reach_the_search(monkeypatch, tmp_path, capsys):
    asked = []

    def search(scene, objective, variables, **options):
        asked.append((scene, objective, variables, options))
        raise ValueError("seen")

    monkeypatch.setattr("slipperjax.design.optimise.optimise_design", search)
    more = ["--robust", "mean", "--constraint", "peak_force", "-inf", 20, "--constraint", "drive_force", 1, 50]
    more += ["--starts", 2, "--seed", 4, "--max-trials", 3, "--transient", 7, "--mass", 15, "--periodic"]
    more += ["--vary", "section.play.2", "1e-4", "1e-3", "--vary", "roll_amplitude", 0.1, 0.3, "--clearance", 2]
    call([*GIVEN, *more, "--solver", "Tsit5", "--speeds", 1000, 1600, 3, "--out", tmp_path / "run"], capsys, 2)
    ((scene, objective, variables, options),) = asked
    assert float(scene.slipper.mass) == 15
    assert float(scene.value("clearance")) == pytest.approx(2e-3)
    assert objective == PeakForce()
    assert list(variables) == ["clearance", "length", "section.play.2", "roll_amplitude"]
    assert variables["clearance"] == pytest.approx((0.2e-3, 3e-3))
    assert variables["section.play.2"] == (1e-4, 1e-3)
    assert variables["roll_amplitude"] == pytest.approx(np.radians((0.1, 0.3)))
    limits = {one.name: limit for one, limit in options.pop("constraints").items()}
    assert limits == {"peak_force": (-np.inf, 2e4), "drive_force": (1.0, 50.0)}
    assert type(options.pop("solver")).__name__ == "Tsit5"
    assert options.pop("over")["speed"].tolist() == [1000, 1300, 1600]
    counts = dict(starts=2, seed=4, max_trials=3, transient=7, steps_per_period=50)
    assert options == counts | dict(robust="mean", periodic=True, start=None, progress=False)


def test_a_design_is_found_written_and_drawn(bowl, tmp_path, capsys):
    out = tmp_path / "run"
    text, error = call([*GIVEN, "--speeds", 1000, 1600, 3, "--out", out], capsys)
    assert error == ""  # a bar on terminals only
    assert text.startswith("Design(clearance 1")
    assert "regimes: 1 x irregular, 2 x period 1" in text
    lines = text.splitlines()
    assert [line.split() for line in lines[-5:-1]] == [
        ["speed", "[m/s]", "peak_force", "[kN]", "regime"],
        ["1000", "10", "period", "1"],
        ["1300", "13", "period", "1"],
        ["1600", "16", "+-", "0.1", "irregular"],
    ]
    assert lines[-1] == f"wrote {out}.nc and {out}.png"
    assert "standard error 0.1 kN" in text
    picture(out, 7.2, 5.8)
    ds = dataset(out)
    assert ds.sizes["case"] == 3
    assert ds.attrs["status"] == "converged"
    assert ds["trial_objective"].dims == ("trial", "case")
    np.testing.assert_allclose(ds["design"], [1e-3, 0.31], rtol=0.02)
    np.testing.assert_allclose(ds["low"], [0.2e-3, 0.12])
    found = sj.load_scene(ds, speed=1300.0)
    assert float(found.value("clearance")) == pytest.approx(float(ds["design"][0]))
    assert float(found.speed) == 1300
    made = load_call(ds)
    assert made["function"] == "optimise_design"
    assert [name for name, *_ in made["variables"]] == ["clearance", "length"]
    np.testing.assert_allclose([pair for _, *pair in made["variables"]], [[0.2e-3, 3e-3], [0.12, 0.5]])
    assert Spread(*made["spread"]) == Spread()
    # the same from Python, and the picture of the file
    variables = {name: bounds for name, *bounds in made["variables"]}
    again = optimise_design(sj.paper_scene(), "peak_force", variables, over=dict(made["over"]), steps_per_period=50)
    again.to_netcdf(tmp_path / "again.nc")
    xr.testing.assert_equal(ds, dataset(tmp_path / "again"))
    assert legend(sj.plots.design_cases(ds))[:3] == ["best design", "first design", "worst"]


def test_one_case_and_one_variable_are_enough(bowl, tmp_path, capsys):
    more = ["--minimise", "drive_force", "--speed", 1200, "--starts", 1, "--out", tmp_path / "run"]
    assert call([*CLEARANCE, *more], capsys)[0].splitlines()[-3].split() == ["drive_force", "[N]", "regime"]


def test_an_interrupted_search_gets_a_name_of_its_own(bowl, monkeypatch, tmp_path, capsys):
    def search(*arguments, **options):
        found = optimise_design(*arguments, **options)
        raise sj.Interrupted(found, found.history.sizes["trial"], unit="trials")

    monkeypatch.setattr("slipperjax.design.optimise.optimise_design", search)
    out = tmp_path / "run"
    text, error = call([*GIVEN, "--starts", 1, "--out", out], capsys, 130)
    assert text.startswith("Design(clearance")
    assert f"trials were finished: wrote {out}_partial.nc and {out}_partial.png\ninterrupted\n" in error
    assert names(tmp_path) == ["run_partial.nc", "run_partial.png"]


def test_no_motion_is_exit_code_1(monkeypatch, tmp_path, capsys):
    def lost(self, designs, memory):
        found = judged(self, designs, memory)
        return found._replace(value=np.nan * found.value, status=found.status + 1)

    monkeypatch.setattr(Problem, "judged", lost)
    text, _ = call([*GIVEN, "--speeds", 1000, 1200, 2, "--out", tmp_path / "run"], capsys, 1)
    assert "status: no motion" in text
    assert names(tmp_path) == ["run.nc", "run.png"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::slipperjax.tools.checks.ImplausibleWarning")  # of tight designs' first transients
def test_the_readmes_command_works(tmp_path, capsys):
    more = ["--speeds", 1000, 1600, 2, "--starts", 2, "--max-trials", 3, "--transient", 60]
    text, _ = call([*GIVEN, *more, "--out", tmp_path / "run"], capsys)
    assert "worst of 2 cases" in text
    ds = dataset(tmp_path / "run")
    assert ds.attrs["smooth"] < float(ds["trial_smooth"][0])
    assert np.all(np.isfinite(ds["objective"]))
