"""Throughput over the batch on whatever JAX runs on."""

import functools
import sys
from types import SimpleNamespace

import jax
import pytest

from slipperjax.bench import rates
from slipperjax.bench.rates import ENGINES, Rate, kernels_per_step, rows, throughput
from slipperjax.model.dang2024 import paper_scene, table_2_start
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.run import CHUNK_OF_DEVICE, RunOptions, make_plan

from ..cli.commands import call

PROGRAM = """HloModule jit_run

%inner (p: (s64[], f64[8])) -> (s64[], f64[8]) {
  %p = (s64[], f64[8]) parameter(0)
  %a = f64[8]{0} fusion(%p), kind=kLoop, calls=%one
  %b = f64[8]{0} fusion(%a), kind=kLoop, calls=%two
  %c = f64[8]{0} reduce(%b, %zero), dimensions={0}, to_apply=%add
  ROOT %t = (s64[], f64[8]) tuple(%c, %b)
}

%outer (p: (s64[], f64[8])) -> (s64[], f64[8]) {
  %p = (s64[], f64[8]) parameter(0)
  %d = f64[8]{0} fusion(%p), kind=kLoop, calls=%one
  %e = f64[8]{0} fusion(%p), kind=kLoop, calls=%one
  %f = f64[8]{0} fusion(%p), kind=kLoop, calls=%one
  %g = f64[8]{0} fusion(%p), kind=kLoop, calls=%one
  ROOT %w = (s64[], f64[8]) while(%p), condition=%c1, body=%inner
}

ENTRY %main (x: f64[8]) -> f64[8] {
  %w = (s64[], f64[8]) while(%x), condition=%c2, body=%outer
  ROOT %y = f64[8]{0} get-tuple-element(%w), index=1
}
"""


def test_kernels_are_those_of_the_innermost_loop():
    assert kernels_per_step(PROGRAM) == 3
    assert kernels_per_step("ENTRY %main (x: f64[8]) -> f64[8] {\n}") is None


def test_rates_are_measured_and_tabled(monkeypatch):
    """Two calls of one small program, the only one that is compiled here."""
    monkeypatch.setattr(rates, "TIMING_SECONDS", 0.0)
    seen = []
    (rate,) = throughput([8], ["RK4"], report=seen.append)
    assert seen == [rate]
    assert rate.rate > 0
    assert rate.kernels > 10
    assert rate.share > 0
    assert rows([rate])[-1].startswith(f"| {rate.device} | RK4 | 8 |")


def test_a_rate_is_that_of_the_median_call(monkeypatch):
    """On two threads 100 cases are two chunks of 50; calls are repeated until they took a second."""
    clock, lanes = iter([0.0, 0.3, 1.0, 1.5, 2.0, 2.4]), []

    class Program:
        as_text = staticmethod(lambda: PROGRAM)

        def __call__(self):
            return 0.0

    def program(engine, count):
        lanes.append(count)
        return functools.partial(Program())

    monkeypatch.setattr(rates, "_program", program)
    monkeypatch.setattr(rates, "cores", lambda: 2)
    monkeypatch.setattr(rates, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    (rate,) = throughput([100], ["Rodas4"])
    assert lanes == [50]
    # calls of 0.3, 0.5 and 0.4 s over 4 periods each
    assert rate.rate == pytest.approx(100 * 4 / 0.4)
    # seven evaluations in each of 50 steps, 58 ns each at best, on two cores
    assert rate.share == pytest.approx(rate.rate * 50 * 7 * 58e-9 / 2)
    assert (rate.engine, rate.batch, rate.kernels) == ("Rodas4", 100, 3)
    on_gpu = Rate("a GPU", "Lyapunov", 100, 1234.5, None, None)
    assert rows([on_gpu])[-1] == "| a GPU | Lyapunov | 100 | 1.23e+03 |  |  |"


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="`engines` must be"):
        throughput([8], ["RK5"])
    with pytest.raises(ValueError, match="`batches` must be"):
        throughput([0])
    with pytest.raises(ValueError, match="`rates` must hold a rate"):
        rows([])
    assert set(ENGINES) == {"RK4", "Rodas4", "Lyapunov"}


def test_a_device_gets_large_chunks_on_one_thread(monkeypatch):
    scene = paper_scene()
    grid = Grid(scene, {"mass": [14.0] * 3000}, product=False)
    plan = make_plan(grid, table_2_start(), RunOptions(0, 1, 50))
    assert plan.chunks(None, 2)[1] == 2
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    chunks, threads = plan.chunks(None, 2)
    assert (len(chunks), threads) == (1, 1)
    assert len(chunks[0].index) <= CHUNK_OF_DEVICE


def of_backend(engine, batch):
    """A rate on what JAX runs on, which takes no time."""
    return Rate(jax.default_backend(), engine, batch, 1.0, 1, None)


def test_the_command_writes_its_table(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rates, "_timed", of_backend)
    out, _ = call(["throughput", "--batch", 8, "--engine", "RK4", "--out", tmp_path / "rates"], capsys)
    assert "| RK4 | 8 |" in out
    assert "| RK4 | 8 |" in (tmp_path / "rates.md").read_text()


def test_a_device_is_shown_beside_the_cpu(monkeypatch, capsys):
    """Rates of the CPU come from a process of its own, which here is this one."""

    def run(command, *, env, **_):
        assert command[:2] == [sys.executable, "-c"]
        monkeypatch.setattr(jax, "default_backend", lambda: env["JAX_PLATFORMS"])
        exec(command[2], {})
        return SimpleNamespace(stdout=capsys.readouterr().out)

    monkeypatch.setattr(rates, "_timed", of_backend)
    monkeypatch.setattr(rates.subprocess, "run", run)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    found = throughput([8, 16], ["RK4"])
    assert [rate[:3] for rate in found] == [(name, "RK4", n) for name in ("gpu", "cpu") for n in (8, 16)]
    assert all(isinstance(rate, Rate) for rate in found)
