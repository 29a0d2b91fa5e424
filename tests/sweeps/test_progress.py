"""What is shown of a run while one waits for it."""

import io
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest

import slipperjax as sj
from slipperjax.sweeps.progress import Bar, Later, Lines, Silent, Tally, display


@pytest.fixture
def clock():
    """Seconds as they are set."""
    return SimpleNamespace(now=0.0)


def tally(clock, **options):
    return Tally(100.0, 10, 2, clock=lambda: clock.now, **options)


@pytest.fixture
def run(clock):
    found = tally(clock)
    yield found
    found.end()


def test_the_estimate_does_not_know_how_long_compiling_took(clock, run):
    assert run.state == "starting"
    run.begin()
    jax.jit(lambda x: x * 1.25 + 1.0)(jnp.ones(7))  # a new program, on this thread
    clock.now = 1000.0
    run.add(10.0)
    assert run.duration(1.0) is None
    clock.now = 1020.0
    run.add(10.0)
    assert run.duration(80.0) == pytest.approx(80.0)  # 2 s for each on one of two threads
    clock.now = 1500.0
    run.add(0.0)  # a call begins: what came before was no work
    clock.now = 1520.0
    run.add(10.0)
    assert run.duration(80.0) == pytest.approx(80.0)
    assert run.text() == "0 of 10 cases, 25 min 20 s spent, about 1 min 10 s left"
    run.end(10)
    assert run.text() == "10 of 10 cases, 25 min 20 s spent"


def test_compiling_is_told_from_computing(run):
    states = []
    run.begin()

    @sj.jit
    def program(x):
        states.append(run.state)  # while it is made
        return x + 1.5

    program(jnp.ones(5))
    assert states == ["compiling"]
    assert run.state == "compiling"  # until the end of the program's first call
    run.add(1.0)
    assert run.state == "computing"
    program(jnp.ones(5))
    assert states == ["compiling"]


def test_calls_beside_a_compilation_do_not_count_for_the_estimate(clock, run):
    """Other threads wait for the program, too."""
    with ThreadPoolExecutor(1) as pool:
        beside = lambda *call: pool.submit(*call).result()
        beside(run.begin)
        run.begin()
        sj.jit(lambda x: x - 0.5)(jnp.ones(5))
        assert run.state == "compiling"
        clock.now = 100.0
        beside(run.add, 1.0)  # under way before
        clock.now = 110.0
        beside(run.add, 1.0)  # begun meanwhile
        assert run.duration(1.0) is None
        run.add(1.0)
        beside(run.add, 0.0)
        assert run.state == "computing"
        clock.now = 112.0
        beside(run.add, 1.0)
        assert run.duration(1.0) == pytest.approx(1.0)
        beside(run.end)


def test_what_may_follow_is_named(clock):
    run = tally(clock, name="exponents", later=Later(500.0, "for chaotic cases"))
    run.begin()
    clock.now = 4.0
    run.add(2.0)
    assert run.label == "exponents, computing"
    assert run.text().endswith("about 1 min 38 s left, then up to 8 min 20 s for chaotic cases")
    run.end()


def test_pipes_get_a_line_now_and_then(clock, run):
    stream = io.StringIO()
    shown = display(run, True, stream)
    assert isinstance(shown, Lines)
    run.begin()
    for second in range(200):
        clock.now = float(second)
        if second < 100:
            run.add(1.0)
        shown.show()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "computing: 6%, 0 of 10 cases, 5 s spent, about 39 s left"
    shares = [int(line.split()[1].rstrip("%,")) for line in lines]
    assert shares == sorted(shares)
    assert len([share for share in shares if share < 100]) in range(9, 12)  # about one for each tenth
    assert shares.count(100) in (3, 4)  # and one each thirty seconds after


def test_terminals_get_a_bar_and_nothing_is_shown_unless_it_is_wanted(clock, run):
    stream = io.StringIO()
    stream.isatty = lambda: True
    with display(run, False, stream) as shown:
        shown.show()
    assert isinstance(display(run, False, stream), Silent)
    assert stream.getvalue() == ""
    shown = display(run, True, stream)
    assert isinstance(shown, Bar)
    run.begin()
    clock.now = 2.0
    run.add(50.0)
    with shown:
        shown.show()
        assert "computing:  50%|" in stream.getvalue()
        run.add(60.0)  # more than all
    assert "computing: 100%|" in stream.getvalue()
