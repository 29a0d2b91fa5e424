"""Every argument of the public functions and classes answers what it cannot be in one line that names it.

The table is made from their signatures, so that a new argument stands in it by itself, where those without a default
are known by name. Errors come before anything is simulated.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis, design, fitting, flow, model, orbits, plots, results, solvers, sweeps

SCENE = sj.paper_scene()
RAIL = sj.RandomTrack.sled(length=250.0)
LEVEL = sj.model.StraightTrack()
FLAT = np.zeros(5)


def field(t, state):
    return state


def first(t, state):
    return state[0]


FINE = dict(
    # scenes and what they are made of
    **dict(scene=SCENE, speed=900.0, slipper=SCENE.slipper, section=SCENE.section, track=SCENE.track),
    **dict(contact=SCENE.contact, mounts=[sj.Mount(1.0), sj.Mount(-1.0)], mass=14.0, inertia=(0.05, 0.06, 0.09)),
    **dict(length=16.0, stiffness=1e8, restitution=0.9, hysteresis=0.1, clearance=1e-3, coefficient=0.1, power=1e6),
    **dict(points=SCENE.section.points, play=SCENE.section.play, amplitude=1e-3, wavelengths=(8.0,)),
    **dict(distance=np.arange(5.0), lateral=FLAT, vertical=FLAT, place=[4.0], height=[1e-3], left=LEVEL, right=LEVEL),
    **dict(one=LEVEL, other=LEVEL, tracks=[RAIL], rail=RAIL, coherence=0.5, force=np.zeros((3, 3))),
    **dict(frequency=[10.0], damping=[0.01], shapes=np.ones((1, 1, 3)), area=0.1, acceleration=9.81, exponent=0.5),
    **dict(time=[0.0, 1.0, 2.0], thrust=[9e4, 9e4, 0.0], begin=10.0, end=20.0, low=0.02, high=0.8, values=[1e-6]),
    # motions
    **dict(
        motion=sj.Motion(),
        m=sj.Motion(),
        state=sj.initial_state(SCENE, sj.Motion()),
        args=sj.model.Args(SCENE),
        t=0.0,
    ),
    **dict(phase=0.0, roll=0.0, pitch=0.0, yaw=0.0),
    # grids, names and files
    **dict(grid={"speed": [900.0]}, path={"speed": [900.0, 950.0]}, box={"speed": (900.0, 950.0)}, count=4),
    **dict(designs={"clearance": [1e-3]}, variables={"clearance": (1e-3, 2e-3)}, objective="peak_force"),
    **dict(objectives="peak_force", name="speed", bounds=(900.0, 2000.0), file="none.csv", record="peak_force"),
    # systems and samples
    **dict(step=field, intervals=4, vector_field=field, above=field, below=field, surface=first, reset=field),
    **dict(dt=0.1, steps=4, function=lambda n: n, strobe=np.ones((20, 2)), history=np.ones((20, 2)), samples=20),
    **dict(exponents=[0.1, -0.2], series=np.ones(200), signal=np.ones(64), ensemble=np.ones((3, 4)), rate=100.0),
    **dict(sampling_rate=100.0, angle=np.ones(20), natural_frequency=[20.0], edges=np.array([10.0, 20.0])),
    # what takes a computation to make
    **dict.fromkeys(
        ["branch", "cases", "design", "ds", "equations", "frame", "least_mean_life", "loads", "matrices"]
    ),
    **dict.fromkeys(["measured", "motions", "report", "result", "run", "runs", "solver", "source", "spectrum"]),
    **dict.fromkeys(["text", "volume_per_work"]),
)
"""A value of each argument that has no default, by name; of None only the argument itself is tried."""
OWN = {
    "explain": dict(function=sj.sweep),
    "compare": dict(scene=dataclasses.replace(SCENE, track=RAIL)),
    "OnePoint": dict(record=flow.RECORDS["peak_force"]),
    "RandomTrack": dict(lateral=None, vertical=model.CornerSpectrum(1e-7, 0.02, 0.8)),
    "Store": dict(path="map.zarr"),
    "SurveyedRails": dict(file=None),
    "SurveyedTrack": dict(file=None),
    "load_modes": dict(file=None),
    "load_rail": dict(file=None),
    "load_speed": dict(file=None),
    "map_spectrum": dict(state=np.ones(2)),
    "minimal_period": dict(state=np.ones(2)),
    "ode_spectrum": dict(state=np.ones(2)),
    "over_rails": dict(values=None),
    "resample": dict(samples=np.arange(3.0)),
    "running_level": dict(acceleration=np.ones(64)),
    "shock_response_spectrum": dict(acceleration=np.ones(64)),
    "shoot": dict(state=np.ones(2)),
    "vibration_environment": dict(acceleration=None),
    "window_densities": dict(acceleration=np.ones(64)),
}
"""Other values for some."""
NOT_ASKED = {
    # what takes them checks them, because programs make them, too
    **dict.fromkeys(("Args", "AtRest", "Irregularity", "ModalMotion", "Motion", "PayloadMotion", "State", "Status")),
    # errors, and what takes any function
    **dict.fromkeys(("Course", "Regime", "StoreInUse", "WorkerLost", "ImplausibleWarning", "Interrupted", "jit")),
    # whatever a function of one's own takes
    "ode_step": ["args"],
    "ode_spectrum": ["args", "state"],
    "RandomTrack": ["first"],
    # answer by another argument that is missing, or have other arguments than their signatures say
    "animate_bending": ["reach"],
    "extend": ["branch"],
    "continue_event": ["branch"],
    "critical_motion": ["motions"],
    "event_sensitivities": ["branch"],
    "orbit_form": ["branch"],
    "fit": ["measured", "solver"],
    "passing": ["branch"],
    "event_margins": ["cases", "design"],
    "telemetry": ["measured"],
    # "is no parameter; the names are ..."
    "continue_orbit": ["name"],
    "parameter": ["name"],
    "solver_named": ["name"],
    "SimplifiedNewton": None,
    "sensitivities": ["names"],
    # a context, which answers where it is entered
    "styled": None,
}
"""Arguments by function that need not answer, or None for all of them."""
NAMED = {"Store": {"path": "store"}, "sensitivities": {"objectives": "objective"}}
"""Other names of arguments in their errors."""
ROOMS = (sj, analysis, design, fitting, flow, model, orbits, plots, results, solvers, sweeps)
WRONG = (object(), [[1.0], [1.0, 2.0]])


def public() -> dict[str, Callable]:
    """Functions and classes of the rooms, by name."""
    members = [(name, getattr(room, name)) for room in ROOMS for name in dir(room) if name[0] != "_"]
    # of a function and a module of the same name, the function
    found = {name: f for name, f in members if callable(f) and f.__module__.startswith("slipperjax.")}
    # the tests' own checks of types would answer first
    return {
        name: inspect.unwrap(f)
        for name, f in found.items()
        if not inspect.isabstract(f) and NOT_ASKED.get(name, []) is not None
    }


def rows() -> Iterator[tuple[str, str, Callable]]:
    """Names of a function and of an argument, and the function of that argument alone."""
    for name, function in public().items():
        every = inspect.signature(function).parameters.values()
        # those that can be given by name
        named = [one for one in every if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)]
        known = FINE | OWN.get(name, {})
        needed = {one.name: known.get(one.name) for one in named if one.default is one.empty}
        for one in named:
            others = {other: value for other, value in needed.items() if other != one.name}
            is_alone = inspect.isfunction(function) and one.name in known and known[one.name] is None
            is_known = all(value is not None for value in others.values())
            if one.name not in NOT_ASKED.get(name, []) and (is_known or is_alone):
                yield name, one.name, functools.partial(function, **others)


ROWS = list(rows())


@pytest.mark.parametrize("function", sorted({name for name, *_ in ROWS}))
def test_an_argument_that_cannot_be_is_named_in_one_line(function):
    for name, argument, call in ROWS:
        if name != function:
            continue
        named = NAMED.get(function, {}).get(argument, argument)
        for wrong in WRONG:
            with pytest.raises(ValueError, match=rf"^(Argument|Option) `{named}` must [^\n]*\Z") as told:
                call(**{argument: wrong})
            assert len(str(told.value)) < 600


def test_there_are_four_hundred_arguments():
    assert len(ROWS) > 400
