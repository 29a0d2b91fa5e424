"""What all results can do: words, parts, pictures and files."""

import copy
import pickle

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.model.quantities import SECTIONS
from slipperjax.plots import sweeps
from slipperjax.results.kinds import KINDS


def over(*dims, **variables):
    """A sweep over some parameters, with variables over these and further dimensions."""
    sizes = [2] * len(dims)
    data = {name: ((*dims, *more), np.zeros([*sizes, *[2] * len(more)])) for name, more in variables.items()}
    data |= {"status": (dims, np.zeros(sizes, int)), "steps_per_period": (dims, np.full(sizes, 40))}
    return sj.Result(xr.Dataset(data, attrs={"call": '{"function": "sweep"}'}))


@pytest.fixture
def drawn(monkeypatch):
    """Replaces each picture by its name; gives what was asked of them."""
    asked = []
    named = [(names, count, draw.__name__) for names, count, draw in sweeps.PICTURES]
    note = lambda name: lambda ds, **options: np.array(asked.append((name, options)))
    monkeypatch.setattr(sweeps, "PICTURES", tuple((names, count, note(name)) for names, count, name in named))
    monkeypatch.setattr(sweeps, "quantity_map", note("quantity_map"))
    return asked


@pytest.mark.parametrize(
    ("result", "show", "name"),
    [
        (over(contact_force=["time"]), {}, "overview"),
        (over("speed", "length", regime=[], exponent=[], kind=[], period=[]), {}, "regime_map"),
        (over("speed", regime=[], exponent=[]), {}, "exponents"),
        (over("speed", regime=[], exponent=[]), {"show": "exponent"}, "quantity_map"),
        (over("speed", "length", kind=[], period=[]), {}, "attractor_map"),
        (over("speed", **{name: ["crossing"] for name in SECTIONS}, strobe=["strobe_period"]), {}, "bifurcations"),
        (over("speed", strobe=["strobe_period"], peak_force=["end", "point"]), {}, "quantity_map"),
    ],
)
def test_each_sweep_has_its_picture_or_that_of_a_chosen_variable(result, show, name, drawn):
    result.plot(**show)
    assert drawn == [(name, {"name": show.get("show", "peak_force")} if name == "quantity_map" else {})]


def test_sweeps_over_many_parameters_say_that_no_picture_fits():
    with pytest.raises(ValueError, match=r"`result` must have a picture that fits, but is over .*\.isel"):
        over("speed", "length", "mass", kind=[]).plot()


def test_results_are_at_hand_as_their_datasets_are():
    result = over("speed", peak_force=["point"])
    assert (result["peak_force"].dims, result.sizes["speed"]) == (("speed", "point"), 2)
    assert "peak_force" in result
    assert list(result) == list(result.ds)
    assert len(result) == len(result.ds)
    assert {"peak_force", "summary", "isel"} <= set(dir(result))
    # parts are results, and all else is what xarray makes of it
    part = result.isel(speed=1)
    assert isinstance(part, sj.Result)
    assert part.status == sj.Status.FINITE
    assert result.status.dims == ("speed",)
    assert isinstance(result.max(), xr.Dataset)
    for again in (copy.copy(result), pickle.loads(pickle.dumps(result))):
        xr.testing.assert_identical(again.ds, result.ds)
    with pytest.raises(AttributeError, match="nothing"):
        _ = result.nothing


def test_results_say_themselves_and_what_they_have():
    result = over("speed", peak_force=["point"])
    assert repr(result).splitlines() == [
        "Result",
        "  2 cases, 40 steps per period",
        "  0 cases flagged",
        "  variables peak_force, status and steps_per_period; dimensions speed 2 and point 2",
    ]
    assert "2 cases, 40 steps per period" in result._repr_html_()
    kinds = dict(kind=("speed", ["period", "unresolved"]), status=("speed", [1, 0]))
    words = sj.Result(result.ds.assign(kinds)).summary()
    # the motion of a flagged case is not known
    assert words[2] == "by recurrence: 0 periodic, 0 regular, 0 chaotic, 2 unresolved"
    assert "peak_force" in result._repr_html_()


def test_tables_of_cases_join_points_and_name_what_they_leave_out():
    result = over(
        "speed", peak_force=["end", "point"], peak_period=["end", "point"], exponent=["count"], v_y=["crossing"]
    )
    forces = np.array([[[1.0, 2.0], [3.0, 4.0]], [[1.0, np.nan], [5.0, 6.0]]])
    loads = dict(
        impulse=(("speed", "end", "point"), forces, {"units": "N s"}),
        peak_force=(("speed", "end", "point"), 1e3 * forces),
        peak_slipper_force=(("speed", "axis"), [[1e3, -3e3], [1e3, 2e3]]),
        exponent=(("speed", "count"), [[0.5, 0.0], [0.1, -0.2]]),
    )
    given = sj.Result(result.ds.assign(loads).assign_coords(speed=[1.0, 2.0], scene_number=("speed", [1e9, 1e9])))
    with pytest.warns(UserWarning, match=r"^The table leaves out peak_period and v_y, with several values in each"):
        table = given.tables()["cases"]
    wanted = {
        "speed [m/s]": [1.0, 2.0],
        "peak_force [kN]": [4.0, np.nan],
        "exponent": [0.5, 0.1],
        "status": [0, 0],
        "steps_per_period": [40, 40],
        "impulse [N s]": [10.0, np.nan],
        "peak_slipper_force [kN]": [3.0, 2.0],
    }
    pd.testing.assert_frame_equal(table, pd.DataFrame(wanted), check_like=True)


def test_each_question_has_a_kind_of_result_and_datasets_of_others_are_refused():
    questions = {
        "simulate",
        "sweep",
        "follow",
        "run",
        "compare",
        "environment",
        "loads",
        "optimise_design",
        "fit",
        "telemetry",
        "basins",
    }
    assert questions | {"periodic_orbit", "continue_orbit", "continue_event", "continue_motion"} == set(KINDS)
    with pytest.raises(ValueError, match=r"`source` must be a result of slipperjax, but is a dataset with no attr"):
        sj.load(xr.Dataset())
    with pytest.raises(ValueError, match=r"`result` must be of one of simulate, .* but is 'tomorrow'"):
        sj.load(xr.Dataset(attrs={"call": '{"function": "tomorrow"}'})).summary()


def test_writing_a_picture_keeps_the_backend_of_the_session_and_leaves_no_figure_open(tmp_path):
    before = plt.get_backend()
    plt.switch_backend("svg")
    try:
        over("speed", strobe=["strobe_period"]).write(tmp_path / "strobes.png", tmp_path / "strobes.pdf")
        assert plt.get_backend() == "svg"
        assert plt.get_fignums() == []
    finally:
        plt.switch_backend(before)
    assert (tmp_path / "strobes.png").read_bytes()[:4] == b"\x89PNG"
