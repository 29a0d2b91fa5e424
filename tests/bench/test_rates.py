"""Throughput over the batch on whatever JAX runs on."""

from types import SimpleNamespace

import jax
import pytest

from slipperjax.flow.record import RecordSet
from slipperjax.model.dang2024 import paper_scene, table_2_start
from slipperjax.sweeps.call import Call, make_plan
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.plan import CHUNK_OF_DEVICE

from . import rates
from .__main__ import main
from .rates import Rate, rows, throughput, timed


@pytest.mark.full
def test_rates_are_measured_and_tabled():
    """Two calls of one small program, the only one that is compiled here."""
    rate = timed("RK4", 8, least=0.0)
    assert rate.rate > 0
    assert rows([rate])[-1].startswith(f"| {rate.device} | RK4 | 8 |")


def test_a_rate_is_that_of_the_median_call(monkeypatch):
    """On two threads 100 cases are two chunks of 50; calls are repeated until they took a second."""
    clock, lanes = iter([0.0, 0.3, 1.0, 1.5, 2.0, 2.4]), []

    def program(engine, count):
        lanes.append(count)
        return lambda: 0.0

    monkeypatch.setattr(rates, "program", program)
    monkeypatch.setattr(rates, "cores", lambda: 2)
    monkeypatch.setattr(rates, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    (rate,) = throughput([100], ["Rodas4"])
    assert lanes == [50]
    # calls of 0.3, 0.5 and 0.4 s over 4 periods each
    assert rate.rate == pytest.approx(100 * 4 / 0.4)
    assert (rate.engine, rate.batch) == ("Rodas4", 100)


@pytest.mark.parametrize(("batches", "engines", "name"), [([8], ["RK5"], "engines"), ([0], ["RK4"], "batches")])
def test_wrong_arguments_are_named(batches, engines, name):
    with pytest.raises(ValueError, match=f"`{name}` must be"):
        list(throughput(batches, engines))


def test_a_device_gets_large_chunks_on_one_thread(monkeypatch):
    scene = paper_scene()
    grid = Grid(scene, {"mass": [14.0] * 3000}, product=False)
    plan = make_plan(grid, table_2_start(), Call(0, 1, steps_per_period=50), RecordSet())
    assert plan.chunks(None, 2)[1] == 2
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    chunks, threads = plan.chunks(None, 2)
    assert (len(chunks), threads) == (1, 1)
    assert len(chunks[0].index) <= CHUNK_OF_DEVICE


def test_the_command_writes_its_table(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rates, "timed", lambda engine, batch: Rate("a device", engine, batch, 1234.5))
    main(["throughput", "--batch", "8", "--engine", "RK4", "--out", str(tmp_path / "rates")])
    assert "| a device | RK4 | 8 | 1.23e+03 |" in capsys.readouterr().out
    assert "| RK4 | 8 |" in (tmp_path / "rates.md").read_text()
