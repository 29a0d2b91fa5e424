"""A command's standard input, written as -."""

import io
import math
from pathlib import Path

import numpy as np
import pytest

import slipperjax as sj

from .commands import error_of


@pytest.fixture
def piped(monkeypatch):
    """Gives a text or bytes to a command's standard input."""

    def give(content):
        raw = content if isinstance(content, bytes) else content.encode()
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(raw)))

    return give


def test_a_dash_is_standard_input(piped, tmp_path, monkeypatch, capsys, replaced):
    monkeypatch.chdir(tmp_path)
    ran = replaced("sweeps.runs.run", side_effect=ValueError("seen"))
    text = 'base = "paper"\nspeed = "700 m/s"\n[track]\nfile = "rail.csv"\n[run]\nlength = "5 m"\n'
    rail = "chainage [m],lateral [mm],vertical [mm]\n" + "".join(
        f"{k / 4},0,{math.sin(k / 40)}\n" for k in range(400)
    )
    # files that a scene names are sought where the command is
    Path("rail.csv").write_text(rail)
    Path("scene.toml").write_text(text)
    piped(text)
    assert error_of(["run", "-"], capsys) == "error: seen\n"
    assert ran.call_args[1]["length"] == 5.0
    assert float(ran.call_args[0][0].speed) == 700.0
    assert ran.call_args[0][0].track.file == "rail.csv"
    piped(rail)
    assert error_of(["run", "scene.toml", "--rail", "-"], capsys) == "error: seen\n"
    track = ran.call_args[0][0].track
    assert track.file == "standard input"
    np.testing.assert_array_equal(track.vertical, sj.load_rail("rail.csv").vertical)
    # what is wrong is named, and the next command has another input
    piped(text.replace("700 m/s", "700 kg"))
    assert "standard input, line 2: `speed` must be in a unit like m/s" in error_of(["run", "-"], capsys)
    piped(b"\x89HDF\r\n")
    assert "standard input is no TOML file in UTF-8 that can be read" in error_of(["run", "-"], capsys)
    piped(text)
    assert "Standard input, -, must stand for one file only" in error_of(["run", "-", "--rail", "-"], capsys)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["run", "scene.toml", "--out", "-"], "Option --out"),
        (["new", "scene.toml", "--load", "-"], "Option --load"),
        (["store", "status", "-"], "Argument `path`"),
    ],
)
def test_other_files_are_no_standard_input(arguments, name, capsys):
    assert error_of(arguments, capsys) == f"error: {name} must be the path of a file, but is -, standard input.\n"
