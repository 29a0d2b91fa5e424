"""The command line as a stranger would use it."""

import pytest
import xarray as xr

from slipperjax.cli import main


def run(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 0
    found = capsys.readouterr()
    return found.out + found.err


def test_bifurcation_writes_data_and_picture(tmp_path, capsys):
    out = tmp_path / "deep" / "fig"
    options = [
        "--over",
        "clearance",
        "0.5",
        "1.5",
        "3",
        "--transient",
        "2",
        "--periods",
        "2",
        "--steps-per-period",
        "50",
    ]
    text = run(["bifurcation", *options, "--out", str(out)], capsys)
    assert "3 cases" in text
    assert "0 cases flagged" in text
    ds = xr.open_dataset(f"{out}.nc", engine="h5netcdf")
    assert ds["clearance"].values.tolist() == pytest.approx([0.5e-3, 1e-3, 1.5e-3])
    assert ds["clearance"].attrs["units"] == "m"
    assert ds.attrs["steps_per_period"] == 50
    assert (tmp_path / "deep" / "fig.png").stat().st_size > 10_000


def test_simulate_writes_data_and_picture(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--periods", "6", "--steps-per-period", "200", "--saves-per-period", "200", "--solver", "auto"]
    text = run(["simulate", *options, "--out", str(out)], capsys)
    assert "200 steps per period" in text
    assert "solver RK4: an impact lasts" in text
    assert "status: finite" in text
    ds = xr.open_dataset(f"{out}.nc", engine="h5netcdf")
    assert ds.sizes["time"] == 1201
    assert (tmp_path / "run.png").stat().st_size > 10_000


def test_help_names_units(capsys):
    text = run(["bifurcation", "--help"], capsys)
    for unit in ("[m/s]", "[mm]", "[m]"):
        assert unit in text
