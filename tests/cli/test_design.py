"""The command that chooses parameters by an objective."""

import re

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli.design import OBJECTIVE_UNITS
from slipperjax.design import EnsembleSettings
from slipperjax.design.objectives import OBJECTIVES
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import Problem
from slipperjax.flow.datasets import load_call

from ..design.bowl import evaluate
from .commands import call, dataset, error_of, names, picture

VARIED = ["--vary", "clearance", 0.2, 3, "--vary", "length", 0.12, 0.5]
PEAK = ["--minimise", "peak_force", "--vary"]
GIVEN = ["design", "--minimise", "peak_force", *VARIED, "--no-check", "--no-margins", "--steps-per-period", 50]


LIMIT = ["--constraint", "drive_force"]


@pytest.fixture
def bowl(monkeypatch):
    monkeypatch.setattr(Problem, "evaluate", evaluate)


# options


def test_the_help_names_every_objective_with_its_unit(capsys):
    assert {name: one.quantity.display_unit for name, one in OBJECTIVES.items()} == OBJECTIVE_UNITS
    text = " ".join(call(["design", "--help"], capsys)[0].split())
    assert "Objective to minimise: peak_slipper_force [kN], " in text
    assert "Design variable with its lower and upper bound; repeat for several. Parameters: speed [m/s]" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (VARIED, "Missing option '--minimise'"),
        (["--minimise", "foo", *VARIED], "'foo' is not one of 'peak_slipper_force', "),
        (["--minimise", "peak_force"], "Missing option '--vary'"),
        ([*PEAK, "clearance", 3, 0.2], "Option --vary must have two bounds, the smaller first, but has 3 to 0.2 mm"),
        ([*PEAK, "clearance", -1, 3], "`clearance` must be zero or positive, but is -0.001 m"),
        ([*PEAK, "length", "long", 3], "`length` must be a number with a unit"),
        ([*PEAK, "gravity", 1, 10], "the scene has no gravitational acceleration"),
        ([*PEAK, "foo", 1, 2], "`foo` is no parameter; the names are speed, "),
        ([*PEAK, "section.foo", 1, 2], "`section.foo` leads to no number"),
        ([*GIVEN[1:], "--vary", "length", 1, 2], "Option --vary must name each parameter once, but is 'length'"),
        ([*GIVEN[1:], "--speeds", 1600, 1000, 3], "but is 1600 to 1000 m/s and 3"),
        ([*GIVEN[1:], "--speeds", 1000, 1600, 3, "--speed", 1250], "--speeds must not be given with --speed"),
        ([*GIVEN[1:], "--robust", "best"], "'best' is not one of 'worst', 'mean'"),
        ([*GIVEN[1:], *LIMIT, 3, 1], "`constraints` must have a highest value or (low, high)"),
        ([*GIVEN[1:], *LIMIT, 1, 3, *LIMIT, 1, 3], "--constraint must name each objective once"),
        ([*GIVEN[1:], "--starts", 0], "'--starts': 0 is not in the range x>=1"),
    ],
)
def test_wrong_input_is_one_line(arguments, words, tmp_path, capsys):
    # without --out behind, which would be read as a bound
    assert words in error_of(["design", "--out", tmp_path / "run", *arguments], capsys)
    assert names(tmp_path) == []


def test_options_reach_the_search(bowl, replaced, tmp_path, capsys):
    search = replaced("design.optimise.optimise_design", side_effect=optimise_design)
    more = ["--robust", "mean", "--constraint", "peak_force", "-inf", 20]
    more += ["--constraint", "drive_force", 1, 50]
    more += ["--starts", 2, "--seed", 4, "--max-trials", 3, "--transient", 7, "--mass", 15]
    call([*GIVEN, *more, "--solver", "Tsit5", "--out", tmp_path / "run.nc"], capsys)
    (scene, objective, variables), options = search.call_args
    assert float(scene.slipper.mass) == 15
    assert objective == OBJECTIVES["peak_force"]
    assert list(variables) == ["clearance", "length"]
    limits = {one.name: limit for one, limit in options.pop("constraints").items()}
    assert limits == {"peak_force": (-np.inf, 2e4), "drive_force": (1.0, 50.0)}
    assert type(options.pop("solver")).__name__ == "Tsit5"
    assert options == {
        **dict(over=None, robust="mean", starts=2, seed=4, max_trials=3, transient=7),
        **dict(steps_per_period=50, start=None, progress=True),
    }
    assert (tmp_path / "run.nc").exists()


# results


@pytest.mark.full
def test_a_design_is_found_written_and_drawn(bowl, tmp_path, capsys):
    out = tmp_path / "run"
    text, error = call([*GIVEN, "--speeds", 1000, 1600, 3, "--out", out], capsys)
    assert "\r" not in error  # a bar on terminals only, lines elsewhere
    assert error.splitlines()[-1].startswith("design for peak_force: 90 trials")
    # the bowl's, as near as the least region of the search: measured 0.99968 mm
    assert float(re.search(r"\nbest design: clearance (\S+) mm", text)[1]) == pytest.approx(1.0, abs=1e-3)
    lines = text.splitlines()
    assert [line.split() for line in lines[-6:-2]] == [
        ["speed", "[m/s]", "peak_force", "[kN]", "motion"],
        ["1000", "10", "period", "1"],
        ["1300", "13", "period", "1"],
        ["1600", "16", "+-", "0.1", "chaotic"],
    ]
    assert lines[-1] == f"wrote {out}.nc and {out}.png"
    picture(out, 7.2, 5.8)
    ds = dataset(out)
    np.testing.assert_allclose(ds["design"], [1e-3, 0.31], rtol=0.02)
    found = sj.load(f"{out}.nc").isel(case=1).scene
    assert float(found.value("clearance")) == pytest.approx(float(ds["design"][0]))
    made = load_call(ds)
    assert EnsembleSettings(*made["ensemble"]) == EnsembleSettings()
    # the same from Python
    variables = {name: bounds for name, *bounds in made["variables"]}
    again = optimise_design(sj.paper_scene(), "peak_force", variables, over=dict(made["over"]), steps_per_period=50)
    again.write(tmp_path / "again.nc")
    xr.testing.assert_equal(ds, dataset(tmp_path / "again"))


def test_an_interrupted_search_gets_a_name_of_its_own(bowl, replaced, tmp_path, capsys):
    def search(*arguments, **options):
        found = optimise_design(*arguments, **options)
        raise sj.Interrupted(found, found.history.sizes["trial"], unit="trials")

    replaced("design.optimise.optimise_design", side_effect=search)
    out = tmp_path / "run"
    text, error = call([*GIVEN, "--starts", 1, "--out", out], capsys, 130)
    assert text.startswith("status: ")
    assert f"trials were finished: wrote {out}_partial.nc and {out}_partial.png\ninterrupted\n" in error
    assert names(tmp_path) == ["run_partial.nc", "run_partial.png"]


def test_no_motion_is_exit_code_1(monkeypatch, tmp_path, capsys):
    def lost(self, designs, warm_start):
        cases = evaluate(self, designs, warm_start)
        return cases._replace(value=np.nan * cases.value, status=cases.status + 1)

    monkeypatch.setattr(Problem, "evaluate", lost)
    text, _ = call([*GIVEN, "--speeds", 1000, 1200, 2, "--out", tmp_path / "run"], capsys, 1)
    # no number before or after it, but those of the case and of files
    assert text.startswith("status: no motion: no design that was tried stays on the rail; raise ")
    assert "peak_force" not in text
    assert (tmp_path / "run.png").exists()
