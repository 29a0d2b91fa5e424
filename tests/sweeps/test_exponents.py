"""Exponents of slippers over a grid, each with its certificate."""

import functools

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.sweeps import exponents, reached
from slipperjax.sweeps.engine import Run
from slipperjax.sweeps.exponents import BLOCK, HOLD, MOTIONS, LongerMotions, LyapunovExponents

TWO = [1250.0, 2100.0]  # periodic and chaotic
LOST = 1e-3  # hours in 50 steps: thrown out of the finite numbers
SHORT = dict(transient=200, periods=60, steps_per_period=50)
NOT_RUN = int(Status.NOT_RUN)
pytestmark = pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # of the lost case, on purpose


def swept(speeds, **options):
    return sj.lyapunov_sweep(sj.paper_scene(), {"speed": speeds}, **SHORT | options)


def test_wrong_arguments_are_named():
    smooth = sj.paper_scene(memory=sj.model.SmoothSwitch())
    for make, words in (
        (lambda: swept([1250.0], count=0), "a whole number of 1 or more, but is 0"),
        (lambda: swept([1250.0], count=11), "at most 10, the dimension of the motion, but is 11"),
        (lambda: sj.lyapunov_spectrum(sj.paper_scene(), 99, transient=0, periods=1), "at most 10, .* but is 99"),
        (lambda: sj.lyapunov_spectrum(smooth, 31), "at most 30"),
    ):
        with pytest.raises(ValueError, match=f"Argument `count` must be {words}"):
            make()


@pytest.mark.full
@pytest.mark.parametrize("finished", [0, 1])
def test_an_interrupt_during_the_longer_motions_keeps_what_was_measured(monkeypatch, finished):
    def run_longer_motions(plan, chosen, states, epoch, counted, count, options):
        history = np.full((len(chosen), MOTIONS, 40, count), 0.5)
        status = np.array([0 if finished else NOT_RUN, NOT_RUN])
        return LongerMotions(chosen, history, np.zeros(len(chosen), int), status), True

    monkeypatch.setattr(exponents, "run_longer_motions", run_longer_motions)
    with pytest.raises(sj.Interrupted) as stop:
        swept([2100.0, 1250.0, 2100.0])
    found = stop.value.result
    assert (stop.value.finished, stop.value.of) == (1 + finished, 3)
    assert found["status"].values.tolist() == [0 if finished else NOT_RUN, 0, NOT_RUN]
    assert np.all(np.isfinite(found["exponent"]))
    assert str(found["regime"].values[2]) == "unresolved"
    assert not bool(found["resolved"].values[2])
    # no escape of four motions in HOLD and the measured periods: exp(-total / mean life) is 5 % there
    life = found["least_mean_life"].values
    assert np.isfinite(life).tolist() == [bool(finished), False, False]
    if finished:
        total = MOTIONS * (HOLD + float(found.attrs["measured"]) + BLOCK)
        np.testing.assert_allclose(np.exp(-total / life[0]), 0.05, rtol=1e-12)
        assert found["regime"].attrs["chaotic"] == f"chaotic (mean life {life[0]:.0f} periods or more)"


@pytest.fixture(scope="module")
def both_ways():
    return swept([*TWO, LOST]), swept([*TWO, LOST], orbits=False)


@pytest.mark.full
def test_periodic_cases_get_the_exponents_of_their_orbits_and_others_are_measured_to_the_same_bits(both_ways):
    by_orbit, measured = (ds.isel(speed=0) for ds in both_ways)
    assert (bool(by_orbit["by_orbit"]), bool(measured["by_orbit"])) == (True, False)
    exponent = float(by_orbit["exponent"][0])
    for name in ("weighted_exponent", "floquet"):
        np.testing.assert_array_equal(by_orbit[name], exponent)
    assert (float(by_orbit["stderr"][0]), float(by_orbit["half_step_stderr"])) == (0.0, 0.0)
    # the motion is not on its orbit yet
    np.testing.assert_allclose(measured["floquet"], exponent, atol=2e-5)
    # measured: floquet -0.0465, half the step -0.0467
    np.testing.assert_allclose(measured["weighted_exponent"], measured["floquet"], atol=1e-3)
    for ds in (by_orbit, measured):
        np.testing.assert_allclose(ds["half_step"], ds["exponent"][0], atol=1e-3)
        assert (bool(ds["resolved"]), str(ds["regime"].values), int(ds["status"])) == (True, "periodic", 0)
        assert (str(ds["kind"].values), int(ds["period"])) == ("period", 1)
    others, measured = (ds.isel(speed=[1, 2]) for ds in both_ways)
    assert not others["by_orbit"].any()
    for name in measured.data_vars:
        np.testing.assert_array_equal(others[name], measured[name], err_msg=name)
    lost = measured.isel(speed=1)
    assert (int(lost["status"]), bool(lost["resolved"])) == (Status.NOT_FINITE, False)
    assert str(lost["regime"].values) == str(lost["kind"].values) == "unresolved"


@pytest.mark.full
def test_exponents_and_orbits_are_records_like_others(both_ways):
    options = dict(record=[LyapunovExponents(periods=60), "orbits"], transient=200, steps_per_period=50)
    ds = sj.sweep(sj.paper_scene(), {"speed": [*TWO, LOST]}, **options)
    for name in set(both_ways[0].data_vars) - {"status"}:
        np.testing.assert_array_equal(ds[name], both_ways[0][name], err_msg=name)
    np.testing.assert_allclose(ds["orbit_exponent"][0], ds["exponent"][0, 0], rtol=1e-9)
    assert ds["stable"].values.tolist()[0]
    with pytest.raises(ValueError, match="must not run on where cases follow one another"):
        sj.follow(sj.paper_scene(), {"speed": [1000.0, 1100.0]}, record="exponents")
    with pytest.raises(ValueError, match="must give each variable once, but gives `kind` 2 times"):
        sj.sweep(sj.paper_scene(), {"speed": TWO}, record=["motion", "exponents"], periods=20)


SPOILT = {
    "unstable": lambda found: found._replace(multipliers=found.multipliers * 100),
    "missing": lambda found: found._replace(status=np.full_like(found.status, Status.NO_ORBIT)),
    "elsewhere": lambda found: found._replace(state=jax.tree.map(lambda a: a + 0.1, found.state)),
    "growing": lambda found: found._replace(growth=found.growth + 100.0),
}


@pytest.mark.full
@pytest.mark.parametrize("finer", [False, True])
def test_without_a_stable_orbit_nearby_a_case_is_measured(monkeypatch, both_ways, finer):
    """Of one motion in several lanes, whose orbits are each spoilt in another way."""
    whole = reached.find_orbits

    def find_orbits(maps, states, **options):
        found = whole(maps, states, **options)
        if (maps.steps == 100) == finer:
            for lane, spoil in enumerate(SPOILT.values()):
                put = lambda good, bad, lane=lane: np.concatenate([good[:lane], bad[lane:][:1], good[lane + 1 :]])
                found = jax.tree.map(put, jax.tree.map(np.asarray, found), jax.tree.map(np.asarray, spoil(found)))
        return found

    monkeypatch.setattr(reached, "find_orbits", find_orbits)
    found = swept(TWO[:1] * (len(SPOILT) + 1), product=False, chunk=8)
    assert found["by_orbit"].values.tolist() == [False] * len(SPOILT) + [True]
    measured = both_ways[1].isel(speed=0)
    for lane, how in enumerate(SPOILT):
        for name in found.data_vars:
            np.testing.assert_array_equal(found[name][lane], measured[name], err_msg=f"{how}: {name}")


@pytest.mark.full
def test_a_motion_on_a_stable_orbit_that_presses_a_point_in_is_marked(monkeypatch):
    pressed = lambda maps, index, *given: np.full(len(index), int(Status.PRESSED_IN))
    monkeypatch.setattr("slipperjax.sweeps.orbits.Maps.contact_status", pressed)
    found = swept(TWO[:1])
    assert found["status"].values.tolist() == [Status.PRESSED_IN]
    assert not found["by_orbit"].any()
    assert not found["resolved"].any()
    assert found["kind"].values.tolist() == found["regime"].values.tolist() == ["unresolved"]


@pytest.mark.full
def test_an_interrupt_of_the_measurement_keeps_the_orbits(monkeypatch):
    monkeypatch.setattr(exponents, "run_cases", lambda plan, work, **options: Run(None, plan.cases.count, True))
    with pytest.raises(sj.Interrupted) as stop:
        swept(TWO)
    found = stop.value.result
    assert (stop.value.finished, stop.value.of) == (1, 2)
    assert found["status"].values.tolist() == [Status.FINITE, NOT_RUN]
    assert found["regime"].values.tolist() == ["periodic", "unresolved"]
    assert np.isfinite(found["exponent"].values[:, 0]).tolist() == [True, False]


CASES = dict(  # of periods 1, 2, 3, 1, 1, 1, 1, 1, 1, 1
    speed=[960.0, 1080.0, 1000.0, 1100.0, 1250.0, 1500.0, 1800.0, 1250.0, 1250.0, 1250.0],
    clearance=[1e-3] * 7 + [0.5e-3, 2e-3, 1e-3],
    length=[0.2] * 9 + [0.3],
)


def flat_map(scene, unravel, periods, x):
    end = sj.period_map(scene, unravel(x), periods=periods, steps_per_period=100)
    return jax.flatten_util.ravel_pytree(end)[0]


@pytest.mark.slow
def test_exponents_of_orbits_are_exact():
    """To 1e-8, against eigenvalues of the derivative of several composed periods; measured: see the printed table."""
    options = dict(product=False, transient=600, steps_per_period=100, count=3)
    found = sj.lyapunov_sweep(sj.paper_scene(), CASES, **options)
    measured = sj.lyapunov_sweep(sj.paper_scene(), CASES, orbits=False, periods=2000, **options)
    assert found["by_orbit"].all()
    assert found["resolved"].all()
    np.testing.assert_array_equal(found["period"], measured["period"])
    print("\nspeed, clearance, length, period: by orbit; with half the step; minus JVP; minus weighted mean")
    for k in range(len(CASES["speed"])):
        case, weighted = found.isel(case=k), measured["weighted_exponent"].values[k, 0]
        where = {name: values[k] for name, values in CASES.items()}
        scene, n = sj.paper_scene(**where), int(case["period"])
        start = sj.simulate(scene, 3000, steps_per_period=100, saves_per_period=1, loads=False).end
        state, unravel = jax.flatten_util.ravel_pytree(start)
        mapped = functools.partial(flat_map, scene, unravel, n)
        mu = np.linalg.eigvals(np.asarray(jax.jacfwd(mapped)(state)))
        exact = np.sort(np.log(np.abs(mu[np.abs(mu) > 1e-12])) / n)[::-1][:3]
        exponent = case["exponent"].values
        print(
            f"{where} {n}: {exponent[0]:.9f}; {float(case['half_step']):.9f}; "
            f"{np.max(np.abs(exponent - exact)):.1e}; {weighted - exponent[0]:.1e}"
        )
        np.testing.assert_allclose(exponent, exact, atol=1e-8)
        np.testing.assert_allclose(exponent[0], weighted, atol=1e-4)
