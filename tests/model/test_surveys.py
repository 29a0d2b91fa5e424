"""Surveys in files: columns, units, chords, scenes that name them, and what is wrong by file and line."""

import dataclasses

import h5py
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.scene_files import scene_from_json, scene_from_toml, scene_to_json

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
    here, exact = track.irregularity(PLACES), sj.SampledTrack(DISTANCE, LATERAL, VERTICAL).irregularity(PLACES)
    np.testing.assert_allclose(here.lateral, exact.lateral, atol=1e-15)
    np.testing.assert_allclose(here.vertical, exact.vertical, atol=1e-15)
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
    np.testing.assert_allclose(here.roll, 1e-6 * np.sin(2 * np.pi * PLACES / 8), atol=1e-11)


def test_scenes_name_the_file_and_find_its_content_again(tmp_path, survey):
    scene = dataclasses.replace(sj.paper_scene(), track=sj.load_rail(survey, ends="error"))
    text = scene_to_json(scene)
    assert len(text) < 1500
    assert "survey.csv" in text
    assert scene_from_json(text).track == scene.track
    assert same(scene_from_toml(scene.to_toml()).scene.track)
    (tmp_path / "scene.toml").write_text('base = "paper"\n[track]\nfile = "survey.csv"\nends = "error"\n')
    assert same(sj.load_scene(tmp_path / "scene.toml").track)
    survey.write_text(survey.read_text().replace("# measured in spring", "# changed"))
    with pytest.raises(ValueError, match="`sha256` must be the content with which the scene was made"):
        scene_from_json(text)


def test_chords_are_turned_into_displacements(tmp_path):
    """Of a sine, the middle of a chord shows the share 1 - cos(pi chord / wavelength)."""
    distance = np.arange(0.0, 400.01, 0.25)
    wave, chord = np.sin(2 * np.pi * distance / 8), 5.0
    rows = np.column_stack([distance, (1 - np.cos(np.pi * chord / 8)) * wave, 0 * wave])
    track = sj.load_rail(written(tmp_path, "distance [m], lateral [mm], vertical [mm]", rows), chord=chord)
    middle = jnp.linspace(150.0, 250.0, 300)
    here = np.asarray(track.irregularity(middle).lateral)
    # measured 4e-9, that of the spline; rails that do not end on their line have errors near the ends
    np.testing.assert_allclose(here, 1e-3 * np.sin(2 * np.pi * np.asarray(middle) / 8), atol=1e-8)


def rows(**cells):
    table = np.column_stack([DISTANCE, LATERAL * 1e3, VERTICAL * 1e3]).astype(object)
    for (k, j), value in cells.pop("at", {}).items():
        table[k, j] = value
    return table


HEADER = "distance [m], lateral [mm], vertical [mm]"


@pytest.mark.parametrize(
    ("header", "cells", "words"),
    [
        (
            "distance [m], lateral, vertical [mm]",
            {},
            "line 1: 'lateral' is no name with a unit",
        ),
        (
            "distance [m], lateral [s], vertical [mm]",
            {},
            "line 1: `lateral` must be in a unit like m, but is",
        ),
        ("distance [m], height [m], vertical [mm]", {}, r"line 1: 'height \[m\]' is no name with a unit"),
        (HEADER, {(7, 1): "?"}, r"line 10: `lateral` must be a number, but is '\?'"),
        (HEADER, {(7, 2): ""}, "line 10: `vertical` must be a number, but is missing"),
        (HEADER, {(7, 1): "nan"}, "line 10: has a number that is not finite"),
        (HEADER, {(7, 0): 1.5}, r"line 10: distance 1.5 m does not exceed 1.5 m"),
        (HEADER, {(240, 0): 90.0}, r"line 243: a gap of 30.25 m after 59.75 m, in samples every 0.25 m"),
    ],
)
def test_what_is_wrong_is_one_line_with_file_and_line(tmp_path, header, cells, words):
    path = tmp_path / "survey.csv"
    lines = [header, "# a remark", *(",".join(map(str, row)) for row in rows(at=cells).tolist())]
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=rf"survey\.csv, {words}"):
        sj.load_rail(path)


def test_coarse_samples_and_files_of_another_kind_are_named(tmp_path):
    coarse = np.column_stack([np.arange(40.0), np.random.default_rng(0).normal(0, 1, 40), np.zeros(40)])
    with pytest.warns(sj.ImplausibleWarning, match=r"is sampled every 1 m, too coarsely for waves of \S+ m"):
        sj.load_rail(written(tmp_path, HEADER, coarse, delimiter=","))
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(ValueError, match="neither a text in UTF-8 nor a netCDF-4 file"):
        sj.load_rail(tmp_path / "picture.csv")
    with pytest.raises(OSError, match=r"nowhere\.csv"):
        sj.load_rail(tmp_path / "nowhere.csv")
    with pytest.raises(ValueError, match="must have distance, and lateral or vertical, but has lateral, vertical"):
        sj.load_rail(written(tmp_path, "lateral [mm], vertical [mm]", coarse[:, :2]))
