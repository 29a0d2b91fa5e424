"""What a page shows and computes, without Bokeh."""

import dataclasses
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.explorer.pictures import choices, dots, image, picture_of
from slipperjax.explorer.scripts import python_of, scene_text, start_text
from slipperjax.explorer.session import Session, _on_grid
from slipperjax.explorer.worker import Worker
from slipperjax.flow.datasets import run_attributes
from slipperjax.flow.status import Status
from slipperjax.model import scene_to_json
from slipperjax.plots.style import MOTION_COLORS
from slipperjax.sweeps.grid import Cases

SPEEDS, CLEARANCES = np.array([500.0, 1000.0, 2000.0]), np.array([1e-3, 2e-3])


def a_map(**variables):
    """A dataset of a sweep over clearance and speed, with numbers made up."""
    scene, dims = sj.paper_scene(), ("clearance", "speed")
    kinds = np.array([["period", "period", "chaotic"], ["torus", "unresolved", "period"]])
    data = {"kind": (dims, kinds), "period": (dims, np.array([[1, 7, 0], [0, 0, 3]]))}
    data |= {"status": (dims, np.array([[0, 0, 0], [0, 1, 7]])), **variables}
    attrs = run_attributes(scene, sj.table_2_start(), {"function": "sweep"}, dims) | {"measured": 200}
    return xr.Dataset(data, {"clearance": CLEARANCES, "speed": SPEEDS}, attrs)


def test_a_click_gives_the_case_of_its_cell():
    session = Session.of(a_map())
    index = session.nearest(1.2e-3, 1900.0)
    assert index == {"clearance": 0, "speed": 2}
    session.case = session.case_at(index)
    assert session.place() == pytest.approx([1e-3, 2000.0])


def test_a_box_is_finer_within_the_map_and_holds_whole_seeds():
    session = Session.of(a_map())
    assert session.box((1e-3, 1e-3), (600.0, 900.0)) is None
    box = session.box((5e-4, 1.5e-3), (1500.0, 600.0))
    assert box.grid["clearance"][[0, -1]] == pytest.approx([1e-3, 1.5e-3])
    assert box.grid["speed"][[0, -1]] == pytest.approx([600.0, 1500.0])
    assert tuple(map(len, box.grid.values())) == (16, 25)
    ds = a_map().rename(speed="track.seed").assign_coords({"track.seed": [0.0, 50.0, 99.0]})
    scene = dataclasses.replace(sj.paper_scene(), track=sj.RandomTrack.sled(length=200.0))
    ds.attrs |= run_attributes(scene, sj.table_2_start(), {"function": "sweep"}, ds["kind"].dims)
    session = Session.of(ds)
    np.testing.assert_array_equal(session.box((5e-4, 1.5e-3), (2.5, 6.5)).grid["track.seed"], [3, 4, 5, 6])
    assert session.box((5e-4, 1.5e-3), (2.5, 3.5)) is None


@pytest.mark.full
@pytest.mark.parametrize(
    ("grid", "name"),
    [({"clearance": [1e-3, 2e-3], "speed": [900.0, 1500.0]}, "kind"), ({"speed": [900.0, 1500.0]}, "v_z")],
)
@pytest.mark.filterwarnings("ignore:Argument `periods` is 16")
def test_a_part_of_a_map_is_on_its_grid(grid, name):
    cases = Cases(sj.paper_scene(), grid, sj.table_2_start())
    values = cases.part(np.unravel_index([1], cases.shape))
    record = ["motion", "sections"] if name == "kind" else "sections"
    piece = sj.sweep(sj.paper_scene(), values, product=False, record=record, transient=1, periods=16)
    ds = _on_grid([piece], np.array([1]), cases)
    assert ds["status"].dims == cases.dims
    assert ds["status"].values.ravel()[1] == 0
    assert (np.delete(ds["status"].values.ravel(), 1) == Status.NOT_RUN).all()
    other = _on_grid([piece, piece], np.array([1, 0]), cases)
    np.testing.assert_array_equal(
        other[name][{d: 0 for d in cases.dims}],
        ds[name].isel(dict.fromkeys(cases.dims[:-1], 0)).isel({cases.dims[-1]: 1}),
    )


def test_sources_that_are_no_maps_are_named(tmp_path):
    for source in (tmp_path / "none.zarr", tmp_path / "none.nc", tmp_path, 3, xr.Dataset()):
        with pytest.raises((ValueError, OSError), match=r"source|No such file|none.nc"):
            Session.of(source)
    with pytest.raises(ValueError, match="one or two parameters"):
        Session.of(None, {"speed": [1000.0, 2000.0], "clearance": [1e-3], "length": [0.2]})
    deep = a_map().expand_dims(length=[0.2]).assign_attrs(varied='["length", "clearance", "speed"]')
    with pytest.raises(ValueError, match="one or two parameters"):
        Session.of(deep)


@pytest.fixture(scope="module")
def along():
    """A run of 130 windows, of which the states after 100 and 130 m are kept."""
    return sj.run(sj.paper_scene(), length=130.0, speed=sj.SpeedProgramme.over_distance([0.0, 130.0], [100.0, 200.0]))


@pytest.mark.slow
def test_a_window_of_a_run_is_a_case_with_the_same_forces(along):
    session = Session.of(along)
    highest = along["peak_force"].max(("end", "point"))
    assert session.case.window[1] == along["distance"][highest.values.argmax()]
    session.case = session.case_at(session.nearest(119.7))
    assert session.case.window == (119.0, 120.0)
    assert session.place() == [119.5]
    (shown,) = session.look(session.case)
    distance = shown.unit * shown.ds["period"].values
    assert distance[[0, -1]] == pytest.approx([112.0, 120.0])
    found = shown.run.ds["peak_force"].max("point")
    there = along["peak_force"].sel(distance=slice(112.5, 120.0)).max(("distance", "point"))
    np.testing.assert_allclose(found, there, rtol=1e-4)  # the steps differ: measured 5e-6


@pytest.mark.slow
def test_a_script_computes_what_is_shown_of_a_run(along, tmp_path):
    along.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    session = Session.of(tmp_path / "run.nc")
    session.case = session.case_at(session.nearest(119.7))
    (session.shown,) = session.look(session.case)
    lines = [line for line in python_of(session).splitlines() if not line.startswith("sj.plots")]
    names = {}
    exec("\n".join(lines), names)
    np.testing.assert_array_equal(names["run"].state.motion.y, session.shown.run.state.motion.y)


@pytest.mark.parametrize(
    "scene", [sj.paper_scene(1234.5, 7e-4, restitution=0.5), sj.paper_scene().replace(**{"section.play.2": 4e-4})]
)
def test_a_scene_in_a_script_is_the_same_to_the_last_bit(scene):
    assert scene_to_json(eval(scene_text(scene), {"sj": sj})) == scene_to_json(scene)


def test_a_path_in_a_script_is_the_same_whatever_is_in_it(tmp_path):
    folder = tmp_path / 'a \\n\'b\' "c" """d'
    folder.mkdir()
    rail, result = folder / "rail.csv", folder / "map.nc"
    rail.write_text("distance [m], lateral [mm], vertical [mm]\n" + "".join(f"{k}, 0, 0\n" for k in range(50)))
    scene = dataclasses.replace(sj.paper_scene(), track=sj.load_rail(rail))
    assert scene_to_json(eval(scene_text(scene), {"sj": sj})) == scene_to_json(scene)
    a_map().to_netcdf(result, engine="h5netcdf")
    (line,) = [line for line in python_of(Session.of(result)).splitlines() if line.startswith("given = ")]
    names = {"sj": sj}
    exec(line, names)
    assert names["given"].equals(a_map())


@pytest.mark.parametrize(
    "start",
    [
        sj.State(sj.Motion(y=0.1 + 0.2, w_x=-3e-7), jnp.arange(3.0) / 7),
        sj.Motion(y=1 / 3, modes=sj.model.ModalMotion(jnp.array([0.1 + 0.2, 0.0]), jnp.array([1e-3, -3e-7]))),
    ],
    ids=["state", "modes"],
)
def test_a_start_in_a_script_is_the_same_to_the_last_bit(start):
    again = eval(start_text(start), {"sj": sj, "jnp": jnp})
    assert jax.tree.structure(again) == jax.tree.structure(start)
    jax.tree.map(np.testing.assert_array_equal, again, start)


def test_a_script_computes_the_map_that_is_shown():
    session = Session.of()
    names = {}
    lines = [line for line in python_of(session).splitlines() if not line.startswith(("map", "run", "ds", "sj."))]
    exec("\n".join(lines), names)
    grid = next(line for line in python_of(session).splitlines() if line.startswith("map = "))
    made = eval(grid[grid.index("{") : grid.index("}") + 1], names)
    assert all(np.array_equal(made[name], values) for name, values in session.view.grid.items())
    assert scene_to_json(names["scene"]) == scene_to_json(session.view.scene)


def test_kinds_of_motions_have_their_colours_and_missing_ones_none():
    picture = picture_of(Session.of(a_map()).view, "motion")
    kinds = list(picture.colors)
    names = [None if np.isnan(k) else kinds[int(k)] for k in picture.values.ravel()]
    assert names == ["period 1", "other periods", "chaotic", "quasi-periodic", "not trusted", None]
    assert picture.colors["chaotic"] == MOTION_COLORS["chaotic"]
    # chaos is named with its least mean life
    dims = ("clearance", "speed")
    life = np.where(a_map()["kind"] == "chaotic", 3365.1, np.nan)
    view = Session.of(a_map(least_mean_life=(dims, life))).view
    assert "chaotic (mean life 3365 periods or more)" in picture_of(view, "motion").colors


def test_numbers_are_the_highest_of_all_points_in_their_display_unit():
    force = (("clearance", "speed", "point"), np.arange(12.0).reshape(2, 3, 2) * 1e3)
    view = Session.of(a_map(peak_force=force)).view
    assert "peak_force" in choices(view)
    values = picture_of(view, "peak_force").values
    assert values[0].tolist() == [1.0, 3.0, 5.0]
    assert np.isnan(values[1, 1:]).all()
    line = Session.of(a_map(peak_force=force).isel(clearance=0, drop=True).assign_attrs(varied='["speed"]')).view
    assert dots(line, "peak_force")["y"].tolist() == [1.0, 3.0, 5.0]


@pytest.mark.parametrize("x", [np.array([1.0, 2.0, 3.0]), np.array([3.0, 2.0, 1.0]), np.array([1.0, 2.0, 7.0])])
def test_an_image_has_each_value_where_its_cell_is(x):
    y, values = np.array([5.0, 6.0]), np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    drawn = image(x, y, values)
    pixels, (left,), (width,) = drawn["image"][0], drawn["x"], drawn["dw"]
    for k, place in enumerate(x):
        column = min(int((place - left) / width * pixels.shape[1]), pixels.shape[1] - 1)
        assert pixels[[0, -1], column].tolist() == values[:, k].tolist()
    assert drawn["dh"] == [2.0]


class Collected:
    """What a worker delivers."""

    def __init__(self):
        self.pieces, self.errors, self.end = [], [], threading.Event()
        self.worker = Worker(("first", "second"), lambda piece, wanted: self.pieces.append(piece), self.ended)

    def ended(self, error):
        self.errors.append(error)
        if not self.worker.is_busy():
            self.end.set()


@pytest.fixture
def work():
    work = Collected()
    yield work
    work.worker.close()


def test_a_job_delivers_its_pieces_and_says_its_error(work):
    def job():
        yield 1
        raise ValueError("no")

    work.worker.submit("first", job())
    assert work.end.wait(10)
    assert work.pieces == [1]
    assert str(work.errors[0]) == "no"
    work.end.clear()
    work.worker.submit("second", iter([2]))  # it lives on
    assert work.end.wait(10)
    assert work.pieces == [1, 2]


def held(at, go, piece="late"):
    """A job that says when it is in its second piece, and waits there."""
    yield "begun"
    at.set()
    go.wait(10)
    while True:
        yield piece


@pytest.mark.parametrize("stopped", [True, False])
def test_a_stop_or_a_later_job_leaves_a_job_between_its_pieces(work, stopped):
    at, go = threading.Event(), threading.Event()
    work.worker.submit("first", held(at, go))
    assert at.wait(10)
    if stopped:
        work.worker.stop()
        assert not work.worker.is_busy()
    work.worker.submit("first", iter(["second"]))
    go.set()
    assert work.end.wait(10)
    assert [piece for piece in work.pieces if piece != "late"] == ["begun", "second"]
    assert work.errors == [None]


def test_urgent_jobs_come_first(work):
    at, go = threading.Event(), threading.Event()
    slow = held(at, go)
    work.worker.submit("second", (next(slow) for _ in range(3)))
    assert at.wait(10)
    work.worker.submit("first", iter(["urgent"]))
    go.set()
    assert work.end.wait(10)
    assert work.pieces == ["begun", "late", "urgent", "late"]
