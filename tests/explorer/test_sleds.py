"""A page of a sled on four slippers, of which one may be chosen, without a browser."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.explorer.pictures import along, choices
from slipperjax.explorer.session import Case, Session, Shown
from slipperjax.flow.datasets import run_attributes

from ..plots.test_sleds import NAMES, SCENE, moving

pytest.importorskip("bokeh", reason="needs the extra explore")


def run(scene=SCENE, **variables):
    """Gives a run of 20 windows of 1 m, whose highest force is 7 kN at right1_C2 from 12 to 13 m."""
    ends = 1.0 + np.arange(20)
    force = np.broadcast_to(np.arange(80.0).reshape(scene.point_shape), (20, *scene.point_shape)).copy()
    force[12, 2, 1, 2] = 7e3
    data = {"peak_force": (("distance", *scene.point_labels), force), "status": ((), 0)}
    data |= {"steps_per_window": ("distance", np.full(20, 10)), **variables}
    coords = {"distance": ends, "stretch": [10.0, 20.0], **scene.point_labels}
    coords |= {"speed": ("distance", np.full(20, 300.0)), "seconds": ("distance", ends / 300)}
    attrs = run_attributes(scene, sj.Motion(), {"function": "run"}, ()) | {"window [m]": 1.0, "varied": "[]"}
    return xr.Dataset(data, coords, attrs)


def test_a_run_of_a_sled_is_drawn_of_all_slippers_or_of_one():
    session = Session.of(run())
    assert session.case.window == (12.0, 13.0)
    view = session.view
    assert "peak_force" in choices(view)
    assert along(view.of_slipper(""), "peak_force")["y"].max() == 7.0
    one = view.of_slipper("left2")
    assert "peak_force" in choices(one)
    assert along(one, "peak_force")["y"].tolist() == [0.039] * 21
    # a result without slippers has nothing to choose
    assert Session.of(run().isel(slipper=0, drop=True)).view.of_slipper("left2").ds["peak_force"].max() < 7e3


def test_a_window_of_a_worn_sled_has_the_play_of_each_slipper():
    play = 1e-4 * np.arange(1.0, 41.0).reshape(2, 4, 5)
    worn = dataclasses.replace(SCENE, friction=sj.model.Coulomb(0.1), wear=sj.model.Wear(1e-12))
    session = Session.of(run(worn, play=(("stretch", "slipper", "face"), play)))
    scene, _, _ = session.passage(session.case_at({"distance": 18}))
    np.testing.assert_array_equal(scene.play, play[0])
    assert scene.wear is None
    # before the first kept state it is that of the start
    scene, _, _ = session.passage(session.case_at({"distance": 1}))
    np.testing.assert_array_equal(scene.play, worn.play)


@pytest.mark.full
def test_panels_show_the_slipper_that_is_chosen():
    from slipperjax.explorer.panels import Panels

    peak = SimpleNamespace(force=7e3, point=SCENE.point_names.index("right1_C2"))
    motion = SimpleNamespace(scene=SCENE, status=0, peak=peak)
    wave = float(np.asarray(SCENE.wavelength))
    shown = Shown(Case(SCENE, window=(wave, 2 * wave)), motion, moving(), "run", 0)
    chosen = []
    panels = Panels(NAMES, lambda: chosen.append(panels.slipper.value))
    titles = lambda: [f.title.text for f, _, _ in panels.ends.values()]
    panels.show(shown)
    assert "highest force 7 kN at right1_C2" in panels.title.text
    # of all slippers the one with the highest force
    assert titles() == [f"right1 around the rail head, {end}" for end in ("front", "rear")]
    assert panels.lines.data["name"][:2] == ["right1_C2", "right2_J2"]
    assert panels.instant.value == 2
    panels.slipper.value = "left2"
    panels.show(shown)
    assert chosen == ["left2"]
    assert titles()[0] == "left2 around the rail head, front"
    assert panels.lines.data["name"] == [f"left2_{letter}2" for letter in "JIHGFE"]
    assert panels.frames.data["rear_force"].tolist() == [(np.arange(30.0, 40.0) / 1e3).tolist()] * 5
    single = Panels((), lambda: None)
    assert (panels.slipper.visible, single.slipper.visible) == (True, False)
