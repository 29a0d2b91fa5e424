"""Pictures of a sled on four slippers: a run of 30 m, and motions and loads made by hand."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax import plots
from slipperjax.model.kinematics import contacts, rail_frame
from slipperjax.plots.runs import RunView, peak_of
from slipperjax.plots.style import by_contact
from slipperjax.plots.trajectories import most_loaded
from slipperjax.results.run_tables import of_stretches, of_windows

from .shown import bar_of, drawn, legend
from .test_animations import arrows_of, drawn_gaps, points_of

CORNERS = [(1.2, 0.9, "left"), (-1.2, 0.9, "left"), (1.2, -0.9, "right"), (-1.2, -0.9, "right")]
MOUNTS = [sj.Mount(x, y, -0.2, rail=rail) for x, y, rail in CORNERS]
NAMES = ["left1", "left2", "right1", "right2"]


def sled(**parts):
    """Gives a sled at 300 m/s on two random rails."""
    track = sj.model.TwoRails(*(sj.RandomTrack.sled(seed=k, length=200.0) for k in (1, 2)))
    body = sj.Sled(mass=400.0, inertia=(150.0, 300.0, 350.0), mounts=MOUNTS, **parts)
    return dataclasses.replace(sj.paper_scene(speed=300.0), slipper=body, track=track, gravity=9.81)


SCENE = sled()
ANGLES = dict(roll=4e-4, pitch=-1e-4, yaw=1e-4)
MOTION = sj.Motion.from_euler(y=2e-4, z=-3e-4, **ANGLES)


def moving(scene=SCENE):
    """Gives one attitude at 5 instants of 8 m, in which the force of right1_C2 is 7 kN and others are 0 to 79 N."""
    force = np.broadcast_to(np.arange(80.0).reshape(scene.point_shape), (5, *scene.point_shape)).copy()
    force[2, 2, 1, 2] = 7e3
    data = {name: ("time", np.full(5, value)) for name, value in dict(y=2e-4, z=-3e-4, **ANGLES).items()}
    data |= {name: ("time", np.zeros(5)) for name in ("v_y", "v_z", "w_x", "w_y", "w_z")}
    data["contact_force"] = (("time", *scene.point_labels), force)
    coords = {"period": ("time", np.linspace(1.0, 2.0, 5)), **scene.point_labels}
    return xr.Dataset(data, coords, {"status": 0})


@pytest.fixture(scope="module")
def run():
    return sj.run(SCENE, length=30.0, start=sj.Motion())


def test_points_are_named_as_in_their_scene():
    flat = by_contact(moving())
    assert flat["contact"].values.tolist() == SCENE.point_names
    assert flat["contact_force"].values[0].tolist() == list(np.arange(80.0))
    # the same point has another colour on each slipper
    assert len({str(flat["color"].sel(contact=f"{name}_A1").item()) for name in NAMES}) == 4
    one = by_contact(moving().sel(slipper="left2", end="rear"))
    assert one["contact"].values.tolist() == [f"left2_{letter}2" for letter in "ABCDEFGHIJ"]
    assert one["contact_force"].values[0].tolist() == list(np.arange(30.0, 40.0))
    ax = plots.contact_forces(moving(), most=2)
    assert legend(ax) == ["right1_C2, peak 7 kN at 1.5", "right2_J2, peak 0.079 kN at 1"]
    assert drawn(ax.lines[0])[2].tolist() == [1.5, 7.0]
    assert [line.name for line in most_loaded(moving(), 2, "left2")] == ["left2_J2", "left2_I2"]


@pytest.mark.full
def test_each_slipper_s_ends_are_drawn_where_the_model_has_them():
    figure = plots.instant(moving(), SCENE, at=1.5, magnify=2.0, last=None)
    gap = np.asarray(contacts(rail_frame(SCENE, 1.5), MOTION).gap).reshape(8, -1)
    force = moving()["contact_force"].values[2].reshape(8, -1)
    assert [ax.get_title() for ax in figure.axes[:8]] == [f"{name} {e}" for name in NAMES for e in ("front", "rear")]
    for k, ax in enumerate(figure.axes[:8]):
        # in m, of gaps to 1 mm: measured 1e-17
        np.testing.assert_allclose(
            drawn_gaps(ax, np.asarray(SCENE.section.track_points)), 2.0 * gap[k], rtol=0, atol=1e-14
        )
        length = 0.5 * 42.0 / 7e3  # of the section's height, for the highest force of all
        np.testing.assert_allclose(np.linalg.norm(arrows_of(ax), axis=1), length * force[k], rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=r"`run` must have the contact points of its scene, but has .* 20 of 80"):
        plots.animate(moving().sel(slipper="left1"), SCENE)


@pytest.mark.full
def test_a_run_s_page_tables_and_report_name_the_slipper(run, tmp_path):
    # net loads of slippers come first, then single points
    found = {}
    for kind, label in (("peak_slipper_force", "load"), ("peak_force", "contact")):
        force = run[kind].values.reshape(30, -1)
        window, k = np.unravel_index(np.argmax(np.abs(force)), force.shape)
        at = peak_of(run, kind)
        found[label] = at[label].item(), k
        assert float(at[kind]) == force[window, k]
    load, name = (
        f"{NAMES[found['load'][1] // 2]} {('lateral', 'vertical')[found['load'][1] % 2]}",
        found["contact"][0],
    )
    assert found["load"][0] == load
    assert name == SCENE.point_names[found["contact"][1]]
    static = np.abs(run["peak_slipper_force"].sel(axis="z")) / (100 * 9.81)
    np.testing.assert_allclose(run["static_ratio"], static, rtol=1e-9)
    table = of_windows(RunView.of(run))
    wanted = np.where(force.max(axis=1) > 0, np.array(SCENE.point_names)[force.argmax(axis=1)], "")
    assert table["point"].tolist() == wanted.tolist()
    assert table["impacts"].tolist() == run["impacts"].values.reshape(30, -1).sum(axis=1).tolist()
    # mean forces of slippers, whose mean counts
    column = of_stretches(table)["slipper_force left2 vertical"]
    wanted = run["slipper_force"].sel(slipper="left2", direction="vertical").mean("distance")
    np.testing.assert_allclose(column, [float(wanted)], rtol=1e-12)  # measured 0
    lines = "\n".join(run.summary())
    assert f"at {name} (" in lines
    assert re.search(f"greatest net vertical .* at {load.split()[0]}, ", lines)
    axes = plots.run_overview(run)
    assert legend(axes[0]) == ["left lateral", "right lateral"]
    assert f": {load}, " in legend(axes[3])[-1]
    assert f": {name}, " in legend(axes[4])[-1]
    each = run["impact_rate"].sum(("end", "point")).values
    assert [patch.get_data()[0].tolist() for patch in axes[5].patches] == each.T.tolist()
    assert run.write(*(tmp_path / f"sled.{ending}" for ending in ("pdf", "csv", "xlsx"))).startswith("wrote ")


@pytest.mark.full
def test_a_plan_has_each_slipper_at_its_place_coloured_by_its_force(run):
    half = np.ptp(np.asarray(SCENE.section.points)[:, 0]) / 2
    ax = plots.plan(run)
    for area, (x, y, _) in zip(ax.collections, CORNERS, strict=True):
        box = area.get_paths()[0].get_extents()
        assert box.extents == pytest.approx([x - 0.1, y - half, x + 0.1, y + half])
    highest = np.abs(run["peak_slipper_force"]).max(("distance", "axis")).values / 1e3
    texts = [text.get_text() for text in ax.texts]
    assert texts == [f"{name}\n{force:.4g} kN" for name, force in zip(NAMES, highest, strict=True)]
    assert bar_of(ax).get_ylim() == pytest.approx((0.0, highest.max()))
    # of runs with 1, 3 and 2 times the forces the median has twice the forces
    many = xr.concat([run.assign(peak_slipper_force=k * run["peak_slipper_force"]) for k in (1, 3, 2)], "mass")
    several = plots.plan(many.assign_coords(mass=[400.0, 410.0, 420.0]))
    assert bar_of(several).get_ylim() == pytest.approx((0.0, 2 * highest.max()))
    assert bar_of(several).get_ylabel().startswith("median of 3 runs:\npeak slipper force")
    # a single slipper, and a run whose numbers mean nothing
    assert [text.get_text() for text in plots.plan(sj.paper_scene()).texts] == ["slipper"]
    lost = plots.plan(run.assign(status=int(sj.Status.DERAILED), window_status=("distance", np.full(30, 2))))
    assert not any(np.isfinite(float(text.get_text().split()[1])) for text in lost.texts)


@pytest.mark.full
def test_loads_are_shared(run):
    """By slippers that carry 1, 2, 3 and 4 kN, which swing by 1 kN from window to window."""
    vertical = 1e3 * np.arange(1.0, 5.0) + 1e3 * (-1.0) ** np.arange(30)[:, None]
    force = np.stack([0.1 * vertical * [1, -1, 1, -1], vertical], axis=-1)
    data = {"slipper_force": (("distance", "slipper", "direction"), force, {"units": "N"})}
    data["slipper_roll"] = (("distance", "slipper"), 0.9 * vertical * [1, 1, -1, -1], {"units": "N m"})
    ds = run.assign(data).assign_coords(direction=["lateral", "vertical"])
    axes = plots.load_sharing(ds, [0.1, 0.2, 0.3, 0.4])
    assert [ax.get_ylabel().split("\n")[1] for ax in axes] == ["vertical load", "lateral load", "roll moment"]
    assert [line.get_ydata()[0] for line in axes[0].lines] == pytest.approx([0.1, 0.3, 0.6])
    for ax in axes:
        for k, area in enumerate(ax.collections):
            places, heights = area.get_paths()[0].vertices.T
            # of ten windows the swing is zero, and shares are those of magnitudes
            inside = (places > 6) & (places < 24)
            ends = np.cumsum([0.0, 0.1, 0.2, 0.3, 0.4])[k : k + 2]
            assert sorted(set(heights[inside].round(9))) == pytest.approx(ends, abs=1e-9)
    with pytest.raises(ValueError, match=r"`ds` must be a dataset of one run, .* with `slipper_force`"):
        plots.load_sharing(run.drop_vars("slipper_force"))
    with pytest.raises(ValueError, match="`static` must have a share for each of 4 slippers"):
        plots.load_sharing(ds, [0.5, 0.5])


@pytest.mark.full
def test_an_elastic_sled_s_slippers_are_drawn_where_its_mode_has_them():
    """A mode that moves the second slipper upwards by 0.4 mm."""
    shapes = np.zeros((1, 4, 3))
    shapes[0, 1, 2] = 0.05
    scene = sled(modes=sj.model.Modes([50.0], [0.02], shapes))
    still = lambda q, modes: sj.State(sj.Motion(modes=modes), jnp.zeros(80) * q)
    elastic = lambda q: still(q, sj.model.ModalMotion(q[None], 0 * q[None]))
    states = [jax.vmap(elastic)(jnp.full(3, 8e-3)), jax.vmap(lambda q: still(q, None))(jnp.zeros(3))]
    tops = []
    for of, state in zip((scene, SCENE), states, strict=True):
        period = jnp.asarray([1.0, 1.5, 2.0])
        one = sj.orbits.Trajectory(of, period, state, 50, jnp.full(2, 50), jnp.asarray(0), None)
        figure = plots.instant(one, magnify=1.0, last=None)
        tops.append([points_of(ax)[0, 1] for ax in figure.axes[:8:2]])
    # mm: measured 2e-8 less than 0.4
    np.testing.assert_allclose(np.subtract(*tops), [0.0, 0.4, 0.0, 0.0], rtol=0, atol=1e-7)
