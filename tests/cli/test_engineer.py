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


def words_of(block):
    """The commands of a block, each as a list of words without the name of the program."""
    return [shlex.split(line)[1:] for line in commands(block) if line.startswith("slipperjax ")]


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


@pytest.mark.full
@pytest.mark.filterwarnings("default")
def test_a_short_day_goes_from_files_to_an_answer(folder, capsys):
    """Over 24 m instead of 2800, on eight rails, which are enough for a median."""
    short = {"2800": "24"}
    few = ["--rails", "8", "--quantiles", "0.5"]
    for block in BLOCKS:
        if block.language == "toml":
            file = folder / "sled.toml"
            file.write_text(changed(file.read_text(), block))
        elif block.language == "sh":
            for words in words_of(block):
                words = [short.get(word, word) for word in words] + few * ("--over" in words)
                text, _ = call(words, capsys)
                assert "wrote " in text
        elif block.language == "python":
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
    printed = ""
    for block in BLOCKS:
        if block.language == "toml":
            file = folder / "sled.toml"
            file.write_text(changed(file.read_text(), block))
        elif block.language == "sh" and words_of(block):
            printed = "".join(call(words, capsys)[0] for words in words_of(block))
            print(printed)
        elif block.language == "text":
            assert same(block.text, printed, chaotic=True)
