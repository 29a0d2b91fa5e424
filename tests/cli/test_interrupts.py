"""Signals from outside, and what a command leaves behind."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli.interrupts import Signals
from slipperjax.flow.status import Status
from slipperjax.model.quantities import SECTIONS

from .commands import call, dataset, error_of, names

COMMAND = [sys.executable, "-c", "from slipperjax.cli import main; main()"]
INSTALLED = [sys.executable, "-c", "import slipperjax_command as entry; print(flush=True); entry.main()"]
SMALL = ["bifurcation", "--over", "speed", "1000", "2500", "48", "--transient", "2000", "--steps-per-period", "50"]
FOUR = ["bifurcation", "--over", "speed", 1000, 1300, 4, "--out"]


@pytest.fixture
def begin(tmp_path, python_s_own_interrupts):
    """Begins a command whose files go into the folder `out`, and ends it in any case."""
    (tmp_path / "out").mkdir()
    made = []

    def start(*arguments):
        command = [*COMMAND, *arguments, "--out", str(tmp_path / "out" / "run")]
        made.append(subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE))
        return made[0]

    yield start
    for process in made:
        process.kill()
        process.communicate()


def ended(process, number, seconds=10.0):
    """Sends a signal, and gives what is printed after it; the wait is generous because test machines are busy."""
    process.send_signal(number)
    before = time.perf_counter()
    out, error = process.communicate(timeout=60)
    assert time.perf_counter() - before < seconds
    assert process.returncode == 128 + number, error
    assert error.endswith("interrupted\n")
    assert "Traceback" not in out + error
    return error


@pytest.mark.full
def test_a_signal_while_it_compiles_leaves_the_old_files(begin, tmp_path):
    old = tmp_path / "out" / "run.nc"
    old.write_bytes(b"old")
    process = begin(*SMALL)
    assert any("run.nc will be replaced" in line for line in process.stderr)
    time.sleep(1.0)
    assert "cases were finished: nothing is written" in ended(process, signal.SIGTERM)
    assert names(tmp_path / "out") == ["run.nc"]
    assert old.read_bytes() == b"old"


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [8.0, 16.0, 30.0])
def test_a_signal_at_any_time(begin, tmp_path, seconds):
    process = begin("bifurcation", "--over", "speed", "100", "2500", "64", "--transient", "40000")
    time.sleep(seconds)
    error = ended(process, signal.SIGINT)
    kept = tmp_path / "out" / "run_partial.nc"
    assert kept.exists() == ("nothing is written" not in error)
    if kept.exists():
        assert set(dataset(kept.with_suffix(""))["status"].values.tolist()) <= {0, int(Status.NOT_RUN)}


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_an_interrupt_while_packages_are_imported_is_silent():
    pipes = dict(text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    made = [subprocess.Popen([*INSTALLED, "--help"], **pipes) for _ in range(3)]
    for process in made:
        assert process.stdout.readline() == "\n"
    for process in made:
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
    assert [(*process.communicate(timeout=60), process.returncode) for process in made] == [("", "", 130)] * 3


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_what_is_ignored_stays_ignored_while_packages_are_imported():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as processes that are started now have it, too
    with subprocess.Popen([*INSTALLED, "--help"], text=True, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == "\n"
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        assert "Commands:" in process.communicate(timeout=60)[0]


# inside the process


@pytest.fixture
def partial():
    """Three of four cases of a sweep."""
    values = np.where(np.arange(4) < 3, 1.0, np.nan)
    data = {name: (("speed", "crossing"), np.stack([values, values], axis=1)) for name in SECTIONS}
    data |= {"status": ("speed", [0, 0, 0, int(Status.NOT_RUN)]), "steps_per_period": ("speed", [50] * 4)}
    attrs = {"transient": 2, "call": '{"function": "sweep"}'}
    return sj.Result(xr.Dataset(data, {"speed": [1e3, 1.1e3, 1.2e3, 1.3e3]}, attrs))


def test_finished_cases_get_a_name_of_their_own(partial, replaced, tmp_path, capsys):
    replaced("sweeps.sweep.sweep", side_effect=sj.Interrupted(partial, 3, 4))
    fig = tmp_path / "fig"
    (tmp_path / "fig.nc").write_bytes(b"old")
    _, error = call([*FOUR, fig], capsys, 130)
    kept = f"3 of 4 cases were finished: wrote {fig}_partial.nc and {fig}_partial.png"
    assert error == f"{fig}.nc will be replaced\n{kept}\ninterrupted\n"
    assert (tmp_path / "fig.nc").read_bytes() == b"old"
    assert dataset(f"{fig}_partial")["status"].values.tolist() == [0, 0, 0, 7]


@pytest.mark.full
def test_files_are_replaced_even_where_they_are_open(partial, replaced, tmp_path, capsys):
    replaced("sweeps.sweep.sweep", return_value=partial)
    fig = tmp_path / "fig"
    assert f"wrote {fig}.nc and {fig}.png\n" in call([*FOUR, fig], capsys)[0]
    assert f"wrote {fig}.pdf\n" in call([*FOUR, f"{fig}.pdf"], capsys)[0]
    assert names(tmp_path) == ["fig.nc", "fig.pdf", "fig.png"]
    partial.attrs["transient"] = 5
    with xr.open_dataset(f"{fig}.nc", engine="h5netcdf") as held:
        call([*FOUR, fig], capsys)
        assert np.all(np.isfinite(held["v_y"].values[0]))  # what is held can still be read
    assert dataset(fig).attrs["transient"] == 5


def test_a_folder_in_the_way_is_found_before_anything_runs(tmp_path, capsys):
    (tmp_path / "fig.png").mkdir()
    assert f"{tmp_path / 'fig.png'} is a folder" in error_of([*FOUR, tmp_path / "fig"], capsys)


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_an_interrupt_that_falls_into_a_callback_is_delivered_again():
    class Dropped:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):  # the handler runs here, where nothing can be raised
                pass

    def go():
        dropped = Dropped()
        del dropped
        for _ in range(100):
            time.sleep(0.01)

    with Signals() as signals, pytest.raises(KeyboardInterrupt):
        go()
    assert signals.code == 130
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
