"""Surveys in files: columns, units, chords, scenes that name them, and what is wrong by file and line."""

import dataclasses
import math

import h5py
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io
import xarray as xr

import slipperjax as sj
from slipperjax.model.scene_files import scene_from_json, scene_from_toml, scene_to_json
from slipperjax.model.surveys import JOINTS

DISTANCE = np.arange(0.0, 60.01, 0.25)
LATERAL, VERTICAL = 1e-3 * np.sin(2 * np.pi * DISTANCE / 8), 5e-4 * np.cos(2 * np.pi * DISTANCE / 12)
PLACES = jnp.asarray(np.linspace(10.0, 50.0, 200))


def written(folder, header="chainage [ft], lateral [mm], vertical [in]", rows=None, name="survey.csv", delimiter=";"):
    rows = np.column_stack([DISTANCE / 0.3048, LATERAL * 1e3, VERTICAL / 0.0254]) if rows is None else rows
    cells = [delimiter.join(map(repr, row)) for row in rows.tolist()]
    path = folder / name
    path.write_text("\n".join([header.replace(",", delimiter), "# measured in spring", *cells]))
    return path


@pytest.fixture
def survey(tmp_path):
    return written(tmp_path)


def same(track):
    here, exact = track.irregularity(PLACES), sj.model.SampledTrack(DISTANCE, LATERAL, VERTICAL).irregularity(PLACES)
    # near the rail's ends; measured 3e-14 m
    np.testing.assert_allclose(here.lateral, exact.lateral, rtol=0, atol=1e-13)
    np.testing.assert_allclose(here.vertical, exact.vertical, rtol=0, atol=1e-13)
    assert here.roll is None
    return True


def test_tables_and_netcdf_files_are_read_in_their_units(tmp_path, survey):
    assert same(sj.load_rail(survey))
    with h5py.File(tmp_path / "survey.nc", "w") as file:
        for name, values, unit in (("distance", DISTANCE, "m"), ("y", LATERAL * 1e6, "um"), ("z", VERTICAL, "m")):
            file[name] = values
            file[name].attrs["units"] = unit
    assert same(sj.load_rail(tmp_path / "survey.nc"))
    alone = written(
        tmp_path, "distance [m], roll [mrad], z [mm]", np.column_stack([DISTANCE, LATERAL, VERTICAL * 1e3])
    )
    here = sj.load_rail(alone).irregularity(PLACES)
    assert float(np.max(np.abs(here.lateral))) == 0.0
    np.testing.assert_allclose(here.roll, 1e-6 * np.sin(2 * np.pi * PLACES / 8), rtol=0, atol=1e-11)


def test_scenes_name_the_file_and_find_its_content_again(tmp_path, survey):
    scene = dataclasses.replace(sj.paper_scene(), track=sj.load_rail(survey, ends="error"))
    text = scene_to_json(scene)
    assert len(text) < 1500
    assert "survey.csv" in text
    assert scene_from_json(text).track == scene.track
    assert same(scene_from_toml(scene.to_toml()).scene.track)
    (tmp_path / "scene.toml").write_text('base = "paper"\n[track]\nfile = "survey.csv"\nends = "error"\n')
    assert same(sj.load(tmp_path / "scene.toml").scene.track)
    survey.write_text(survey.read_text().replace("# measured in spring", "# changed"))
    with pytest.raises(ValueError, match="`sha256` must be the content with which the scene was made"):
        scene_from_json(text)


@pytest.mark.parametrize(
    ("length", "chord", "wavelength", "found"),
    # largest RMS found of the error, in all and in the middle half, over the amplitude
    [(400.0, 5.0, 8.0, (0.014, 0.0017)), (400.0, 18.9, 12.0, (0.029, 0.0053)), (300.0, 18.9, 60.0, (0.066, 0.03))],
)
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.5])
def test_chords_are_turned_into_displacements(tmp_path, length, chord, wavelength, found, phase):
    """Of a sine, the middle of a chord shows the share 1 - cos(pi chord / wavelength)."""
    distance = np.arange(0.0, length + 0.01, 0.25)
    wave = np.sin(2 * np.pi * distance / wavelength + phase)
    # with a steady fault of the chord, which is no wave
    shown = (1 - np.cos(np.pi * chord / wavelength)) * wave + 0.5
    rows = np.column_stack([distance, shown, 0 * wave])
    track = sj.load_rail(written(tmp_path, "distance [m], lateral [mm], vertical [mm]", rows), chord=chord)
    fault = np.asarray(track.lateral) / 1e-3 - wave
    quarter = len(wave) // 4
    assert np.std(fault) < 3 * found[0]
    assert np.std(fault[quarter:-quarter]) < 3 * found[1]


HEADER = "distance [m], lateral [mm], vertical [mm]"


@pytest.mark.parametrize(
    ("header", "cells", "words"),
    [
        ("distance [m], lateral, vertical [mm]", {}, "line 1: 'lateral' is no name with a unit"),
        ("distance [m], lateral [s], vertical [mm]", {}, "line 1: `lateral` must be in a unit like m, but is"),
        (HEADER, {(7, 1): "?"}, r"line 10: `lateral` must be a number, but is '\?'"),
        (HEADER, {(7, 2): ""}, r"no reading at 1\.75 m \(line 10\): choose joints = one of"),
        (HEADER, {(7, 1): "-9999"}, r"no reading at 1\.75 m \(line 10\): choose joints = one of"),
        (HEADER, {(7, 1): "1,5"}, "line 10: has 4 values for 3 names; decimal commas need semicolons"),
        (HEADER, {(7, 0): "1+75"}, r"line 10: `distance` must be a number, or as 129\+773 in m.* but is '1\+75'"),
        ("distance [m], lateral [mm], y [mm]", {}, "line 1: lateral and y are both lateral: leave one out"),
        (HEADER, {(7, 0): 1.5}, r"line 10: distance 1.5 m does not exceed 1.5 m"),
        (HEADER, {(240, 0): 90.0}, r"no reading at 59\.75 to 90 m \(line 243\): choose"),
    ],
)
def test_what_is_wrong_is_one_line_with_file_and_line(tmp_path, header, cells, words):
    path = tmp_path / "survey.csv"
    table = np.column_stack([DISTANCE, LATERAL * 1e3, VERTICAL * 1e3]).astype(object)
    for place, value in cells.items():
        table[place] = value
    path.write_text("\n".join([header, "# a remark", *(",".join(map(str, row)) for row in table.tolist())]))
    with pytest.raises(ValueError, match=rf"survey\.csv[,:] {words}"):
        sj.load_rail(path)


def test_coarse_samples_and_files_of_another_kind_are_named(tmp_path):
    coarse = np.column_stack([np.arange(40.0), np.random.default_rng(0).normal(0, 1, 40), np.zeros(40)])
    with pytest.warns(sj.ImplausibleWarning, match=r"is sampled every 1 m, too coarsely for waves of \S+ m"):
        sj.load_rail(written(tmp_path, HEADER, coarse, delimiter=","))
    for content in (b"\x89PNG\r\n\x1a\n", b"\xff\xfe\x00", b"\x00" * 8):
        (tmp_path / "picture.csv").write_bytes(content)
        with pytest.raises(
            ValueError, match="neither a text in UTF-8, UTF-16 or Windows-1252 nor a netCDF or MAT file"
        ):
            sj.load_rail(tmp_path / "picture.csv")
    with pytest.raises(OSError, match=r"nowhere\.csv"):
        sj.load_rail(tmp_path / "nowhere.csv")
    with pytest.raises(ValueError, match="must have distance, and lateral or vertical, but has lateral, vertical"):
        sj.load_rail(written(tmp_path, "lateral [mm], vertical [mm]", coarse[:, :2]))


TABLE = np.column_stack([DISTANCE, LATERAL * 1e3, VERTICAL * 1e3])


def text(header, delimiter=",", decimal=".", table=TABLE):
    rows = [delimiter.join(repr(value).replace(".", decimal) for value in row) for row in table.tolist()]
    return "\n".join([*header, *rows]) + "\n"


def test_names_that_the_trade_writes_and_names_that_are_unknown(tmp_path):
    with pytest.warns(sj.ImplausibleWarning, match="OFFSET counts as lateral, positive to the left"):
        found = sj.load_rail(written(tmp_path, "# STA [m], OFFSET [mm], ELEV [mm]", TABLE))
    np.testing.assert_allclose(found.lateral, LATERAL, rtol=0, atol=1e-15)
    words = r"other names are chainage, station, sta, .* It begins with 'mp \[m\]; dx \[mm\]; dz \[mm\]'"
    with pytest.raises(ValueError, match=words):
        sj.load_rail(written(tmp_path, "mp [m], dx [mm], dz [mm]", TABLE))


@pytest.mark.parametrize(
    ("content", "encoding"),
    [
        (text(["Survey – “north”", "STA [m], LAT [mm], VERT [mm]"]), "cp1252"),
        (text(["# left, right", "# sta, lat, vert", "# m, mm, mm"]), "utf-8"),
        (text(["sep=;", "chainage [m];lateral [mm];vertical [mm]"], ";", ","), "utf-8"),
        (text(["Track survey, north rail", "Date: 2026-05-01; operator: N. N.", "", HEADER]), "utf-8"),
        (text(["distance;lateral;vertical", "m;mm;mm"], ";", ","), "utf-8-sig"),
        (text(["distance\tlateral\tvertical", "[m]\t[mm]\t[mm]"], "\t"), "utf-16"),
        (text(["# Länge", "distance [m], lateral [µm], z [µm]"], table=TABLE * [1, 1e3, 1e3]), "latin-1"),
        (text([HEADER]).replace("\n", "\r\n"), "utf-8"),
        (text([HEADER.replace(",", ";"), "  # left, right"], ";") + "# by N. N., in spring\n", "utf-8"),
    ],
    ids=["windows-1252", "behind #", "semicolons", "preamble", "units below", "utf-16", "latin-1", "crlf", "remarks"],
)
def test_tables_of_other_programs_are_read(tmp_path, content, encoding):
    (tmp_path / "survey.csv").write_bytes(content.encode(encoding))
    assert same(sj.load_rail(tmp_path / "survey.csv"))


@pytest.mark.parametrize(("unit", "station"), [("m", "129+{:07.3f}"), ("m", "129+{:08.3f}"), ("ft", "1297+{:05.2f}")])
def test_stations_are_distances(tmp_path, unit, station):
    places = np.arange(73.0, 89.01, 0.25) if unit == "ft" else np.arange(773.0, 789.01, 0.25)
    rows = [f"{station.format(place)}, {math.sin(k / 8)!r}, 0.5" for k, place in enumerate(places)]
    (tmp_path / "survey.csv").write_text("\n".join([HEADER.replace("distance [m]", f"chainage [{unit}]"), *rows]))
    factor, before = (0.3048, 129_700.0) if unit == "ft" else (1.0, 129_000.0)
    np.testing.assert_allclose(
        sj.load_rail(tmp_path / "survey.csv").distance, factor * (before + places[[0, -1]]), rtol=1e-14
    )


def test_numbers_that_may_mean_two_things_are_one_line(tmp_path):
    for content, words in (
        (
            text([HEADER], table=TABLE[::-1]),
            "`distance` falls from row to row: reverse the rows, and change the signs of lateral and roll",
        ),
        (
            text([HEADER.replace(",", ";")], ";").replace("0.25;", "0,25;", 1),
            "line 3: `distance` must be a number, with decimal points, but is '0,25'",
        ),
        ("", "has no line of names with units"),
        (HEADER, "has no samples"),
    ):
        (tmp_path / "survey.csv").write_text(content)
        with pytest.raises(ValueError, match=rf"survey\.csv[:,]? {words}"):
            sj.load_rail(tmp_path / "survey.csv")


@pytest.mark.parametrize(
    ("header", "factors", "words"),
    [
        (HEADER, [1, 1, 1e6], "`vertical` is .* m; plausible are -1 to 1 m"),
        ("distance [m], roll [rad], z [mm]", [1, 1, 1], "`roll` is .* rad; plausible"),
    ],
)
def test_implausible_samples_are_told(tmp_path, header, factors, words):
    (tmp_path / "survey.csv").write_text(text([header], table=TABLE * factors))
    with pytest.warns(sj.ImplausibleWarning, match=words):
        sj.load_rail(tmp_path / "survey.csv")


def netcdf(folder, format="NETCDF4", change=lambda ds: ds, **encoding):
    """Writes a survey with packed variables."""
    of = lambda values, unit: ("row", values, {"units": unit})
    ds = xr.Dataset({"distance": of(DISTANCE, "m"), "y": of(LATERAL * 1e3, "mm"), "z": of(VERTICAL * 1e3, "mm")})
    engine = "h5netcdf" if format == "NETCDF4" else "scipy"
    change(ds).to_netcdf(folder / "survey.nc", engine=engine, format=format, encoding=encoding)
    return folder / "survey.nc"


@pytest.mark.parametrize("format", ["NETCDF4", "NETCDF3_64BIT"])
def test_packed_variables_are_unpacked(tmp_path, format):
    """Rounded to 1e-7 mm."""
    pack = dict(scale_factor=1e-7, add_offset=0.5, dtype="int32", _FillValue=-2147483648)
    track = sj.load_rail(netcdf(tmp_path, format, y=pack, z=pack))
    exact = sj.model.SampledTrack(DISTANCE, LATERAL, VERTICAL)
    np.testing.assert_allclose(track.lateral, exact.lateral, rtol=0, atol=1e-10)
    np.testing.assert_allclose(track.vertical, exact.vertical, rtol=0, atol=1e-10)


LEFT = np.where(DISTANCE < 30.0, 0.0, 2.0)
"""Readings [mm] with a step at 30 m, where four are missing: the middle between the others is at 29.875 m."""
MISSING = slice(118, 122)


def with_joints(folder, values, *, gap=(40, 40)):
    """Writes vertical readings [mm] without those of the joint, and without the rows of a gap."""
    rows = np.column_stack([DISTANCE, 0.0 * values, values]).astype(object)
    rows[MISSING, 2] = ""
    table = [",".join(map(str, row)) for k, row in enumerate(rows.tolist()) if not gap[0] <= k < gap[1]]
    (folder / "survey.csv").write_text("\n".join(["distance [m],lateral [mm],vertical [mm]", *table]))
    return folder / "survey.csv"


@pytest.mark.filterwarnings("ignore:Argument `file`.* too coarsely")
@pytest.mark.parametrize(("joints", "step"), [("step", 120), ("hold", 122)])
def test_a_joint_without_a_reading_is_a_step_or_keeps_the_last_reading(joints, step, tmp_path):
    for path in (with_joints(tmp_path, LEFT), with_joints(tmp_path, LEFT, gap=(118, 122))):
        rail = sj.load_rail(path, joints=joints)
        np.testing.assert_allclose(rail.vertical, np.where(np.arange(len(DISTANCE)) < step, 0.0, 2e-3), rtol=1e-15)
    # of a single missing reading, in the middle, a step leaves the rail before it
    np.testing.assert_array_equal(
        JOINTS[joints](np.array([0.0, 2.0]), np.array([5.0, 7.0]), np.arange(3.0)), [5, 5, 7]
    )


@pytest.mark.parametrize("gap", [(40, 40), (40, 60)])
def test_a_spline_across_a_joint_is_exact_for_a_cubic(gap, tmp_path):
    cubic = 1e-4 * (DISTANCE - 10.0) * (DISTANCE - 30.0) * (DISTANCE - 50.0)
    rail = sj.load_rail(with_joints(tmp_path, cubic, gap=gap), joints="spline")
    # rounding: measured 4e-18 m of 4e-4 m
    np.testing.assert_allclose(rail.vertical, 1e-3 * cubic, rtol=0, atol=1e-16)
    assert float(rail.spacing) == pytest.approx(0.25, rel=1e-14)


@pytest.mark.filterwarnings("ignore:Argument `file`.* too coarsely")
def test_the_choice_for_joints_is_in_the_file_of_a_scene_and_kept(tmp_path):
    with_joints(tmp_path, LEFT, gap=(40, 60))
    text = 'base = "paper"\n[track]\nfile = "survey.csv"\n'
    words = (
        r"survey\.csv: no reading at 9\.75 to 15 m \(line 42\), 29\.5 m \(line 100\), .* and 30\.25 m \(line 103\): "
    )
    with pytest.raises(ValueError, match=words + 'choose joints = one of "spline", "step", "hold"'):
        scene_from_toml(text, str(tmp_path / "sled.toml"))
    scene = scene_from_toml(text + 'joints = "hold"', str(tmp_path / "sled.toml")).scene
    assert float(scene.track.vertical[121]) == 0.0
    for again in (scene_from_toml(scene.to_toml()).scene, scene_from_json(scene_to_json(scene))):
        assert again.track.joints == "hold"
        np.testing.assert_array_equal(again.track.vertical, scene.track.vertical)


def test_wrong_choices_for_joints_are_one_line(tmp_path):
    path = with_joints(tmp_path, LEFT)
    with pytest.raises(ValueError, match="`joints` must be one of spline, step, hold, but is 'bridge'"):
        sj.load_rail(path, joints="bridge")
    with pytest.raises(ValueError, match="`joints` must be one of spline, but is 'step'"):
        sj.load_rail(path, joints="step", chord=10.0)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:-1], "60.0,0,"]))
    with pytest.raises(ValueError, match=r"survey\.csv: must begin and end with a reading"):
        sj.load_rail(path, joints="step")
    path.write_text("\n".join([*lines, "1e6,0,0"]))
    with pytest.raises(ValueError, match="`joints` must fill less rail than has readings, but is given for 242 of"):
        sj.load_rail(path, joints="step")


def test_gaps_in_netcdf_files_are_named(tmp_path):
    lost = lambda ds: ds.assign(y=ds["y"].where(ds["row"] != 7))
    for attribute in ("_FillValue", "missing_value"):
        with pytest.raises(ValueError, match=r"survey\.nc: no reading at 1\.75 m \(sample 7\): choose"):
            sj.load_rail(netcdf(tmp_path, change=lost, y={attribute: -9999.0, "dtype": "float64"}))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ds: ds.assign(z=ds["z"].assign_attrs(positive="down")), ": `z` must be positive upwards"),
        (lambda ds: ds.assign(lateral=ds["y"]), ": (y and lateral|lateral and y) are both lateral: leave one out"),
        (lambda ds: ds.assign(y=ds["y"].astype(str).assign_attrs(units="m")), ": `y` must be numbers along one dim"),
        (lambda ds: ds.assign(y=ds["y"].assign_attrs(units="s")), ": `y` must be in a unit like m"),
        (lambda ds: ds.assign(y=ds["y"][:9].rename(row="some")), ": .* must have one length"),
    ],
)
def test_wrong_netcdf_files_are_one_line(tmp_path, change, words):
    with pytest.raises(ValueError, match=rf"survey\.nc{words}"):
        sj.load_rail(netcdf(tmp_path, change=change))


@pytest.mark.parametrize(("format", "share"), [("NETCDF4", 0.1), ("NETCDF3_64BIT", 0.2), ("NETCDF3_64BIT", 0.9)])
def test_netcdf_files_that_were_cut_are_one_line(tmp_path, format, share):
    """scipy's reader raises errors of many classes."""
    content = netcdf(tmp_path, format).read_bytes()
    (tmp_path / "cut.nc").write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"cut\.nc is no netCDF file that can be read: \w+: [^\n]*$"):
        sj.load_rail(tmp_path / "cut.nc")


def test_huge_cells_are_one_line(tmp_path):
    file = tmp_path / "survey.csv"
    for cell in ("a" * 200_000, "9" * 200_000):
        for text in (f"{HEADER}\n0, {cell}, 0\n1, 0, 0\n", f"{HEADER}, {cell} [m]\n0, 0, 0, 0\n"):
            file.write_text(text)
            with pytest.raises(ValueError, match=r"survey\.csv") as told:
                sj.load_rail(file)
            assert len(str(told.value)) < 400


def test_a_survey_knows_the_unit_of_its_distances(survey, tmp_path):
    assert sj.load_rail(survey).distance_unit == "ft"
    assert sj.load_rail(netcdf(tmp_path)).distance_unit == "m"
    assert "distance_unit" not in scene_to_json(dataclasses.replace(sj.paper_scene(), track=sj.load_rail(survey)))


TIME = np.array([0.0, 0.5, 1.0, 2.0])
SPEED = np.array([20.0, 120.0, 200.0, 190.0])


def history(folder, *columns, head):
    lines = [head, *(",".join(map(repr, row)) for row in np.column_stack(columns).tolist())]
    (folder / "velocity.csv").write_text("\n".join(lines) + "\n")
    return folder / "velocity.csv"


def test_histories_of_speeds_are_read_by_time_and_by_distance(tmp_path):
    exact = sj.SpeedProgramme.over_time(TIME, SPEED, begin=300.0)
    file = history(tmp_path, 1e3 * TIME, SPEED / 0.3048, head="t [ms], Velocity [ft/s]")
    here = sj.model.load_speed(file, begin=300.0)
    np.testing.assert_allclose(here.distance, exact.distance, rtol=1e-14)
    np.testing.assert_allclose(here.speed, SPEED, rtol=1e-14)
    places = np.array([0.0, 10.0, 40.0]) / 0.3048
    file = history(tmp_path, places, [0.0, 1.0, 2.0], SPEED[:3], head="station [ft], time [s], speed [m/s]")
    by_distance = sj.model.load_speed(file, begin=100.0)
    np.testing.assert_allclose(by_distance.distance, [100.0, 110.0, 140.0], rtol=1e-14)
    np.testing.assert_array_equal(by_distance.speed, SPEED[:3])


def test_scene_files_name_a_history_beside_them(tmp_path):
    history(tmp_path, TIME, SPEED, head="time [s], speed [m/s]")
    scene = 'base = "paper"\n[speed]\nfile = "velocity.csv"\n'
    (tmp_path / "scene.toml").write_text(f'{scene}begin = "1000 ft"\n')
    here = sj.load(tmp_path / "scene.toml").scene.speed
    exact = sj.SpeedProgramme.over_time(TIME, SPEED, begin=304.8)
    np.testing.assert_allclose(here.distance, exact.distance, rtol=1e-14)
    (tmp_path / "scene.toml").write_text(f'{scene}scale = "2"\n')
    with pytest.raises(ValueError, match=r"scene\.toml, line 4: `scale` must not be given here"):
        _ = sj.load(tmp_path / "scene.toml").scene


def test_faults_of_a_history_are_told_at_once_also_from_a_scene_file(tmp_path):
    history(tmp_path, TIME[[0, 1, 1, 3]], [20.0, np.nan, 200.0, 190.0], head="time [s], speed [m/s]")
    (tmp_path / "scene.toml").write_text('base = "paper"\n[speed]\nfile = "velocity.csv"\n')
    with pytest.raises(ValueError, match=r"velocity\.csv has 2 faults") as told:
        _ = sj.load(tmp_path / "scene.toml").scene
    assert str(told.value).splitlines()[1:] == [
        "  velocity.csv, line 3: `speed` has no number.",
        "  velocity.csv, line 4: time 0.5 s does not exceed 0.5 s of line 3.",
    ]
    history(tmp_path, TIME, SPEED, head="time [s], distance [m]")
    with pytest.raises(ValueError, match=r"velocity\.csv: must have distance or time, and speed, but has time, dist"):
        sj.model.load_speed(tmp_path / "velocity.csv")


def test_a_survey_that_repeats_is_closed_from_a_scene_file_and_again(tmp_path):
    rows = np.column_stack([DISTANCE, LATERAL * 1e3, DISTANCE * 1e-3])
    written(tmp_path, "distance [m], lateral [mm], vertical [mm]", rows)
    (tmp_path / "scene.toml").write_text(
        'base = "paper"\n[track]\nfile = "survey.csv"\nends = "repeat"\nramp = "8 m"\n'
    )
    words = r"closing the last 8 m of the rail changes vertical by up to 0\.06 mm"
    with pytest.warns(sj.ImplausibleWarning, match=words):
        scene = sj.load(tmp_path / "scene.toml").scene
    with pytest.warns(sj.ImplausibleWarning, match=words):
        assert scene_from_json(scene_to_json(scene)).track == scene.track
    here = scene.track.irregularity(jnp.asarray([0.0, 60.0, 20.0, 80.0])).vertical
    np.testing.assert_allclose(here, [0.0, 0.0, 2e-5, 2e-5], rtol=0, atol=1e-18)


def test_mat_files_are_read_with_a_struct_of_units(tmp_path):
    columns = dict(distance=DISTANCE, Lateral=LATERAL * 1e3, vertical=VERTICAL * 1e3)
    units = dict(distance="m", Lateral="mm", vertical="mm")
    scipy.io.savemat(tmp_path / "survey.mat", {**columns, "units": units})
    found = sj.load_rail(tmp_path / "survey.mat")
    np.testing.assert_allclose(found.lateral, LATERAL, rtol=0, atol=1e-15)
    scipy.io.savemat(tmp_path / "survey.mat", columns)
    with pytest.raises(ValueError, match="`distance` must have an attribute `units`, but has none"):
        sj.load_rail(tmp_path / "survey.mat")
    (tmp_path / "survey.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(512))
    with pytest.raises(ValueError, match="is no MAT file of MATLAB 5 to 7, as save writes it with -v7, that can"):
        sj.load_rail(tmp_path / "survey.mat")


@pytest.mark.parametrize(
    ("name", "content", "way"),
    [
        ("survey.xlsx", b"PK\x03\x04\x00", "save its sheet as CSV"),
        ("survey.csv.gz", b"\x1f\x8b\x08\x00", "unpack it first"),
        ("run.tdms", b"TDSm\x00\x00", "export its channels as CSV"),
        ("modes.unv", b"    -1\n    55\n", "load_modes reads its modes"),
    ],
)
def test_the_way_of_files_of_another_kind_is_told(tmp_path, name, content, way):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"{name} .*: {way}"):
        sj.load_rail(tmp_path / name)
