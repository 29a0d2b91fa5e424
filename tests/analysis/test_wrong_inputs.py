"""Texts and None in place of arrays, maps and branches are answered in one line that names the argument."""

import inspect

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis, design, flow, model, orbits, sweeps

plain = inspect.unwrap  # the tests' own checks of types would answer first
OF_NUMBERS = {
    "strobe": [analysis.classify],
    "series": [analysis.zero_one_test],
    "exponents": [analysis.kaplan_yorke],
    "history": [
        analysis.weighted_mean,
        analysis.standard_error,
        analysis.one_motion_standard_error,
        analysis.pooled_standard_error,
    ],
    "matrices": [plain(analysis.multipliers), lambda matrices: analysis.largest_exponent(matrices, 2)],
    "least_mean_life": [lambda life: analysis.lasting("chaotic", life)],
}
OTHERS = {
    "spectrum": [lambda spectrum: plain(analysis.find_line)(spectrum, 3.0)],
    "equations": [lambda equations: plain(analysis.continue_motion)(equations, (0.0, 1.0), (0.0, 2.0))],
    "branch": [
        lambda branch: plain(analysis.extend)(branch, (0.0, 1.0)),
        lambda branch: plain(analysis.switch)(branch, None),
    ],
    "function": [lambda function: plain(analysis.with_step_error)(function, 3)],
    "steps": [lambda steps: plain(analysis.with_step_error)(lambda n: n, steps)],
}


@pytest.mark.parametrize("wrong", [None, "text", [[1.0], [1.0, 2.0]], object()])
@pytest.mark.parametrize(("name", "function"), [(n, f) for n, all_of in OF_NUMBERS.items() for f in all_of])
def test_what_is_no_numbers(name, function, wrong):
    with pytest.raises(ValueError, match=f"^Argument `{name}` must be .*numbers") as told:
        function(wrong)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("wrong", [None, "text", 3.5])
@pytest.mark.parametrize(("name", "function"), [(n, f) for n, all_of in OTHERS.items() for f in all_of])
def test_what_is_of_another_kind(name, function, wrong):
    with pytest.raises(ValueError, match=f"^Argument `{name}` must be"):
        function(wrong)


SCENE = sj.paper_scene()
LATCHED = sj.paper_scene(memory=sj.EventLatch())
OF_SCENES = [
    model.contact_points,
    model.accuracy_scales,
    model.scene_to_json,
    sj.contact_duration,
    sj.vector_field,
    lambda scene: model.rail_frame(scene, 0.0),
    lambda scene: sj.sample_box({"speed": (1.0, 2.0)}, 4, scene=scene),
]
OF_PATHS = {
    "file": [sj.load_rail, SCENE.to_toml],
    "path": [sj.open_store, sweeps.store_status, sweeps.check_store],
    "folder": [sj.compile_cache],
}


@pytest.mark.parametrize("wrong", ["text", 3.5, {}, sj.Motion()])
@pytest.mark.parametrize("function", OF_SCENES)
def test_what_is_no_scene(function, wrong):
    with pytest.raises(ValueError, match=r"^Argument `scene` must be a slipperjax.Scene, but is"):
        function(wrong)


@pytest.mark.parametrize("wrong", [b"bytes", 3.5, ["a"], "a\0b", "x" * 100_000])
@pytest.mark.parametrize(("name", "function"), [(n, f) for n, all_of in OF_PATHS.items() for f in all_of])
def test_what_is_no_path(name, function, wrong):
    with pytest.raises(ValueError, match=f"^Argument `{name}` must be a path, but is") as told:
        function(wrong)
    assert len(str(told.value)) < 200


def _deep(levels):
    value = 1.0
    for _ in range(levels):
        value = [value]
    return value


STATE = sj.initial_state(SCENE, sj.Motion())
OTHERS_OF_THE_MODEL = [
    (lambda: sj.simulate(SCENE, 2, steps_per_period=[40, 80]), "`steps_per_period` must be a whole number"),
    (lambda: sj.Store(None), "`store` must be a path that ends in .zarr"),
    (lambda: model.parameter("memory.slowest", LATCHED), "`.*EventLatch has no numbers, and so not 'slowest'"),
    (lambda: sj.reactions("now", STATE, sj.Args(SCENE)), "`t` must be real numbers"),
    (lambda: sj.reactions(0.0, None, sj.Args(SCENE)), "`state` must be a slipperjax.State"),
    (lambda: sj.reactions(0.0, STATE, SCENE), "`args` must be slipperjax.Args"),
    (lambda: sj.initial_state(SCENE, sj.Motion(), "now"), "`epoch` must be finite"),
    (lambda: sj.initial_state(SCENE, sj.Motion(), 10**400), "`epoch` must be finite"),
    (lambda: model.rail_frame(SCENE, "now"), "`phase` must be real numbers"),
    (lambda: model.quaternion_from_euler(0.1, None, 0.0), "`pitch` must be real numbers"),
    (lambda: model.quaternion_from_euler(0.1, 1j, 0.0), "`pitch` must be real numbers"),
    (lambda: model.euler_angles(SCENE), "`m` must be a slipperjax.Motion"),
    (lambda: model.scaled_size(3.0), "`motion` must be a slipperjax.Motion"),
    (lambda: model.parameter("speed.x", "text"), "`scene` must be a slipperjax.Scene"),
    (lambda: model.parameter("a" * 10**5, SCENE), "`'aaa.* is no parameter"),
    (lambda: model.quantity(3), "`name` must be the name of a quantity"),
    (lambda: model.scene_from_json(None), "`text` must be JSON of a scene"),
    (lambda: model.scene_from_toml(b""), "`text` must be TOML text of a scene"),
    (lambda: sj.TrackSet(3), "`tracks` must be one or more rails"),
    (lambda: sj.SpeedProgramme([0.0, 1.0], [1.0, 2.0], []), "`scale` must be of shape"),
    (lambda: SCENE.replace(speed=_deep(200)), "`speed` must be positive"),
    # since Python 3.13 `repr` of a deep list is no error
    (lambda: SCENE.replace(speed=_deep(5000)), r"`speed` must be positive, but is (<list>|\[\[\[)"),
    (lambda: SCENE.replace(speed=[[1.0], [1.0, 2.0]]), "`speed` must be positive"),
    (lambda: sj.simulate(SCENE, 10**5000), "`periods` must be at most"),
    (lambda: sj.processes(10**30), "`count` must be at most 4096"),
    (lambda: sj.sample_box({"speed": (1.0, 2.0)}, 10**400), "`count` must be at most"),
    (lambda: sj.sample_box({"speed": (1.0, 2.0)}, 4, log=3), "`log` must be a list"),
    (lambda: flow.PowerMean(None), "`record` must be a record of one number"),
    (lambda: flow.PowerMean(flow.Strobe()), "`record` must be a record of one number"),
    (lambda: flow.OnePoint("peak_force"), "`record` must be a slipperjax.flow.Record"),
    (lambda: flow.OnePoint(flow.RECORDS["peak_force"], 3), "`point` must be a point's name"),
    (lambda: flow.History(0.5), "`saves` must be a whole number"),
    (lambda: flow.Strobe(3), "`from_start` must be True or False"),
    (lambda: design.TrustRegion(radius="wide"), "`radius` must be positive"),
    (lambda: design.Descent(steps=0), "`steps` must be a whole number of 1"),
    (lambda: design.Descent(optimiser=3), "`optimiser` must be an optax"),
    (lambda: sj.OrbitBranch(3), "`points` must be an xarray.Dataset"),
    (lambda: orbits.OrbitCurve(None), "`points` must be an xarray.Dataset"),
]


@pytest.mark.parametrize(("call", "words"), OTHERS_OF_THE_MODEL, ids=[row[1] for row in OTHERS_OF_THE_MODEL])
def test_other_wrong_inputs_are_one_line(call, words):
    with pytest.raises(ValueError, match=f"^Argument {words}") as told:
        call()
    assert len(str(told.value).splitlines()) == 1


OUTSIDE_OF_JIT = [
    lambda v: sj.run(SCENE.replace(speed=v), length=16),
    lambda v: sj.run(SCENE, length=v),
    lambda v: sj.sweep(SCENE, {"speed": [v]}),
    lambda v: sj.continue_orbit(SCENE.replace(speed=v), "length", (0.1, 0.3)),
    lambda v: sj.optimise_design(SCENE.replace(speed=v), "peak_force", {"length": (0.1, 0.3)}),
    lambda v: design.sensitivities(SCENE.replace(speed=v), "peak_force"),
    lambda v: SCENE.replace(speed=v).to_toml(),
]


@pytest.mark.parametrize("function", OUTSIDE_OF_JIT)
def test_what_cannot_be_inside_jit(function):
    with pytest.raises(ValueError, match=r"^Argument `\w+` must be of values that are known: call this outside of"):
        jax.jit(function)(900.0)


_same, _gap = lambda t, s: s, lambda t, s: s[0]
OF_ANALYSES = [
    (lambda: analysis.kaplan_yorke(1.0), "`exponents` must be numbers along one axis or more, but is of shape"),
    (lambda: analysis.standard_error(np.ones(2)), "`history` must be numbers with 2 axes or more, but is of shape"),
    (lambda: analysis.shoot(_same, np.zeros(1), intervals=0), "`intervals` must be a whole number of 1 or more"),
    (lambda: analysis.shoot(_same, np.zeros(1), tolerance=-1.0), "`tolerance` must be positive, but is -1"),
    (lambda: analysis.shoot(_same, np.zeros(1), scale=3), "`scale` must be a function, but is 3"),
    (lambda: analysis.impact_step(_same, _gap, None, dt=0.1, steps=1), "`reset` must be a function, but is None"),
    (lambda: analysis.impact_step(_same, _gap, _gap, dt=0.1, steps=0.5), "`steps` must be a whole number"),
    (lambda: analysis.return_step(_same, 3, dt=0.1), "`surface` must be a function, but is 3"),
    (lambda: analysis.return_step(_same, _gap, dt=0.1, most=0), "`most` must be a whole number of 1 or more"),
    (lambda: analysis.ode_step(_same, dt=0.1, steps=3, solver="Tsit5"), "`solver` must be a diffrax solver"),
    (lambda: analysis.ode_step(1, dt=0.1, steps=3), "`vector_field` must be a function, but is 1"),
    (lambda: analysis.minimal_period(3, np.ones(2), 2), "`step` must be a function"),
    (lambda: analysis.classify(np.ones((20, 2)), scales=object()), "`scales` must be positive"),
    (lambda: analysis.classify(np.ones((20, 2)), tolerance="text"), "`tolerance` must be finite"),
    (lambda: analysis.classify(np.ones((20, 2)), floor=()), "`floor` must be one number"),
    (lambda: analysis.regime([1.0], [0.1], ["chaotic"], None), "`trusted` must be numbers"),
    (lambda: analysis.regime([1.0], "text", ["chaotic"], [True]), "`stderr` must be numbers"),
]


@pytest.mark.parametrize(("call", "words"), OF_ANALYSES, ids=[row[1] for row in OF_ANALYSES])
def test_wrong_settings_of_analyses(call, words):
    with pytest.raises(ValueError, match=f"^Argument {words}"):
        call()
