"""Wrong inputs of a right kind are answered in one line; tests/test_arguments.py has those of another kind."""

import inspect

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis, design, flow, model, sweeps

SCENE = sj.paper_scene()
LATCHED = sj.paper_scene(memory=sj.model.EventLatch())
OF_PATHS = {
    "file": [sj.load_rail, SCENE.to_toml],
    "path": [sweeps.store_status, sweeps.check_store],
    "folder": [sj.compile_cache],
}


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


OTHERS = [
    (lambda: model.parameter("memory.slowest", LATCHED), "`.*EventLatch has no numbers, and so not 'slowest'"),
    (lambda: model.parameter("a" * 10**5, SCENE), "`'aaa.* is no parameter"),
    (lambda: sj.SpeedProgramme([0.0, 1.0], [1.0, 2.0], []), "`scale` must be of shape"),
    # since Python 3.13 `repr` of a deep list is no error
    (lambda: SCENE.replace(speed=_deep(5000)), r"`speed` must be positive, but is (<list>|\[\[\[)"),
    (lambda: sj.simulate(SCENE, 10**5000), "`periods` must be at most"),
    (lambda: sj.sweeps.processes(10**30), "`count` must be at most 4096"),
    (lambda: sj.sweeps.sample_box({"speed": (1.0, 2.0)}, 10**400), "`count` must be at most"),
    (lambda: flow.PowerMean(flow.Strobe()), "`record` must be a record of one number"),
    (lambda: flow.OnePoint(flow.RECORDS["peak_force"], 3), "`point` must be a point's name"),
    (lambda: design.Descent(optimiser=3), "`optimiser` must be an optax"),
    # without the tests' own checks of types, which would answer first
    (lambda: inspect.unwrap(analysis.extend)(None, (0.0, 1.0)), "`branch` must be"),
    (lambda: analysis.ode_step(lambda t, s: s, dt=0.1, steps=3, solver="Tsit5"), "`solver` must be a diffrax solver"),
    (lambda: analysis.classify(np.ones((20, 2)), floor=()), "`floor` must be one number"),
]


@pytest.mark.parametrize(("call", "words"), OTHERS, ids=[row[1] for row in OTHERS])
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
