"""Bad input: one clear error that names argument, value and need, before anything is compiled."""

import warnings

import diffrax
import jax
import numpy as np
import pint
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.sweeps.grid import Grid
from slipperjax.tools.checks import Check, number, positive
from slipperjax.tools.description import subclasses
from slipperjax.tools.fields import ShapeChecked
from slipperjax.tools.units import pint_unit

SCENE = sj.paper_scene()
slipper = lambda **changed: sj.Slipper(**dict(mass=1.0, inertia=(1, 1, 1), length=1.0) | changed)
run = lambda periods=1, **options: sj.simulate(SCENE, periods, **options)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: sj.paper_scene(speed=-5.0), "`speed` must be positive, but is -5 m/s"),
        (lambda: slipper(mass=-1.0), "`mass` must be positive, but is -1 kg"),
        (lambda: run(solver=diffrax.LeapfrogMidpoint()), "`solver` must be a one-step method"),
    ],
)
def test_errors_name_argument_value_and_need(call, words):
    with pytest.raises(ValueError, match=r"^Argument ") as caught:
        call()
    assert words in str(caught.value)


def test_traced_values_that_are_out_of_range_give_nan_and_a_status():
    period = jax.jit(lambda v: sj.paper_scene(speed=v).period)
    assert np.isnan(period(-1.0))
    assert np.isclose(period(1250.0), 6.4e-3)
    status = jax.jit(lambda c, m: sj.simulate(SCENE.replace(clearance=c, mass=m), 1, steps_per_period=50).status)
    assert status(1e-3, 14.0) == Status.FINITE
    assert status(-1e-3, 14.0) == status(1e-3, -14.0) == Status.NOT_FINITE


@pytest.mark.full
def test_starts_in_32_bits_run_as_64_bits():
    start = sj.initial_state(SCENE, sj.table_2_start())
    short = jax.tree.map(lambda a: a.astype(np.float32), start)
    run = lambda state: sj.period_map(SCENE, state, periods=1, steps_per_period=50)
    exact = jax.tree.map(lambda a: a.astype(np.float64), short)
    for one, other in zip(*(jax.tree.leaves(run(state)) for state in (short, exact)), strict=True):
        np.testing.assert_array_equal(one, other)


STATE = sj.initial_state(SCENE, sj.table_2_start())
GRID = {"speed": [1000.0, 1200.0]}
FIELD, ARGS = sj.model.vector_field(SCENE), sj.model.Args(SCENE)
CALLS = {
    "initial_state": lambda: sj.initial_state(SCENE, sj.table_2_start()),
    "period_map": lambda: sj.period_map(SCENE, STATE),
    "simulate": lambda: sj.simulate(SCENE, 1),
    "run": lambda: sj.run(SCENE, length=8.0),
    "sweep": lambda: sj.sweep(SCENE, GRID, steps_per_period=50),
    "lyapunov_sweep": lambda: sj.lyapunov_sweep(SCENE, GRID, steps_per_period=50),
    "vector_field": lambda: FIELD.evaluate(0.0, STATE, ARGS),
    "diffeqsolve": lambda: diffrax.diffeqsolve(
        diffrax.ODETerm(FIELD), sj.solvers.RK4(), 0.0, 1.0, 0.01, STATE, args=ARGS
    ),
    "an ODE of one's own": lambda: sj.analysis.ode_spectrum(lambda t, y, args: -y, np.ones(2), 3, dt=0.1, steps=2),
    "a function of one's own": lambda: sj.jit(lambda x: 2 * x)(1.0),
}


@pytest.mark.filterwarnings("ignore:Explicitly requested dtype")  # JAX's own, of diffrax's call
@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_nothing_is_computed_in_32_bits(call):
    """Where the option was switched off after the import."""
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="Option `jax_enable_x64` must be on, as slipperjax sets it on import"):
            call()
    finally:
        jax.config.update("jax_enable_x64", True)


Q = pint.Quantity
WAVE = Q(np.sin(np.arange(9.0)), "mm")
STAGES = [sj.Stage(Q(20.0, "standard_gravity"), length=Q(0.1, "km")), sj.Stage(0.0, duration=Q(1e3, "ms"))]


@pytest.mark.parametrize(
    ("given", "exact"),
    [
        (lambda: sj.paper_scene(speed=Q(900.0, "km/h")).speed, 250.0),
        (lambda: sj.paper_scene(clearance=Q(1.0, "mm"), length=Q(2.0, "dm")).section.play, [0.5e-3] * 5),
        (lambda: SCENE.replace(**{"section.play.2": Q(0.4, "mm")}).section.play[2], 0.4e-3),
        (lambda: sj.HarmonicTrack([Q(8.0, "m"), Q(100.0, "cm")], Q(1.0, "mm")).wavelengths, [8.0, 1.0]),
        (lambda: sj.model.SampledTrack(Q([0.0, 10.0], "ft"), WAVE, WAVE).distance, [0.0, 3.048]),
        (lambda: sj.RandomTrack.sled(band=(Q(50, "cm"), Q(100, "m"))).band, [0.5, 100.0]),
        (lambda: sj.SpeedProgramme.over_distance(Q([0.0, 1.0], "km"), Q([36.0, 72.0], "km/h")).speed, [10.0, 20.0]),
        (lambda: sj.SpeedProgramme.stages(STAGES, start=Q(36.0, "km/h")).distance[:2], [0.0, 100.0]),
        (lambda: sj.model.AppliedLoad(force=Q([0.0, 0.0, -1.0], "kN")).force, [0.0, 0.0, -1000.0]),
        (lambda: sj.model.EventLatch(slowest=Q(1.0, "mm/s")).slowest, 1e-3),
        (lambda: sj.Motion.from_euler(roll=Q(1.0, "degree")).q_x, np.sin(np.pi / 360)),
        (lambda: Grid(SCENE, {"speed": Q([900.0, 1800.0], "km/h")}).axes["speed"], [250.0, 500.0]),
        (lambda: Grid(SCENE, {"start_y": [Q(1.0, "mm"), 2e-3]}).axes["start_y"], [1e-3, 2e-3]),
        (lambda: number(positive, "length", Q(1.0, "km"), "m"), 1000.0),
    ],
)
def test_quantities_are_converted(given, exact):
    np.testing.assert_allclose(given(), exact, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: SCENE.replace(speed=Q(30.0, "kg")), f"`speed` must be positive, but is {Q(30.0, 'kg')!r}"),
        (lambda: sj.Motion(y=Q(1.0, "mm/s")), f"`y` must be in m, but is {Q(1.0, 'mm/s')!r}"),
        (lambda: sj.RandomTrack.sled(length=Q(1.0, "s")), f"`length` must be in m, but is {Q(1.0, 's')!r}"),
        (lambda: run(begin=Q(1.0, "s")), f"`begin` must be finite, but is {Q(1.0, 's')!r}"),
    ],
)
def test_quantities_of_another_dimension_are_refused(call, words):
    with pytest.raises(ValueError, match=r"^Argument ") as caught:
        call()
    assert words in str(caught.value)


def test_every_field_with_a_unit_takes_quantities_of_its_dimension():
    kinds = [kind for kind in subclasses(ShapeChecked) if kind.__module__.startswith("slipperjax")]
    converters = [f.metadata.get("converter") for kind in kinds for f in kind.__dataclass_fields__.values()]
    checks = [converter for converter in converters if isinstance(converter, Check)]
    assert len(checks) > 40
    for check in checks:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", sj.ImplausibleWarning)  # one is no stiffness
            assert float(check(Q(1.0, pint_unit(check.unit)))) == 1.0
        with pytest.raises(ValueError, match=f"Argument `{check.name}` must be"):
            check(Q(1.0, "kelvin"))


def test_a_list_of_corners_that_begins_late_is_warned_of():
    section = SCENE.section
    late = tuple(zip("ACEGI", "BDFHJ", strict=True))
    with pytest.warns(sj.ImplausibleWarning, match="Does the list of corners begin one corner late?"):
        sj.Section(points=section.points, play=section.play, faces=late)
    # two slopes that meet over the middle carry the weight, and a box below its faces has no gap that could
    sj.Section(points=np.array([[-0.03, 0], [0, 0.02], [0, 0.02], [0.03, 0]]), play=np.zeros(2), names=tuple("ABCD"),
               faces=(("A", "B"), ("C", "D")))  # fmt: skip
