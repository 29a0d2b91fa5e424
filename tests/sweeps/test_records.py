"""Records: each against histories with all steps; the same numbers whatever the chunks; labels, statuses, errors."""

import functools
import warnings
from dataclasses import dataclass

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.datasets import load_call
from slipperjax.flow.numbers import Record
from slipperjax.flow.record import History, PoincareSections, Strobe
from slipperjax.flow.status import Status
from slipperjax.model.quantities import ACCELERATIONS, COORDINATES, LOADS, SECTIONS, Quantity
from slipperjax.sweeps.attractors import Motions, attractors
from slipperjax.sweeps.call import Call, make_plan
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.plan import AbstractStage
from slipperjax.sweeps.records import MotionKind, resolved_record
from slipperjax.tools.columns import column

PERIODS, STEPS = 20, 50  # all of them in the programs of test_sweep, but those of records
RECORD = ["loads", "rms", "extremes", "strobe", "motion", PoincareSections(4)]
# the first begins on its orbit, the last is lost at its first contact
CASES = {"speed": np.array([1250.0, 1000.0, 1500.0, 900.0, 1e-3])}
SEVERAL = np.array([50, 50, 50, 100, 50])  # the programs have room for more steps than most of the cases take
OPTIONS = dict(product=False, transient=10, periods=PERIODS, chunk=8)
pytestmark = pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose


@functools.cache
def settled():
    """A state near the orbit at 1250 m/s, by the program of test_sweep."""
    end = None
    for _ in range(20):
        end = sj.simulate(sj.paper_scene(), 20, steps_per_period=STEPS, start=end)
    return end.end


def swept(record, grid=CASES, steps=STEPS, clearance=1e-3, **options):
    options = OPTIONS | dict(start=settled(), steps_per_period=steps) | options
    return sj.sweep(sj.paper_scene(clearance=clearance), grid, record=record, **options)


@pytest.fixture(scope="module")
def reduced():
    return swept(RECORD, steps=SEVERAL)


@pytest.fixture(scope="module")
def history():
    """Every step of all cases but the fourth; of that every other one."""
    return swept("history", steps=SEVERAL, saves_per_period=STEPS)


@pytest.mark.full
def test_loads_and_statuses_are_those_of_a_history(reduced, history):
    wide = dict(clearance=400.0, grid={"speed": [1250.0, 1000.0]}, steps=SEVERAL[2:4], start=None)
    free = swept(RECORD, **wide), swept("history", saves_per_period=STEPS, **wide)
    for (found, exact), status in (
        ((reduced, history), [0, 0, 0, 0, Status.NOT_FINITE]),
        (free, [Status.NO_CONTACT] * 2),
    ):
        assert found["status"].values.tolist() == exact["status"].values.tolist() == status
        np.testing.assert_array_equal(found["steps_per_period"].values, exact["steps_per_period"].values)
        for name in LOADS:
            assert found[name].attrs == exact[name].attrs
            # measured 2e-12: programs with other records are fused, and round, differently
            np.testing.assert_allclose(found[name].values, exact[name].values, rtol=1e-10, atol=1e-15, err_msg=name)
    assert set(free[0]["kind"].values) == {"unresolved"}


@pytest.mark.full
def test_rms_and_extremes_are_those_of_all_samples(reduced, history):
    found, exact = (ds.isel(case=slice(0, 3)) for ds in (reduced, history))
    for name, q in ACCELERATIONS.items():
        rms = np.sqrt((exact[name] ** 2).mean("time"))
        # equal weights of the ends of steps are of second order: see the test of finer steps
        np.testing.assert_allclose(found[f"rms_{name}"].values, rms.values, rtol=0.15)
        assert found[f"rms_{name}"].attrs["units"] == q.unit
    for name in COORDINATES:
        x = exact[name]
        largest = found[f"largest_{name}"].values - x.max("time").values
        smallest = x.min("time").values - found[f"smallest_{name}"].values
        for beyond in (largest, smallest):
            # tests/flow/test_records.py compares them with the curves between the samples; measured 8e-3
            assert np.all((beyond >= -1e-12) & (beyond < 0.02 * np.ptp(x.values))), name


@pytest.mark.slow
def test_averages_converge_with_the_steps():
    """Of three periods from Table 2's start, against 3200 steps, beside equal weights of the ends of steps."""
    names = ("rms_a_y", "rms_a_z", "rms_alpha_y", "contact_load", "drive_force")
    how = dict(grid={"speed": [1250.0, 1000.0, 2000.0]}, product=True, transient=0, periods=3, start=None)
    run = lambda record, steps, **more: swept(record, steps=steps, **how, **more)
    exact, errors = run(names, 3200), {}
    for steps in (50, 100, 200, 400):
        ends = run("history", steps, saves_per_period=steps)
        plain = {f"rms_{name}": np.sqrt((ends[name] ** 2).mean("time")) for name in ("a_y", "a_z", "alpha_y")}
        plain["contact_load"] = ends["contact_force"].sum(("end", "point")).mean("time")
        plain["drive_force"] = ends["drive_force"].mean("time")
        off = lambda found: [float(np.max(np.abs(found[name] / exact[name] - 1))) for name in names]
        errors[steps] = np.array([off(run(names, steps)), off(plain)])
        for text, row in zip(("curves", "equal weights"), errors[steps], strict=True):
            print(f"{steps} steps, {text}:", *(f"{name} {e:.1e}" for name, e in zip(names, row, strict=True)))
    assert np.all(errors[100][0] < 5e-4)  # measured 2.8e-4 at most
    assert np.all(errors[100][0] < 0.4 * errors[100][1])  # measured 0.22 to 0.02
    assert np.all(errors[400][0] < 2e-5)  # measured 6e-6


@pytest.mark.full
def test_sections_are_alike_alone_and_in_lists(reduced):
    exact = swept("sections", steps=SEVERAL, periods=10)
    one = swept(["rms", "sections"], steps=SEVERAL, periods=10)
    assert exact.sizes["strobe_period"] == 20  # with those of the transient
    for name in (*SECTIONS, "strobe", *(f"{name}_period" for name in SECTIONS)):
        # measured 3e-10: programs with other records are fused, and round, differently
        np.testing.assert_allclose(one[name].values[:4], exact[name].values[:4], rtol=1e-8, atol=1e-9)
    for name in SECTIONS:
        known = np.isfinite(exact[name].values).sum(-1)
        np.testing.assert_array_equal(known, exact[f"crossings_{name}"].values)
        np.testing.assert_allclose(reduced[name].values[0, : known[0]], exact[name].values[0, : known[0]], rtol=1e-8)


@pytest.mark.full
def test_motions_are_those_of_the_strobe_states(reduced):
    exact = attractors(reduced)
    np.testing.assert_array_equal(reduced["kind"].values, exact.kind)
    np.testing.assert_array_equal(reduced["period"].values, exact.period)
    assert reduced["kind"].values.tolist() == ["period"] + ["unresolved"] * 4
    assert load_call(reduced)["record"] == tuple(RECORD)
    with pytest.raises(ValueError, match=r"`periods` must be 16 or more to classify motions, 200 or .* but is 15"):
        swept(["rms", "motion"], periods=15)


@pytest.mark.parametrize("periods", [16, 64, 199])
def test_too_few_periods_to_tell_chaos_are_said_at_the_call(periods):
    """Before anything is compiled, once, and not where only periodic motions are asked for."""
    start = sj.table_2_start()
    grid = Grid(sj.paper_scene(), {"speed": [1250.0]})
    plan = lambda record, periods: make_plan(grid, start, Call(0, periods), *resolved_record(record))
    words = f"`periods` is {periods}: motions that are not periodic, chaos too, stay unresolved with fewer than 200"
    with pytest.warns(sj.ImplausibleWarning, match=words) as given:
        plan(["rms", "motion"], periods)
    assert len(given) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan("motion", 200)
        plan(MotionKind(periods), periods)
        plan("rms", periods)


@pytest.mark.slow
def test_batches_of_other_sizes_differ_by_rounding_only():
    """Alone in a batch of 8, one of 12 in a batch of 16, and in one of 128, as in a store."""
    grid = {"speed": np.linspace(900, 2000, 12)}
    record = ["strobe", "peak_force", "rms", "extremes"]
    several = swept(record, grid)
    for other in (swept(record, {"speed": grid["speed"][:3]}), swept(record, grid, chunk=128)):
        for name in other.data_vars:
            one, same = other[name].values, several[name].values[: other.sizes["case"]]
            # measured: 1e-13, which touchdowns and chaos multiply
            np.testing.assert_allclose(one, same, rtol=0, atol=1e-9 * np.abs(same).max(), err_msg=name)


def test_the_quick_label_of_motions_is_marked_as_quick():
    data, _ = MotionKind().label(sj.paper_scene(), ("case",), Motions(np.zeros(3, int), np.zeros(3, int)))
    assert data["kind"][1].tolist() == ["unresolved"] * 3
    assert "quick label" in data["kind"][2]["long_name"]
    assert "lyapunov_sweep" in data["kind"][2]["comment"]


@dataclass(frozen=True)
class LastHeight(AbstractStage):
    """The height after the recorded span, as a user may write it."""

    name = "last_height"

    def values(self, scene, periods):
        return 1

    def of_chunk(self, part, states, epoch, status, strobe):
        return states.motion.z, status

    def label(self, scene, dims, values):
        return {"last_height": column(dims, values, "m", "height after the record")}, {}


@pytest.mark.full
def test_stages_of_ones_own_run_after_the_records():
    ds = swept(["strobe", "motion", LastHeight()])
    assert ds.attrs["record"] == "strobe, motion, last_height"
    np.testing.assert_array_equal(ds["last_height"].values, ds["strobe"].values[:, -1, 1])


def number(function, name="odd"):
    return Record(Quantity(name, "1", "a number"), function)


def drive(course):
    return course.drive_force.mean


@pytest.mark.full
@pytest.mark.parametrize(
    ("record", "words"),
    [
        (["peak"], "`record` must be one of sections, strobe, history, motion, exponent, exponents, orbits, "),
        ([], "`record` must name at least one of sections, "),
        ([["rms"]], "but is ['rms']"),
        (["rms", Strobe(from_start=True), "strobe"], "must give each variable once, but gives `strobe` 2 times"),
        (number(drive, "status"), "`record` must not give `status`, a name which the dataset has"),
        (History(33), "`saves` must divide the 50 steps per period, but is 33"),
        (number(lambda c: (1.0, 1.0)), "the shape of `dims`, (), but gives float64[2]"),
        (number(lambda c: 1j * c.drive_force.mean), "`function` of `odd` must give real numbers"),
    ],
)
def test_bad_records_are_refused_before_anything_is_compiled(record, words):
    with pytest.raises(ValueError, match=r"^Argument ") as caught:
        swept(record, {"speed": [1250.0]}, start=None)
    assert words in str(caught.value)
    with pytest.raises(ValueError, match="`quantity` must have a name such as spring_force, but has 'a b'"):
        number(drive, "a b")
