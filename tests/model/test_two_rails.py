"""Pairs of rails: any two, random ones with a coherence, surveys of both in one file, and sets of pairs."""

import dataclasses
import functools
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.model import SurveyedRails, SurveyedTrack
from slipperjax.model.scene_files import scene_from_json, scene_from_toml, scene_to_json
from slipperjax.orbits.simulate import check_rail

from ..common import among
from ..families import facts_of, irregularity_of, largest, motion_of

LEFT = sj.HarmonicTrack((8.0,), 1e-3)
RIGHT = sj.HarmonicTrack((12.0, 6.0), 2e-4, 1e-3)
PLACES = np.linspace(10.0, 50.0, 401)
SLED = sj.RandomTrack.sled(length=300.0)
PAIR = sj.model.RandomRails(SLED, coherence=0.5, gauge=1.2, seed=3)


def on(track):
    """A scene of a sled with two slippers on each rail."""
    half = 0.6 if track.gauge is None else float(track.gauge) / 2
    mounts = [sj.Mount(x, side * half, rail=rail) for side, rail in ((1, "left"), (-1, "right")) for x in (0.5, -0.5)]
    sled = sj.Sled(mass=56.0, inertia=(20.0, 20.0, 30.0), mounts=mounts)
    return dataclasses.replace(sj.paper_scene(900.0), slipper=sled, track=track)


def at(track, places=PLACES):
    return irregularity_of(track, places)


def test_taken_as_one_two_rails_are_the_line_in_their_middle():
    track = sj.model.TwoRails(LEFT, RIGHT, gauge=1.4)
    one, other = (motion_of(rail, PLACES) for rail in (LEFT, RIGHT))
    for here, left, right in zip(motion_of(track, PLACES), one, other, strict=True):
        np.testing.assert_allclose(here.lateral, (left.lateral + right.lateral) / 2, rtol=0, atol=1e-18)
        np.testing.assert_allclose(here.roll, right.roll / 2, rtol=0, atol=1e-18)
    assert largest(at(track), motion_of(track, PLACES)[0]) < 1e-16  # measured: 0 and 8e-18 m
    assert float(track.wavelength) == 8.0
    # a sine of 1 mm and 8 m is steeper than those of 0.2 mm
    np.testing.assert_allclose(facts_of(track), [24.0, 2 * np.pi * 1e-3 / 8, 6.0], rtol=1e-12)
    assert repr(track).endswith(", gauge=1.4 m)")
    for wrong in (1e-3, track):
        with pytest.raises(ValueError, match=r"`right` must be (a track such as|one rail, but is TwoRails)"):
            sj.model.TwoRails(LEFT, wrong)


def sampled(begin, end, ends="straight"):
    distance = np.linspace(begin, end, 101)
    return sj.model.SampledTrack(distance, 1e-3 * np.sin(distance), 1e-3 * np.cos(distance), ends=ends)


def test_two_rails_are_known_where_both_are():
    track = sj.model.TwoRails(sampled(10.0, 90.0, "error"), sampled(0.0, 70.0))
    assert (track.begin, track.origin, track.extent, track.end) == (10.0, 10.0, 70.0, 90.0)
    assert sj.model.TwoRails(LEFT, sampled(0.0, 70.0)).extent == 70.0
    assert sj.model.TwoRails(LEFT, RIGHT).end == np.inf
    for ends, words in (
        ("straight", r"leads to 74\.5 m, but the rail is known up to 70 m only"),
        ("error", r"`periods` must be at most 7 here.* because the rail ends at 70 m"),
    ):
        with pytest.raises((ValueError, sj.ImplausibleWarning), match=words):
            check_rail(on(sj.model.TwoRails(sampled(10.0, 90.0, ends), sampled(0.0, 70.0, ends))), 8, 10.0)


def test_a_sum_adds_to_each_rail():
    joints = sj.model.LocalTrack(place=[1.0], height=[-3e-4], length=0.3, shape="joint", every=4.0)
    pair = sj.model.TwoRails(LEFT, RIGHT, gauge=1.4)
    for track in (
        sj.model.SumTrack(pair, joints),
        sj.model.SumTrack(joints, pair),
        sj.model.SumTrack(pair, joints).prepared(),
    ):
        assert float(track.gauge) == 1.4
        for name, rail in pair.rails.items():
            apart = [at(part).vertical for part in (rail, joints)]
            # of one addition in two orders
            np.testing.assert_allclose(at(track.rails[name]).vertical, sum(apart), rtol=0, atol=1e-18)
    twice = sj.model.SumTrack(pair, pair)
    assert largest(at(twice.rails["right"]), at(sj.model.SumTrack(RIGHT, RIGHT))) == 0.0
    assert sj.model.SumTrack(LEFT, joints).rails == {}


PAIRS = {
    "harmonic": sj.model.TwoRails(LEFT, RIGHT, gauge=1.4),
    "of kinds": sj.model.TwoRails(sampled(0.0, 70.0), SLED),
    "random": PAIR,
    "of two spectra": sj.model.RandomRails(SLED, 0.0, right_rail=dataclasses.replace(SLED, roughness=2.0)),
    "set": sj.model.TrackSet([PAIR, sj.model.TwoRails(sampled(0.0, 70.0), sampled(0.0, 60.0), gauge=1.2)], 1),
    "sum": sj.model.SumTrack(sj.model.TwoRails(LEFT, RIGHT), RIGHT),
}


@pytest.mark.parametrize("name", PAIRS)
def test_pairs_survive_files(name):
    scene = on(PAIRS[name])
    assert eqx.tree_equal(scene_from_json(scene_to_json(scene)), scene)
    assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)
    assert type(PAIRS[name]).__name__ in repr(scene)


@pytest.mark.full
def test_the_left_rail_of_a_seed_is_that_of_a_random_track():
    one = dataclasses.replace(SLED, seed=3.0)
    for ours, theirs in zip(motion_of(PAIR.prepared().left, PLACES), motion_of(one, PLACES), strict=True):
        assert largest(ours, theirs) < 1e-15  # measured 0, of two programs
    # stored samples of the right rail [m], which hold for every later version
    right = at(PAIR.right, np.array([30.0, 40.5]))
    stored = [-0.00015239054112009857, -6.766973752468459e-05, 0.00031058670931971875, 0.00028209276163798386]
    # other orders of summing change the last digits
    np.testing.assert_allclose([*right.lateral, *right.vertical], stored, rtol=0, atol=1e-15)
    equal = dataclasses.replace(PAIR, coherence=1.0)
    assert largest(at(equal.right), at(one)) < 1e-15  # measured 0, of two programs
    assert PAIR.extent == SLED.extent
    np.testing.assert_allclose(facts_of(PAIR), facts_of(SLED), rtol=1e-12)


COUNT = 400
"""Pairs of an ensemble."""


def waves_of(coherence, correlation, roughness=1.0):
    """Complex waves of pairs that repeat, (direction, rail, pair, wavenumber), and their wavenumbers."""
    rail = sj.RandomTrack.power_law(6e-10, 2.0, band=(1.0, 50.0), length=200.0, ends="repeat", coherence=correlation)
    right = dataclasses.replace(rail, roughness=roughness)
    pair = sj.model.RandomRails(rail, coherence, right_rail=right)
    x = jnp.arange(1600) / 8.0

    @jax.jit
    @jax.vmap
    def heights(seed):
        rails = eqx.tree_at(lambda track: track.seed, pair, seed).prepared().rails.values()
        return jnp.stack([jnp.stack(rail.irregularity(x)[:2]) for rail in rails], axis=1)

    waves = np.moveaxis(np.fft.rfft(np.asarray(heights(jnp.arange(float(COUNT))))), 0, 2) / 1600
    # wavenumbers of the band
    return waves[..., 4:201], np.arange(4, 201) / 200.0


def coherence_of(one, other):
    """The complex coherence of an ensemble in all wavenumbers together."""
    power = lambda waves: np.sum(np.abs(waves) ** 2, axis=0)
    # each wavenumber counts as much
    cross = np.sum(np.conj(one) * other, axis=0) / np.sqrt(power(one) * power(other))
    return np.mean(cross)


ENSEMBLES = {"independent": (0.0, None), "alike": (0.5, 0.6), "opposed": (0.8, -0.3)}
"""Coherence of both rails, and correlation of their directions."""


@pytest.mark.parametrize("case", among(ENSEMBLES, "alike"))
def test_pairs_have_their_coherence_and_their_spectra(case):
    coherence, correlation = case
    (lateral, vertical), k = waves_of(coherence, correlation, roughness=1.5)
    share = 0.0 if correlation is None else correlation
    # the standard error of a mean of 400 pairs and 197 wavenumbers is 1 / sqrt(78800) = 0.0036, real and imaginary
    within = dict(abs=0.0125)
    root = np.sqrt(coherence)
    for one, other, exact in (
        (lateral[0], lateral[1], root),
        (vertical[0], vertical[1], root),
        # within both rails, and across both
        (lateral[0], vertical[0], share),
        (lateral[1], vertical[1], share),
        (lateral[0], vertical[1], share * root),
    ):
        found = coherence_of(one, other)
        assert found.real == pytest.approx(exact, **within)  # measured 2.8e-3 and less
        assert found.imag == pytest.approx(0.0, **within)  # measured 6.7e-3 and less
    # magnitude squared at each wavenumber, less its bias for independent waves, of 400 pairs
    cross = np.mean(np.conj(vertical[0]) * vertical[1], axis=0)
    powers = [np.mean(np.abs(waves) ** 2, axis=0) for waves in vertical]
    squared = np.mean(np.abs(cross) ** 2 / (powers[0] * powers[1]))
    assert squared - (1 - coherence) ** 2 / COUNT == pytest.approx(coherence, abs=0.006)  # measured 3e-4
    # each rail alone has its spectrum: 2 * 400 degrees of freedom, standard deviation 0.05 at each wavenumber
    for direction in (lateral, vertical):
        for waves, roughness in zip(direction, (1.0, 1.5), strict=True):
            ratio = 2 * 200.0 * np.mean(np.abs(waves) ** 2, axis=0) / (6e-10 * roughness**2 * k**-2.0)
            # the spline changes waves of 1 m by a thousandth; ends of the band have half their share
            inside = ratio[1:-1]
            assert np.mean(inside) == pytest.approx(1.0, abs=0.013)  # measured 4.7e-3 and less
            assert np.mean(np.abs(inside - 1) < 1.96 * 0.05) > 0.9  # measured 0.933 and more


@pytest.mark.full
def test_a_number_chooses_one_of_several_pairs():
    pairs = (PAIR, dataclasses.replace(PAIR, seed=8.0))
    for number, pair in enumerate(pairs):
        chosen = sj.model.TrackSet(pairs, number)
        assert (float(chosen.gauge), chosen.begin, chosen.extent) == (1.2, 0.0, 300.0)
        for name, rail in pair.rails.items():
            assert largest(at(chosen.prepared().rails[name]), at(rail)) < 1e-15
        assert largest(at(chosen), at(pair)) < 1e-15
    again = sj.model.TrackSet(
        [sj.model.TwoRails(sampled(0.0, 70.0), sampled(0.0, 60.0)), sj.model.TwoRails(sampled(5.0, 70.0), SLED)]
    )
    assert (again.begin, again.extent) == (5.0, 60.0)


WRONG_SETS = {
    "be single rails or pairs of rails": SLED,
    "have one gauge": dataclasses.replace(PAIR, gauge=None),
    "be rails such as": sj.model.TwoRails(LEFT, RIGHT, gauge=1.2),
    "have the same ends": sj.model.TwoRails(sampled(0.0, 70.0, "error"), SLED, gauge=1.2),
}


def test_sets_of_rails_that_differ_too_much_are_refused():
    for words, other in WRONG_SETS.items():
        with pytest.raises(ValueError, match=f"`tracks` must {words}"):
            sj.model.TrackSet((PAIR, other))


WRONG_PAIRS = {
    "`coherence` must be from 0 to 1, but is 1.1": dict(coherence=1.1),
    "`rail` must have the seed 0, because that of the pair counts": dict(rail=dataclasses.replace(SLED, seed=4)),
    "`right_rail` must have the band, length, beginning": dict(right_rail=sj.RandomTrack.sled(length=400.0)),
    "`seed` must be a whole number": dict(seed=0.5),
}


@pytest.mark.parametrize("words", WRONG_PAIRS)
def test_wrong_pairs_are_named(words):
    with pytest.raises(ValueError, match=words):
        sj.model.RandomRails(**(dict(rail=SLED, coherence=0.5) | WRONG_PAIRS[words]))


SPACING = 0.1
SAMPLES = np.arange(0.0, 400.0 + SPACING / 2, SPACING)


@functools.cache
def surveyed(seed, coherence=0.64):
    """A survey of a pair of rails, which begins within much longer ones; the right one has joints."""
    rail = sj.RandomTrack.power_law(6e-10, 2.0, band=(0.2, 400.0), length=1600.0, coherence=-0.6)
    joints = sj.model.FourierTrack((1.32,), (0.0,), (8e-5,))

    @jax.jit
    def displacements(seed):
        pair = sj.model.RandomRails(rail, coherence, seed=seed)
        return [
            track.irregularity(400.0 + SAMPLES)[:2] for track in (pair.left, sj.model.SumTrack(pair.right, joints))
        ]

    rails = [sj.model.SampledTrack(SAMPLES, *each, ends="error") for each in displacements(float(seed))]
    return sj.model.TwoRails(*rails, gauge=1.4)


@pytest.mark.full
def test_rails_like_a_survey_have_the_coherence_of_its_rails():
    found = [float(sj.model.RandomRails.like(surveyed(seed)).coherence) for seed in range(6)]
    # a correlation of r over n numbers scatters by (1 - r^2) / sqrt(n): 0.36 / sqrt(2667) in a survey
    assert np.mean(found) == pytest.approx(0.64, abs=0.01)  # measured 0.639
    opposite = surveyed(0)
    opposite = sj.model.TwoRails(
        opposite.left, sj.model.SampledTrack(SAMPLES, -opposite.left.lateral, 0.0, ends="error")
    )
    assert float(sj.model.RandomRails.like(opposite).coherence) == 0.0


def test_rails_like_a_survey_are_each_like_its_own():
    survey = surveyed(0)
    like = sj.model.RandomRails.like(survey, length=500.0, seed=7)
    for rail, own in ((like.rail, survey.left), (like.right_rail, survey.right)):
        assert eqx.tree_equal(rail, sj.RandomTrack.like(own, length=500.0))
    assert like.rail.lines is None
    np.testing.assert_allclose(like.right_rail.lines.wavelengths, [1.32], rtol=1e-3)  # measured 9e-5
    assert (float(like.gauge), float(like.seed), like.extent, like.end) == (1.4, 7.0, 500.0, 500.0)
    for wrong, words in (
        (survey.left, "be two rails such as"),
        (sj.model.TwoRails(LEFT, RIGHT), "be a rail of samples"),
    ):
        with pytest.raises(ValueError, match=f"`survey` must {words}"):
            sj.model.RandomRails.like(wrong)
    shifted = sj.model.SampledTrack(SAMPLES + 1.0, survey.right.lateral, 0.0, ends="error")
    with pytest.raises(ValueError, match="`survey` must have samples at the same distances on both rails"):
        sj.model.RandomRails.like(sj.model.TwoRails(survey.left, shifted))


DISTANCE = np.arange(0.0, 60.01, 0.25)
WAVES = {
    "left lateral": 1e-3 * np.sin(2 * np.pi * DISTANCE / 8),
    "left vertical": 5e-4 * np.cos(2 * np.pi * DISTANCE / 12),
    "right lateral": 8e-4 * np.sin(2 * np.pi * DISTANCE / 10),
    "right vertical": 4e-4 * np.cos(2 * np.pi * DISTANCE / 6),
}
GAUGE = 1.2 + WAVES["left lateral"] - WAVES["right lateral"]
"""The left rail is at + gauge / 2 and the displacements are positive to the left."""
HEADER = "distance [m], left lateral [mm], left vertical [mm], right lateral [mm], right vertical [mm]"


def written(folder, header=HEADER, columns=None, name="both.csv", change=None):
    """A file with distances [m] and, in millimetres, the columns that its header names."""
    named = WAVES | {"gauge": GAUGE}
    names = [cell.partition(" [")[0].strip() for cell in header.split(",")]
    table = [1e3 * named[cell] if cell in named else DISTANCE for cell in names] if columns is None else columns
    rows = np.column_stack(table).astype(object)
    for place, value in (change or {}).items():
        rows[place] = value
    path = folder / name
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows.tolist())]))
    return path


def same(track, within=1e-15):
    assert isinstance(track, SurveyedRails)
    for side, rail in track.rails.items():
        exact = sj.model.SampledTrack(DISTANCE, WAVES[f"{side} lateral"], WAVES[f"{side} vertical"])
        assert largest(at(rail)[:2], at(exact)[:2]) < within
    return True


def test_both_rails_are_read_from_one_file(tmp_path):
    track = sj.load_rail(written(tmp_path), gauge=1.2)
    assert same(track)
    assert (track.gauge, track.distance_unit, track.ramp, track.extent) == (1.2, "m", 8.0, 60.0)
    assert repr(track).endswith(", gauge=1.2 m)")
    # other names, other orders, and units in a line of their own
    names = "distance, left lateral, left vertical, right lateral, right vertical"
    for header in (
        "Chainage [m], LEFT_LATERAL [mm], left z [mm], Right y [mm], right_vertical [mm]",
        f"{names}\nm, mm, mm, mm, mm",
    ):
        path = written(tmp_path)
        path.write_text(path.read_text().replace(HEADER, header))
        assert same(sj.load_rail(path))
    turned = "distance [m], right vertical [mm], right lateral [mm], left vertical [mm], left lateral [mm]"
    assert same(sj.load_rail(written(tmp_path, turned)))
    # a rail without roll beside one that rolls does not roll, and what is not given is zero
    roll = "distance [m], left vertical [mm], right lateral [mm], right roll [mrad]"
    columns = [DISTANCE, *(1e3 * WAVES[n] for n in ("left vertical", "right lateral")), DISTANCE]
    track = sj.load_rail(written(tmp_path, roll, columns))
    for zeros in (track.left.lateral, track.right.vertical, track.left.roll):
        assert not np.any(zeros)
    np.testing.assert_allclose(track.right.roll, 1e-3 * DISTANCE, rtol=1e-12)


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_both_rails_are_read_from_netcdf_files(tmp_path, engine):
    variables = {name.replace(" ", "_"): ("sample", values, {"units": "m"}) for name, values in WAVES.items()}
    ds = xr.Dataset({"distance": ("sample", DISTANCE / 0.3048, {"units": "ft"}), **variables})
    ds.to_netcdf(tmp_path / "both.nc", engine=engine)
    track = sj.load_rail(tmp_path / "both.nc")
    assert same(track)
    assert track.distance_unit == "ft"


@pytest.mark.parametrize(("known", "other", "sign"), [("left", "right", -1), ("right", "left", 1)])
def test_a_gauge_stands_in_place_of_one_lateral(tmp_path, known, other, sign):
    path = written(tmp_path, HEADER.replace(f"{other} lateral", "gauge"))
    assert same(sj.load_rail(path, gauge=1.2))  # measured 3e-16 m, of the digits of 1.2 m
    # the deviation counts from the nominal gauge
    wider = sj.load_rail(path, gauge=1.199).rails[other].lateral - WAVES[f"{other} lateral"]
    np.testing.assert_allclose(wider, sign * 1e-3, rtol=0, atol=1e-15)
    needed = r"both\.csv: `gauge` needs the nominal gauge, such as gauge=1\.435"
    far = r"`gauge` must be the distance .* 1.2\S* m on average, far from the nominal"
    for words, gauge in ((needed, None), (far, 1.435)):
        with pytest.raises(ValueError, match=words):
            sj.load_rail(path, gauge=gauge)


@pytest.mark.full
def test_chords_are_of_both_rails_and_not_of_the_gauge(tmp_path):
    """Of a sine, the middle of a chord shows the share 1 - cos(pi chord / wavelength)."""
    distance = np.arange(0.0, 400.01, 0.25)
    wave, chord = np.sin(2 * np.pi * distance / 8), 5.0
    seen = (1 - np.cos(np.pi * chord / 8)) * wave
    header = "distance [m], left lateral [mm], left vertical [mm], gauge [mm], right vertical [mm]"
    path = written(tmp_path, header, [distance, seen, 2 * seen, 1200 + 3 * wave, 0 * wave])
    track = sj.load_rail(path, chord=chord, gauge=1.2)
    middle = np.linspace(150.0, 250.0, PLACES.size)
    exact = 1e-3 * np.sin(2 * np.pi * middle / 8)
    left, right = (at(rail, middle) for rail in track.rails.values())
    for found, share in ((left.lateral, 1), (left.vertical, 2), (right.lateral, -2), (right.vertical, 0)):
        # measured 4e-6, of the damping that keeps phantom waves and noise small
        np.testing.assert_allclose(found, share * exact, atol=1.2e-5)
    assert eqx.tree_equal(scene_from_toml(on(track).to_toml()).scene, on(track))


def test_scenes_name_the_file_of_both_rails_and_find_its_content_again(tmp_path):
    path = written(tmp_path, HEADER.replace("right lateral", "gauge"))
    scene = on(sj.load_rail(path, gauge=1.2, ends="error", ramp=0.0))
    text = scene_to_json(scene)
    assert len(text) < 2000
    assert eqx.tree_equal(scene_from_json(text), scene)
    assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)
    table = '[track]\nfile = "both.csv"\nends = "error"\ngauge = "1200 mm"\n'
    lines = re.sub(r"\[track\]\n.*?\n(?=\n)", table, scene.to_toml(), flags=re.DOTALL)
    (tmp_path / "scene.toml").write_text(lines)
    again = sj.load(tmp_path / "scene.toml").scene.track
    # that of the test has ramps, of which a spline knows little 2 m from them
    assert same(again, within=1e-12)  # measured 7e-14 m
    assert (again.gauge, again.ends) == (1.2, "error")
    (tmp_path / "scene.toml").write_text(lines.replace(table, table + "speed = 3\n"))
    with pytest.raises(ValueError, match=r"scene\.toml, line \d+: `speed` is none of file, sha256, chord, gauge"):
        _ = sj.load(tmp_path / "scene.toml").scene
    path.write_text(path.read_text().replace("gauge [mm]", "gauge  [mm]"))
    with pytest.raises(ValueError, match="`sha256` must be the content with which the scene was made"):
        scene_from_json(text)


def test_all_faults_of_both_rails_are_told_at_once(tmp_path):
    bad = {(5, 3): "", (9, 4): "loose", (20, 0): 1.0}
    path = written(tmp_path, HEADER.replace("left vertical [mm]", "left vertical"), change=bad)
    with pytest.raises(ValueError, match=r"both\.csv has 4 faults:") as told:
        sj.load_rail(path)
    for words in (
        "line 1: 'left vertical' is no name with a unit, such as distance [m], left_lateral [m]",
        "no reading at 1.25 m (line 7): choose joints",
        "line 11: `right vertical` must be a number, but is 'loose'",
        "line 22: distance 1 m does not exceed 4.75 m of line 21",
    ):
        assert words in str(told.value)


IN_PLACE = "`gauge` stands in place of one rail's lateral, but the file has"
LACKS = "must have distance, and lateral or vertical of the left and of the right rail, but has left_lateral, "
WRONG_FILES = {
    f"{IN_PLACE} left lateral and": f"{HEADER}, gauge [mm]",
    f"{IN_PLACE} neither of them": "distance [m], left vertical [mm], gauge [mm], right vertical [mm]",
    "left lateral and left lateral are both left_lateral: leave one out": f"{HEADER}, left lateral [mm]",
    LACKS: HEADER.replace("distance [m], ", ""),
}


@pytest.mark.parametrize("words", WRONG_FILES)
def test_wrong_files_of_both_rails_are_named(tmp_path, words):
    with pytest.raises(ValueError, match=words):
        sj.load_rail(written(tmp_path, WRONG_FILES[words]), gauge=1.2)


def test_files_of_one_rail_stay_what_they_are(tmp_path):
    """Also those with columns that pairs would have."""
    header = "distance [m], lateral [mm], vertical [mm], gauge [mm], left vertical [mm]"
    values = [1e3 * values for values in (WAVES["left lateral"], WAVES["left vertical"], GAUGE, GAUGE)]
    path = written(tmp_path, header, [DISTANCE, *values], change={(5, 3): "", (6, 4): "loose"})
    with pytest.warns(sj.ImplausibleWarning, match=r"columns that are not read: gauge and left vertical\."):
        track = sj.load_rail(path)
    assert isinstance(track, SurveyedTrack)
    np.testing.assert_allclose(track.lateral, WAVES["left lateral"], rtol=1e-12)
    with pytest.raises(ValueError, match=r"`gauge` must be None for a file of one rail, but is 1\.2"), pytest.warns():
        sj.load_rail(path, gauge=1.2)
    with pytest.raises(ValueError, match=r"`file` must be a survey of one rail, .*: slipperjax\.load_rail reads"):
        SurveyedTrack(written(tmp_path, name="two.csv"))
    with pytest.raises(ValueError, match="must have distance, and lateral or vertical of the left"), pytest.warns():
        SurveyedRails(path)
