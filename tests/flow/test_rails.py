"""Runs on rails of samples and on random ones: beside harmonic ones, over seeds, with derivatives, to their ends."""

import dataclasses
import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import slipperjax as sj
from slipperjax.design import sensitivities
from slipperjax.model.layout import coordinates
from slipperjax.model.parameters import parameter
from slipperjax.orbits.simulate import beginning_of
from slipperjax.sweeps.exponents import LyapunovExponents

from ..common import sled_on

SCENE, STEPS = sj.paper_scene(1000.0), 50
RAIL = sj.RandomTrack.sled(length=400.0)
ON_RAIL = dataclasses.replace(SCENE, track=RAIL)
COUNT = 65
PLACES = np.linspace(0.0, 8.0, COUNT)
WAVE = np.sin(2 * np.pi * PLACES / 8)


def sampled(lateral, vertical):
    return sj.model.SampledTrack(PLACES, lateral, vertical, np.radians(0.2) * WAVE, ends="repeat")


@pytest.mark.full
def test_a_sampled_sine_moves_slippers_as_the_harmonic_rail_does():
    latch = dataclasses.replace(SCENE, memory=sj.model.EventLatch())
    ends = [
        coordinates(sj.simulate(dataclasses.replace(latch, track=track), 6, steps_per_period=STEPS).end)
        for track in (SCENE.track, sampled(1e-3 * WAVE, 1e-3 * WAVE))
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6, rtol=2e-5)  # measured 4e-6


@pytest.mark.full
def test_sweeps_over_seeds_are_runs_on_each_rail():
    options = dict(transient=0, periods=3, steps_per_period=STEPS, record=["peak_force", "strobe"])
    ds = sj.sweep(ON_RAIL, {"track.seed": [3.0, 4.0], "track.roughness": [1.0, 2.0]}, **options)
    assert np.all(ds["status"] == 0)
    one = sj.sweep(ON_RAIL.replace(**{"track.seed": 4.0}), {"track.roughness": [2.0]}, **options)
    np.testing.assert_allclose(one["strobe"][0], ds["strobe"][1, 1], rtol=1e-9, atol=1e-12)
    run = sj.simulate(ON_RAIL.replace(**{"track.seed": 4.0, "track.roughness": 2.0}), 3, steps_per_period=STEPS)
    np.testing.assert_allclose(coordinates(run.end), ds["strobe"][1, 1, -1], rtol=1e-9, atol=1e-12)
    assert len(np.unique(ds["peak_force"].max(("end", "point")))) == 4
    assert len(ds.attrs["scene"]) < 3000  # the spectrum and the seed, no samples


@pytest.mark.full
def test_a_survey_and_random_rails_like_it_are_an_axis(tmp_path):
    """Of which a result keeps the file's name, tables of the spectra and the seeds."""
    places = np.arange(0.0, 64.0, 0.2)
    shape = 1e-3 * np.sin(places) + 2e-5 * np.random.default_rng(0).normal(size=(2, len(places)))
    rows = [f"{1000 + x:.1f}, {y:.9f}, {z:.9f}" for x, y, z in zip(places, *1e3 * shape, strict=True)]
    (tmp_path / "survey.csv").write_text("\n".join(["distance [m], lateral [mm], vertical [mm]", *rows]))
    survey = sj.load_rail(tmp_path / "survey.csv")
    like = sj.RandomTrack.like(survey)
    rails = [survey, *(dataclasses.replace(like, seed=seed) for seed in (1, 2))]
    scene = dataclasses.replace(SCENE, track=sj.model.TrackSet(rails))
    options = dict(transient=0, periods=3, steps_per_period=STEPS, record="strobe")
    ds = sj.sweep(scene, {"track.number": range(3)}, **options)
    np.testing.assert_array_equal(ds["status"], 0)
    assert len(np.unique(ds["strobe"][:, -1], axis=0)) == 3
    assert len(ds.attrs["scene"]) < 5000  # no samples: measured 3844
    ds.to_netcdf(tmp_path / "rails.nc", engine="h5netcdf")
    for number, rail in enumerate(rails):
        again = sj.load(tmp_path / "rails.nc").sel(**{"track.number": number}).scene
        places = jnp.asarray(1000.0 + np.linspace(-1.0, 65.0, 50))
        for one, other in zip(again.track.irregularity(places)[:2], rail.irregularity(places)[:2], strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-18)


@pytest.mark.full
def test_a_traced_number_of_no_rail_marks_its_case():
    """Where values cannot be looked at, they lose the case and do not choose another rail."""
    rails = sj.model.TrackSet(
        [sj.model.SampledTrack([0.0, 16.0], f * 1e-3 * np.sin(np.arange(65)), 0.0) for f in (1.0, 2.0)]
    )
    seeds, numbers = ([1.0, 0.5, -1.0, most, np.nan, np.inf] for most in (2.0**53, 2.0))
    for track, values in ((RAIL, seeds), (sj.model.RandomRails(RAIL, 0.5), seeds), (rails, numbers)):
        body, name = sled_on() if track.rails else SCENE.slipper, f"track.{track.chosen_by}"
        scene = dataclasses.replace(SCENE, slipper=body, track=track)
        checked = lambda value, scene=scene, name=name: scene.replace(**{name: value})
        unchecked = lambda value, scene=scene, name=name: parameter(name, scene).replaced(scene, value)
        for put in (checked, unchecked):
            height = lambda value, put=put: put(value).track.irregularity(jnp.asarray(11.3)).lateral
            heights = jax.jit(jax.vmap(height))(jnp.asarray(values))
            assert np.isnan(heights).tolist() == [False] + [True] * 5
            assert np.isclose(heights[0], height(jnp.asarray(1.0)), rtol=1e-12)
    status = lambda seed: sj.simulate(ON_RAIL.replace(**{"track.seed": seed}), 1, steps_per_period=STEPS).status
    np.testing.assert_array_equal(jax.jit(jax.vmap(status))(jnp.asarray(seeds)), [0, 1, 1, 1, 1, 1])


@pytest.mark.parametrize("value", [0.5, -1, 2.0**53, np.inf, np.nan, 1 + 1e-12, True, "1", 7])
@pytest.mark.parametrize("chosen_by", ["seed", "number"])
def test_a_number_that_chooses_a_rail_is_whole_and_in_range(chosen_by, value):
    """Before anything is compiled, in each place where one is given; of two rails there is no 7."""
    rails = sj.model.TrackSet(
        [sj.model.SampledTrack([0.0, 16.0], f * 1e-3 * np.sin(np.arange(65)), 0.0) for f in (1.0, 2.0)]
    )
    track, most = (RAIL, "2^53 - 1") if chosen_by == "seed" else (rails, "1")
    if chosen_by == "seed" and value == 7:
        value = -7
    alone, both = (dataclasses.replace(SCENE, track=t) for t in (track, sj.model.SumTrack(SCENE.track, track)))
    own, other = f"track.{chosen_by}", f"track.other.{chosen_by}"
    grid = {own: [value] if isinstance(value, bool | str) else [0.0, value]}
    for make, name in (
        (lambda: dataclasses.replace(track, **{chosen_by: value}), chosen_by),
        (lambda: alone.replace(**{own: value}), own),
        (lambda: both.replace(**{other: value}), other),
        (lambda: sj.sweep(alone, grid, periods=1), own),
        (lambda: sj.run(alone, grid, length=8.0), own),
        (lambda: sj.lyapunov_sweep(alone, grid), own),
    ):
        need = (
            "(finite|a whole number of 0 to 1)" if name == "number" else f"a whole number of 0 to {re.escape(most)}"
        )
        with pytest.raises(ValueError, match=f"Argument `{name}` must be {need}, but is "):
            make()


def test_a_wrong_number_is_shown_with_the_digits_that_make_it_wrong():
    words = re.escape("`seed` must be a whole number of 0 to 2^53 - 1, but is 1.000000001.")
    with pytest.raises(ValueError, match=words):
        sj.RandomTrack.sled(seed=1.000000001)


def test_whole_numbers_are_not_varied_by_little():
    longer = dataclasses.replace(SCENE, track=sj.RandomTrack.sled())
    whole, little = "must be a whole number of 0 to", "cannot be varied by little: it is a whole number"
    for call, words in (
        (lambda: sj.sweeps.sample_box({"track.seed": (0, 100)}, 8, scene=ON_RAIL), whole),
        (lambda: sj.sweeps.sample_box({"track.seed": scipy.stats.uniform(0, 100)}, 8, scene=ON_RAIL), whole),
        (lambda: sensitivities(longer, "peak_force", ["track.seed"]), little),
        (lambda: sj.optimise_design(longer, "peak_force", {"track.seed": (0, 5)}), little),
    ):
        with pytest.raises(ValueError, match=f"`track.seed` {words}"):
            call()


FIRST = 129_773.0
"""Where a survey of one's own section begins [m]."""


def section(first=0.0, last=64.0, **options):
    places = np.linspace(0.0, last, 257)
    return sj.model.SampledTrack(first + places, 1e-3 * np.sin(places), 1e-3 * np.cos(1.7 * places), **options)


NEAR, FAR = (dataclasses.replace(SCENE, track=section(first)) for first in (0.0, FIRST))
SHORT = dict(transient=1, periods=2, steps_per_period=STEPS)
FOUND = {
    "simulate": lambda scene, **more: coordinates(sj.simulate(scene, 3, steps_per_period=STEPS, **more).end),
    "run": lambda scene, **more: sj.run(scene, length=16.0, window=8.0, steps_per_period=STEPS, **more)["peak_force"],
    "sweep": lambda scene, **more: sj.sweep(scene, {"mass": [14.0, 15.0]}, record="strobe", **SHORT, **more)[
        "strobe"
    ],
    "lyapunov_spectrum": lambda scene, **more: (
        sj.lyapunov_spectrum(scene, transient=1, align=1, periods=2, steps_per_period=STEPS, **more).history
    ),
    "period_map": lambda scene, **more: coordinates(
        sj.period_map(scene, sj.initial_state(scene, sj.table_2_start()), steps_per_period=STEPS, **more)
    ),
}
"""What functions give of motions on a rail."""


@pytest.mark.full
@pytest.mark.parametrize("name", FOUND)
def test_motions_begin_where_their_rail_does(name):
    find = FOUND[name]
    np.testing.assert_allclose(find(FAR), find(NEAR), rtol=1e-5, atol=1e-7)
    if name != "period_map":  # whose state is given
        np.testing.assert_allclose(find(FAR, begin=FIRST + 16.0), find(NEAR, begin=16.0), rtol=1e-5, atol=1e-7)
        assert np.max(np.abs(np.asarray(find(NEAR, begin=16.0)) - np.asarray(find(NEAR)))) > 1e-4


def test_what_begins_off_the_rail_is_refused():
    for begin in (0.0, FIRST + 64.0):
        words = f"`begin` must be on the rail, .* 129773 to 129837 m, but is {begin:g}"
        for name in ("simulate", "run", "sweep", "lyapunov_spectrum"):
            with pytest.raises(ValueError, match=words):
                FOUND[name](FAR, begin=begin)


def test_what_leads_beyond_the_rail_is_refused_or_warned_of_with_the_remedies():
    """Records that run on, too: after 3 recorded periods exponents are measured for 20 and 20 more."""
    state = sj.initial_state(FAR, sj.table_2_start())
    run_on = dict(record=["strobe", LyapunovExponents(periods=20, certify=False)], transient=0, periods=3)
    ended = dataclasses.replace(FAR, track=section(FIRST, ends="error"))
    too_far, known = "the rail (ends at|is known up to) 129837 m", "to 129845 m, but the rail is known up to 129837 m"
    for call, words in (
        (lambda: sj.sweep(FAR, {"mass": [14.0]}, transient=8, periods=1), too_far),
        (lambda: sj.follow(FAR, {"mass": [14.0, 15.0, 16.0, 17.0]}, transient=2, periods=1), too_far),
        (lambda: sj.simulate(FAR, 9, steps_per_period=STEPS), known),
        (lambda: sj.period_map(FAR, state, periods=9), known),
        (
            lambda: sj.sweep(FAR, {"mass": [14.0]}, **run_on),
            "leads to 130117 m, but the rail is known up to 129837 m",
        ),
        (lambda: sj.sweep(ended, {"mass": [14.0]}, **run_on), "`periods` must be at most 8 here, .* but is 43"),
    ):
        with pytest.raises((ValueError, sj.ImplausibleWarning), match=words) as told:
            call()
        if words is known:
            # the remedies, with numbers to type
            assert 'a rail that repeats (ends="repeat", ramp=8) goes on' in str(told.value)
            assert "RandomTrack.like(survey, length=72)" in str(told.value)


@pytest.mark.full
def test_tables_by_distance_must_reach_the_rail():
    fast = lambda **more: sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0)], start=800.0, **more)
    with pytest.raises(ValueError, match="`speed` must be by distances along the rail, which begins at 129773 m"):
        sj.simulate(dataclasses.replace(FAR, speed=fast()), 2)
    lift = sj.model.TabulatedLoad([[0.0, 0.0, 10.0]], distance=[500.0])
    for load in (lift, sj.model.SumLoad([sj.model.AppliedLoad(), lift])):
        with pytest.raises(ValueError, match=r"`load` must be by distances along the rail, .* a table up to 500 m"):
            sj.simulate(dataclasses.replace(FAR, load=load), 2)
    there = sj.run(dataclasses.replace(FAR, speed=fast(begin=FIRST)), length=16.0, steps_per_period=STEPS)
    here = sj.run(dataclasses.replace(NEAR, speed=fast()), length=16.0, steps_per_period=STEPS)
    np.testing.assert_allclose(there["speed"], here["speed"])


def test_times_that_begin_before_the_rail_warn():
    history = sj.SpeedProgramme.over_time([0.0, 10.0, 2e3], [0.0, 900.0, 900.0])
    scene = dataclasses.replace(FAR, speed=history)
    with pytest.warns(sj.ImplausibleWarning, match="begins at 129773 m, the beginning of the rail, but its speeds"):
        assert beginning_of(scene, None) == FIRST
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert beginning_of(scene, FIRST + 8.0) == FIRST + 8.0
        moved = sj.SpeedProgramme.over_time([0.0, 10.0], [0.0, 900.0], begin=FIRST)
        assert beginning_of(dataclasses.replace(FAR, speed=moved), None) == FIRST


def test_sums_and_sets_begin_where_all_of_their_rails_are_known():
    joints = sj.model.LocalTrack(place=[6.0], height=[-3e-4], length=0.5, shape="joint", every=12.0)
    assert sj.model.SumTrack(joints, FAR.track).origin == FIRST
    assert sj.model.SumTrack(section(-20.0), joints).origin == -20.0
    assert sj.model.TrackSet([section(3.0), section(5.0)]).origin == 5.0
    assert section(5.0, ends="error").origin == 5.0
    closed = sj.model.SampledTrack(5.0 + PLACES, 1e-3 * WAVE, 0.0, ends="repeat")
    assert closed.origin == RAIL.origin == SCENE.track.origin == 0.0


def test_runs_beyond_a_rail_are_refused_and_so_are_orbits_where_nothing_recurs():
    short = dataclasses.replace(ON_RAIL, track=dataclasses.replace(RAIL, ends="error"))
    for run in (
        lambda: sj.simulate(short, 51),
        lambda: sj.sweep(short, {"speed": [1000.0]}, transient=30, periods=21),
    ):
        with pytest.raises(ValueError, match=r"`periods` must be at most 50 here, .* the rail ends at 400 m"):
            run()
    for call in (sj.periodic_orbit, lambda s: sj.continue_orbit(s, "speed", (900.0, 1100.0))):
        with pytest.raises(ValueError, match="`scene` must have a track that recurs with the forcing period"):
            call(ON_RAIL)


@pytest.mark.full
def test_a_window_is_the_period_of_a_scene():
    """Of two waves of 8 m: the state after one window is that after two periods, and every window recurs."""
    scene = sj.paper_scene()
    doubled = dataclasses.replace(scene, window=16.0)
    assert float(doubled.period) == 2 * float(scene.period)
    start = sj.initial_state(scene, sj.table_2_start())
    once = sj.period_map(doubled, start, steps_per_period=400)
    twice = sj.period_map(scene, start, periods=2, steps_per_period=200)
    # measured: 1.4e-12 rad/s of 12
    np.testing.assert_allclose(coordinates(once), coordinates(twice), rtol=0, atol=1e-10)
    assert float(doubled.recurrence) == 1.0
    assert float(dataclasses.replace(scene, window=12.0).recurrence) == 2.0


@pytest.mark.full
def test_where_a_run_begins_may_be_traced():
    scene = sj.paper_scene()
    start = sj.initial_state(scene, sj.table_2_start())
    options = dict(steps_per_period=20, solver=sj.solvers.RK4())
    velocities = lambda state: jnp.stack([state.motion.v_y, state.motion.v_z])

    def after(begin):
        return velocities(sj.period_map(scene, start, begin=begin, **options))

    plain = after(3.0)
    found = jax.vmap(after)(jnp.array([3.0, 11.0, jnp.inf]))
    # measured: 1e-15 m/s; the rail recurs after 8 m
    np.testing.assert_allclose(found[:2], [plain, plain], rtol=0, atol=1e-12)
    assert np.isnan(found[2]).all()  # beyond every rail
    slope = (after(3.0 + 1e-5) - after(3.0 - 1e-5)) / 2e-5
    # measured: 6e-10
    np.testing.assert_allclose(jax.jacfwd(after)(3.0), slope, rtol=1e-7)
    run = jax.jit(lambda begin: sj.simulate(scene, 1, start=start, begin=begin, **options))(3.0)
    np.testing.assert_allclose(velocities(run.end), plain, rtol=0, atol=1e-12)
