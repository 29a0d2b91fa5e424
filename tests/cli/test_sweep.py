"""`slipperjax sweep` and `slipperjax store`: grids, samples, shares, and what they print."""

import os
import shutil
import signal
import subprocess
import sys

import matplotlib.image
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli import main
from slipperjax.flow.status import ASKED
from slipperjax.results.cases import summary
from slipperjax.sweeps.store import Archive

from .commands import TEN, call, error_of

MAP = ["--over", "speed", 1000, 1600, 5, "--by", "start_v_y", 0.4, 0.5, 4, *TEN]


@pytest.fixture(scope="module", autouse=True)
def _small_batches():
    """Eight lanes instead of 128 in each call: the program of `slipperjax bifurcation` in test_cli."""
    with pytest.MonkeyPatch.context() as patch:
        for room in ("store", "explain"):
            patch.setattr(f"slipperjax.sweeps.{room}.largest_chunk", lambda scene: 8)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stores")


@pytest.fixture(scope="module")
def stored(folder):
    """A map of 5 speeds and 4 starts in tiles of 8 cases."""
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in ("sweep", *MAP, "--store", folder / "map.zarr", "--tile", 8)])
    assert stopped.value.code == 0
    return folder / "map.zarr"


def test_a_map_is_stored_and_drawn(stored, capsys):
    ds = sj.load(stored)
    assert dict(ds["status"].sizes) == {"speed": 5, "start_v_y": 4}
    assert ds["start_v_y"].values == pytest.approx(np.linspace(0.4, 0.5, 4))
    assert matplotlib.image.imread(stored.with_suffix(".png")).shape[0] > 500
    out, error = call(["sweep", *MAP, "--store", stored], capsys)  # nothing is left to do, in tiles as they are
    assert "20 cases, 10 + 10 periods, 100 steps per period" in out
    assert "0 cases flagged" in out
    assert "map.png will be replaced" in error


def test_stores_are_looked_after(stored, folder, capsys):
    assert call(["store", "status", stored], capsys)[0].startswith("20 of 20 cases (100.0%), 3 of 3 tiles, ")
    assert call(["store", "check", stored], capsys)[0].startswith("damaged tiles: none; 20 of 20")
    copy, drawn = folder / "copy.zarr", folder / "p.png"
    shutil.copytree(stored, copy)
    damaged = copy / "status" / "c" / "0" / "0"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:9])
    error = error_of(["store", "draw", copy, "--out", drawn], capsys)
    assert f"{copy} is damaged, see `slipperjax store check {copy}`: " in error
    plt.close("all")  # as the end of the command's process does
    damaged.write_bytes(whole)
    (copy / "v_z" / "c" / "1" / "0" / "0").write_bytes(b"nothing")
    assert call(["store", "check", copy], capsys, 1)[0].startswith("damaged tiles: [1]; 12 of 20")
    out, _ = call(["store", "draw", copy, "--show", "penetration", "--out", drawn], capsys)
    assert f"wrote {drawn}" in out
    assert "must be a store of slipperjax" in error_of(["store", "status", folder / "none.zarr"], capsys)


def test_a_sample_needs_no_store(replaced, folder, capsys):
    sweep = replaced("sweeps.sweep.sweep", side_effect=ValueError("seen"))
    box = ["--over", "speed", 900, 1000, 1, "--by", "clearance", 0.5, 2, 1, "--log", "clearance"]
    assert error_of(["sweep", *box, "--sample", 16, "--out", folder / "box.nc"], capsys) == "error: seen\n"
    grid, options = sweep.call_args.args[1], sweep.call_args.kwargs
    assert (options["product"], "store" in options) == (False, False)
    speed, clearance = np.asarray(grid["speed"]), np.asarray(grid["clearance"])
    assert speed.shape == clearance.shape == (16,)
    assert np.all((clearance > 0.5e-3) & (clearance < 2e-3) & (speed > 900) & (speed < 1000))
    assert 6 <= int((clearance < 1e-3).sum()) <= 10  # spread by ratios


def test_an_estimate_writes_nothing(folder, capsys):
    out, _ = call(["sweep", *MAP, "--store", folder / "none.zarr", "--explain"], capsys)
    assert out.startswith("20 cases in 1 tiles of 20 (5 x 4)")
    assert not (folder / "none.zarr").exists()


def test_wrong_options_are_named(stored, folder, capsys):
    new = [*MAP, "--store", folder / "new.zarr"]
    for more, words in (
        ([*MAP, "--share", "1/2"], "Option --share must come with --store"),
        ([*new, "--share", "3/2"], "`share` must be (i, n) with i from 1 to n"),
        ([*new, "--share", "1/2", "--fresh"], "`fresh` must be False for a share"),
        ([*MAP, "--store", folder / "new.nc"], "ends in .zarr"),
        ([*new, "--record", "exponents", "--record", "motion"], "each variable once, but gives `kind` 2 times"),
        ([*new, "--processes", 2, "--cluster", "tcp://a"], "--cluster must not be given with --processes"),
        ([*TEN], "Missing option '--over'"),
    ):
        assert words in error_of(["sweep", *more], capsys)
    _, error = call(["sweep", *MAP, "--restitution", 0.5, "--store", stored], capsys, 2)
    assert "restitution: 0.9 in the store, 0.5 asked" in error
    assert not (folder / "new.zarr").exists()


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_ctrl_c_says_that_the_same_command_goes_on(folder, monkeypatch, capsys):
    write, first = Archive.write, iter([True])

    def interrupted(self, number, ds):
        write(self, number, ds)
        if next(first, False):
            os.kill(os.getpid(), signal.SIGINT)
        ASKED.wait(10)

    monkeypatch.setattr(Archive, "write", interrupted)
    words = ["--over", "speed", 1000, 1600, 64, *TEN, "--store", folder / "c.zarr", "--tile", 8]
    _, error = call(["sweep", *words], capsys, 130)
    assert " of 64 cases were finished: kept in" in error
    assert "the same command goes on" in error
    assert 0 < int((sj.load(folder / "c.zarr")["status"] == 0).sum()) < 64


def test_chaos_stands_with_its_least_mean_life_in_a_line():
    regimes, life = ["periodic", "chaotic", "chaotic"], [np.nan, 3400.0, 3365.1]
    data = {"regime": ("speed", regimes), "status": ("speed", [0] * 3), "steps_per_period": ("speed", [50] * 3)}
    ds = xr.Dataset(data)
    told = "1 periodic, 0 regular, 2 chaotic{}, 0 unresolved, 0 transient chaos"
    assert told.format("") in "; ".join(summary(ds))
    with_life = told.format(" (mean life 3365 periods or more)")
    assert with_life in "; ".join(summary(ds.assign(least_mean_life=("speed", life))))
    # the error of a case that is lost says nothing, and statuses come before all numbers
    part = ds.drop_vars("regime").assign(status=("speed", [0, 4, 6]), probe_error=("speed", [0.01, 7e5, 0.2]))
    words = "; ".join(summary(part))
    assert words.endswith("; half the step changes the motion by 2.0e-01 scales at most")
    assert "; 2 cases flagged (1 pressed in: " in words
    assert told.format("") in "; ".join(summary(ds.assign(least_mean_life=("speed", [np.nan] * 3))))


DASK = """
import importlib.util, sys
import slipperjax.cli.sweep as sweep
sweep.hide_dask()
import numpy as np, xarray as xr
xr.Dataset({"a": ("x", np.zeros(3))}, {"x": np.arange(3)}).to_netcdf(engine="h5netcdf")
print([name for name in sys.modules if name.startswith(("dask.", "distributed"))], sys.modules["dask"])
sweep._show_dask()
print(importlib.util.find_spec("dask") is not None, "dask" in sys.modules)
sweep.hide_dask()
print("dask" in sys.modules)
"""


def test_commands_import_dask_for_clusters_alone():
    """Where xarray is imported already, it knows of dask, and dask stays."""
    pytest.importorskip("dask")
    found = subprocess.run([sys.executable, "-c", DASK], capture_output=True, text=True, check=True).stdout
    assert found.splitlines() == ["[] None", "True False", "False"]
