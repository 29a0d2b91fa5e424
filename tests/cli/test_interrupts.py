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
from slipperjax.cli import main
from slipperjax.cli.interrupts import Signals, on_thread
from slipperjax.flow.status import Status
from slipperjax.model.quantities import SECTIONS

COMMAND = [sys.executable, "-c", "from slipperjax.cli import main; main()"]
SMALL = ["bifurcation", "--over", "speed", "1000", "2500", "48", "--transient", "2000", "--steps-per-period", "50"]


@pytest.fixture
def begin(tmp_path):
    """Begins a command whose files go into the folder `out`, and ends it in any case."""
    (tmp_path / "out").mkdir()
    made = []

    def start(*arguments):
        out = ["--out", str(tmp_path / "out" / "run")]
        pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        before = signal.signal(signal.SIGINT, signal.default_int_handler)  # what is ignored is inherited
        made.append(subprocess.Popen([*COMMAND, *arguments, *out], text=True, **pipes))
        signal.signal(signal.SIGINT, before)
        return made[0]

    yield start
    for process in made:
        process.kill()
        process.communicate()


def wait_for(process, words):
    """Reads standard error up to a line with these words."""
    for line in process.stderr:
        if words in line:
            return
    raise AssertionError(f"{words!r} was not printed")


def catches(process, number):
    """Whether a process has a handler of a signal."""
    with open(f"/proc/{process.pid}/status") as lines:
        caught = next(line for line in lines if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


def ended(process, number, seconds=10.0):
    """Sends a signal, and gives what is printed after it; the wait is generous because test machines are busy."""
    process.send_signal(number)
    before = time.perf_counter()
    out, error = process.communicate(timeout=60)
    assert time.perf_counter() - before < seconds
    assert process.returncode == 128 + number, error
    assert error.endswith("interrupted\n")
    assert "Traceback" not in out + error
    return out, error


def test_a_signal_while_it_compiles_leaves_the_old_files(begin, tmp_path):
    old = tmp_path / "out" / "run.nc"
    old.write_bytes(b"old")
    process = begin(*SMALL)
    wait_for(process, "run.nc will be replaced")
    time.sleep(1.0)
    _, error = ended(process, signal.SIGTERM)
    assert "cases were finished: nothing is written" in error
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["run.nc"]
    assert old.read_bytes() == b"old"


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [8.0, 12.0, 16.0, 20.0, 30.0])
def test_a_signal_at_any_time(begin, tmp_path, seconds):
    process = begin("bifurcation", "--over", "speed", "100", "2500", "64", "--transient", "40000")
    time.sleep(seconds)
    _, error = ended(process, signal.SIGINT)
    kept = tmp_path / "out" / "run_partial.nc"
    assert kept.exists() == ("cases were finished" in error)
    if kept.exists():
        with xr.open_dataset(kept, engine="h5netcdf") as ds:
            assert set(np.unique(ds["status"].values)) <= {0, int(Status.NOT_RUN)}


# inside the process


def partial():
    """Three of four cases of a sweep."""
    values = np.where(np.arange(4) < 3, 1.0, np.nan)
    data = {name: (("speed", "crossing"), np.stack([values, values], axis=1)) for name in SECTIONS}
    data |= {"status": ("speed", [0, 0, 0, int(Status.NOT_RUN)]), "steps_per_period": ("speed", [50] * 4)}
    return xr.Dataset(data, {"speed": [1e3, 1.1e3, 1.2e3, 1.3e3]}, {"transient": 2})


def test_finished_cases_get_a_name_of_their_own(monkeypatch, tmp_path, capsys):
    found = partial()

    def sweep(*arguments, **options):
        raise sj.Interrupted(found, 3, 4)

    monkeypatch.setattr("slipperjax.sweeps.sweep.sweep", sweep)
    (tmp_path / "fig.nc").write_bytes(b"old")
    with pytest.raises(SystemExit) as stopped:
        main(["bifurcation", "--over", "speed", "1000", "1300", "4", "--out", str(tmp_path / "fig.nc")])
    assert stopped.value.code == 130
    new = f"{tmp_path / 'fig_partial.nc'} and {tmp_path / 'fig_partial.png'}"
    assert capsys.readouterr().err == (
        f"{tmp_path / 'fig.nc'} will be replaced\n3 of 4 cases were finished: wrote {new}\ninterrupted\n"
    )
    assert (tmp_path / "fig.nc").read_bytes() == b"old"
    with xr.open_dataset(tmp_path / "fig_partial.nc", engine="h5netcdf") as ds:
        assert ds["status"].values.tolist() == [0, 0, 0, 7]


def test_a_known_ending_is_not_repeated_and_replacing_is_said(monkeypatch, tmp_path, capsys):
    found = partial()
    monkeypatch.setattr("slipperjax.sweeps.sweep.sweep", lambda *arguments, **options: found)
    for verb, ending in (("wrote", ".nc"), ("replaced", ".png")):
        with pytest.raises(SystemExit) as stopped:
            main(["bifurcation", "--over", "speed", "1000", "1300", "4", "--out", str(tmp_path / f"fig{ending}")])
        assert stopped.value.code == 0
        assert f"{verb} {tmp_path / 'fig.nc'} and {tmp_path / 'fig.png'}\n" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig.nc", "fig.png"]


def test_a_file_that_is_open_elsewhere_is_replaced(monkeypatch, tmp_path):
    found = partial()
    monkeypatch.setattr("slipperjax.sweeps.sweep.sweep", lambda *arguments, **options: found)
    arguments = ["bifurcation", "--over", "speed", "1000", "1300", "4", "--out", str(tmp_path / "fig")]
    found.assign_attrs(transient=5).to_netcdf(tmp_path / "fig.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "fig.nc", engine="h5netcdf") as held:
        with pytest.raises(SystemExit):
            main(arguments)
        assert np.all(np.isfinite(held["v_y"].values[0]))  # what is held can still be read
    with xr.open_dataset(tmp_path / "fig.nc", engine="h5netcdf") as new:
        assert new.attrs["transient"] == 2


def test_a_folder_in_the_way_is_found_before_anything_runs(tmp_path, capsys):
    (tmp_path / "fig.png").mkdir()
    with pytest.raises(SystemExit) as stopped:
        main(["bifurcation", "--over", "speed", "1000", "1300", "4", "--out", str(tmp_path / "fig")])
    assert stopped.value.code == 2
    assert f"{tmp_path / 'fig.png'} is a folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["bifurcation", "--over", "speed", "100", "2500", "1000000000"],
        ["lyapunov", "--over", "speed", "100", "2500", "100000", "--by", "clearance", "1", "2", "100000"],
        ["simulate", "--periods", "1000000000000"],
    ],
)
def test_impossible_counts_are_one_line(arguments, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--out", str(tmp_path / "run")])
    assert stopped.value.code == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("error: ")
    assert "of memory and" in last
    assert last.endswith("are available.")


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

    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with Signals() as signals, pytest.raises(KeyboardInterrupt):
            go()
        assert signals.code == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_calls_on_a_thread_give_what_they_give():
    assert on_thread(lambda: 3) == 3
    with pytest.raises(ValueError, match="seen"):
        on_thread(lambda: (_ for _ in ()).throw(ValueError("seen")))
