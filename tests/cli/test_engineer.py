"""The commands of docs/first_hour/engineer.md, typed into a folder with the files of docs/examples."""

import shlex
import shutil
import subprocess
import sys

import pytest
import xarray as xr

from ..commands import changed
from ..pages import EXAMPLES, ROOT, blocks, commands, same
from .commands import call

BLOCKS = blocks(ROOT / "docs" / "first_hour" / "engineer.md")
"""Commands, lines that are changed in the scene's file, what is printed, and Python, in their order."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for file in EXAMPLES.glob("*.csv"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_examples_are_those_of_their_script(tmp_path):
    shutil.copy(EXAMPLES / "make.py", tmp_path)
    subprocess.run([sys.executable, "make.py"], cwd=tmp_path, check=True)
    for file in EXAMPLES.glob("*.csv"):
        assert (tmp_path / file.name).read_text() == file.read_text()


def follow(folder, capsys, adapted=lambda words: words):
    """Types the commands and changes of the page; gives each block with what was printed for it."""
    printed = ""
    for block in BLOCKS:
        if block.language == "toml":
            file = folder / "sled.toml"
            file.write_text(changed(file.read_text(), block))
        elif block.language == "sh":
            lines = [shlex.split(line)[1:] for line in commands(block) if line.startswith("slipperjax ")]
            printed = "".join(call(adapted(words), capsys)[0] for words in lines) or printed
        else:
            yield block, printed


@pytest.mark.full
@pytest.mark.filterwarnings("default")
def test_a_short_day_goes_from_files_to_an_answer(folder, capsys):
    """Over 24 m instead of 2800, on eight rails, which are enough for a median."""
    few = ["--rails", "8", "--quantiles", "0.5"]
    short = lambda words: ["24" if word == "2800" else word for word in words] + few * ("--over" in words)
    for block, printed in follow(folder, capsys, short):
        assert "wrote " in printed
        if block.language == "python":
            exec(block.text.replace("[0.8e-3, 1.5e-3]}, ", "[0.8e-3, 1.5e-3]}, rails=8, quantiles=[0.5], "), {})
            assert "cannot be told from" in capsys.readouterr().out
    assert {path.suffix for path in folder.iterdir()} == {".csv", ".toml", ".nc", ".pdf", ".xlsx", ".png"}
    with xr.open_dataset(folder / "sled.nc") as ds:
        assert int(ds["status"]) == 0
        # it passes the standstill at 1 m/s
        assert ds["window_status"].values.tolist() == [10] + 23 * [0]
    with xr.open_dataset(folder / "plays.nc") as ds:
        assert ds["runs"].shape == (2, 8, 1)
        assert not ds["status"].any()


@pytest.mark.filterwarnings("default")
@pytest.mark.slow  # three minutes
def test_the_whole_day_prints_what_the_page_says(folder, capsys):
    """All words: numbers of chaotic motions are others on other processors."""
    for block, printed in follow(folder, capsys):
        if block.language == "text":
            assert same(block.text, printed, chaotic=True)
