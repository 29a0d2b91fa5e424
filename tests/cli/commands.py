"""Commands that are called in this process, and what they leave."""

import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb

from slipperjax.cli import main

from ..common import DATA

BRANCH = DATA / "branch.nc"
"""A branch of orbits over 1090 to 1110 m/s, of 100 steps per period, with a flip at 1095.9 m/s."""
TEN = ["--transient", 10, "--periods", 10, "--steps-per-period", 100]
"""Options of short runs over speed, which share their programs with tests/sweeps."""
DPI = 300
# 16 cm [in]
TEXT = 16 / 2.54


def call(arguments, capsys, code=0):
    """Runs a command; gives its standard output and standard error."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main(list(map(str, arguments)))
    found = capsys.readouterr()
    assert stopped.value.code == code, found.err
    return found.out, found.err


def error_of(arguments, capsys):
    """The one line that a wrong command prints."""
    out, error = call(arguments, capsys, 2)
    assert not out
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    return error


def dataset(out):
    with xr.open_dataset(f"{out}.nc", engine="h5netcdf") as ds:
        return ds.load()


def picture(out, width, height):
    """The pixels of a picture of `width` and `height` inches, (rows, columns, 3)."""
    pixels = matplotlib.image.imread(f"{out}.png")[..., :3]
    # narrow pictures have more pixels per inch, so that they may be spread over a text
    per_inch = round(DPI * max(1.0, TEXT / width))
    # matplotlib cuts off a part of a pixel
    assert pixels.shape == (int(height * per_inch), int(width * per_inch), 3)
    return pixels


def share(pixels, color):
    """Share of pixels with a colour."""
    return float(np.mean(np.all(np.abs(pixels - np.array(to_rgb(color))) < 0.01, axis=-1)))


def names(folder):
    return sorted(path.name for path in folder.iterdir())
