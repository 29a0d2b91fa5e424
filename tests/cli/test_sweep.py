"""`slipperjax sweep` and `slipperjax store`: grids, samples, shares, and what they print."""

import shutil
import signal
import subprocess
import sys
import time

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli import main

QUICK = ["--transient", 10, "--periods", 2, "--steps-per-period", 50]
MAP = ["--over", "speed", 1000, 1600, 5, "--by", "clearance", 0.5, 1.5, 4, *QUICK]


def call(arguments, capsys, code=0):
    with pytest.raises(SystemExit) as stopped:
        main(list(map(str, arguments)))
    found = capsys.readouterr()
    assert stopped.value.code == code, found.err
    return found.out, found.err


def refused(arguments, capsys):
    _, error = call(arguments, capsys, 2)
    assert error.count("error: ") == 1
    return error.splitlines()[-1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stores")


@pytest.fixture(scope="module")
def stored(folder):
    """A map of 5 speeds and 4 clearances in tiles of 8 cases."""
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in ("sweep", *MAP, "--store", folder / "map.zarr", "--tile", 8)])
    assert stopped.value.code == 0
    return folder / "map.zarr"


def test_a_map_is_stored_and_drawn(stored, capsys):
    ds = sj.open_store(stored)
    assert dict(ds["status"].sizes) == {"speed": 5, "clearance": 4}
    assert ds["clearance"].values == pytest.approx(np.linspace(0.5e-3, 1.5e-3, 4))
    assert matplotlib.image.imread(stored.with_suffix(".png")).shape[0] > 500
    out, error = call(["sweep", *MAP, "--store", stored], capsys)  # nothing is left to do, in tiles as they are
    assert "20 cases, 10 + 2 periods, 50 steps per period" in out
    assert "0 cases flagged" in out
    assert "map.png will be replaced" in error


def test_shares_make_the_same_store(stored, folder, capsys):
    for k in (1, 2):
        out, _ = call(["sweep", *MAP, "--store", folder / "s.zarr", "--tile", 8, "--share", f"{k}/2"], capsys)
        assert out.startswith(f"share {k}/2")
    assert "20 of 20 cases (100.0%), 3 of 3 tiles" in out
    read = lambda path: {str(f.relative_to(path)): f.read_bytes() for f in path.rglob("*") if f.is_file()}
    assert read(folder / "s.zarr") == read(stored)


def test_stores_are_looked_after(stored, folder, capsys):
    assert call(["store", "status", stored], capsys)[0].startswith("20 of 20 cases (100.0%), 3 of 3 tiles, ")
    assert call(["store", "check", stored], capsys)[0].startswith("nothing is damaged: 20 of 20")
    shutil.copytree(stored, folder / "copy.zarr")
    (folder / "copy.zarr" / "v_z" / "c" / "1" / "0" / "0").write_bytes(b"nothing")
    out, _ = call(["store", "check", folder / "copy.zarr", "--repair"], capsys, 1)
    assert out.startswith("tile 1: ")
    out, _ = call(["store", "draw", folder / "copy.zarr", "--show", "penetration", "--out", folder / "p.png"], capsys)
    assert f"wrote {folder / 'p.png'}" in out
    assert "12 of 20 cases" in out
    assert "must be a store of slipperjax" in refused(["store", "status", folder / "none.zarr"], capsys)


def test_a_sample_needs_no_store(folder, capsys):
    box = ["--over", "speed", 900, 1000, 1, "--by", "clearance", 0.5, 2, 1, "--log", "clearance"]
    call(["sweep", *box, "--sample", 16, *QUICK, "--out", folder / "box.nc"], capsys)
    with xr.open_dataset(folder / "box.nc", engine="h5netcdf") as ds:
        assert dict(ds["status"].sizes) == {"case": 16}
        assert np.all((ds["clearance"] > 0.5e-3) & (ds["clearance"] < 2e-3) & (ds["speed"] > 900))
        assert 6 <= int((ds["clearance"] < 1e-3).sum()) <= 10  # spread by ratios


def test_an_estimate_writes_nothing(folder, capsys):
    out, _ = call(["sweep", *MAP, "--store", folder / "none.zarr", "--explain"], capsys)
    assert out.startswith("sweep: 20 cases in 1 tiles of 20 (5 x 4)")
    assert not (folder / "none.zarr").exists()


def test_wrong_options_are_named(stored, folder, capsys):
    new = ["--store", folder / "new.zarr"]
    for more, words in (
        ([*MAP, "--share", "1/2"], "Option --share needs --store"),
        ([*MAP, *new, "--share", "3/2"], "I from 1 to N"),
        ([*MAP, *new, "--share", "1/2", "--fresh"], "`fresh` must be False for a share"),
        ([*MAP, "--store", folder / "new.nc"], "ends in .zarr"),
        ([*MAP, *new, "--record", "exponents", "--record", "strobe"], "--record exponents must stand alone"),
        ([*MAP, *new, "--processes", 2, "--cluster", "tcp://a"], "--cluster must not be given with --processes"),
        ([*QUICK, *new], "Missing option '--over'"),
        (["--over", "speed", 1, 2, 3, "--by", "clearance", 1, *QUICK], "'--by': '--transient' is not a valid float"),
        (["--over", "speed", 1, 2, 3, "--by", "speed", 1, 2, 3, *QUICK], "speed"),
        ([*MAP, "--restitution", 0.5, "--store", stored], "restitution: 0.9 in the store, 0.5 asked"),
    ):
        assert words in refused(["sweep", *more], capsys)
    assert not (folder / "new.zarr").exists()


def test_ctrl_c_says_that_the_same_command_goes_on(folder):
    words = ["--over", "speed", 1000, 1600, 6400, "--transient", 200, "--periods", 2, "--steps-per-period", 50]
    words += ["--store", folder / "c.zarr", "--tile", 16]
    command = [sys.executable, "-c", "from slipperjax.cli import main; main()", "sweep", *map(str, words)]
    options = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # what is ignored is inherited
    try:
        started = subprocess.Popen(command, **options)
    finally:
        signal.signal(signal.SIGINT, before)
    with started as one:
        until = time.monotonic() + 120
        while not list(folder.glob("c.zarr/status/c/*")) and time.monotonic() < until:
            time.sleep(0.05)
        one.send_signal(signal.SIGINT)
        _, error = one.communicate(timeout=60)
    assert one.returncode == 130
    assert "of 6400 cases were finished: kept in" in error
    assert "the same command goes on" in error
    assert 0 < int((sj.open_store(folder / "c.zarr")["status"] == 0).sum()) < 6400
