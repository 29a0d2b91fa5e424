"""Runs the blocks of pages as their reader would: `python tests/pages.py docs/how_to/orbits.md ...`.

Python blocks share one namespace, in a folder with the files of docs/examples. Commands are run where `<!-- run -->`
is written before their block, lines that begin with slipperjax only. A block of text below is what was printed: words
must be the same, numbers within `CLOSE`. Behind `<!-- chaotic -->` numbers may be any: they depend on the processor.
Spaces may be any: NumPy pads the shorter numbers of an array.
"""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path
from typing import NamedTuple

import matplotlib
import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "examples"
CLOSE = 0.02
"""Greatest difference of printed numbers, as a share of the greater: the last of two or three digits may differ."""
ROUNDING = 1e-9
"""Magnitude below which numbers are those of rounding."""
NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")


class Block(NamedTuple):
    """A fenced block of a page."""

    mark: str  # word of the comment before it: "run", "chaotic" or none
    language: str
    text: str
    line: int


def blocks(path: Path) -> list[Block]:
    """List the fenced blocks of a page."""
    page = path.read_text(encoding="utf-8")
    fence = re.compile(r"^(?:<!-- (\w+) -->\n+)?```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    return [
        Block(found[1] or "", found[2], found[3], page.count("\n", 0, found.start(3)) + 1)
        for found in fence.finditer(page)
    ]


def commands(block: Block) -> list[str]:
    """List the lines of a block of commands, continued lines joined."""
    return [line for line in block.text.replace("\\\n", " ").splitlines() if line.strip()]


def words(text: str) -> str:
    """Return a text without its spaces, with a sign for every number."""
    return "".join(NUMBER.sub("#", text).split())


def same(said: str, printed: str, chaotic: bool = False) -> bool:
    """Whether words are the same and numbers close, or any where a motion is chaotic."""
    if words(said) != words(printed):
        return False
    pairs = () if chaotic else zip(NUMBER.findall(said), NUMBER.findall(printed), strict=True)
    values = [(float(a.replace(",", "")), float(b.replace(",", ""))) for a, b in pairs]
    return all(abs(a - b) <= max(CLOSE * max(abs(a), abs(b)), ROUNDING) for a, b in values)


def shell(block: Block) -> str:
    """Run the commands of a block and return what they print."""
    here = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    lines = [line for line in commands(block) if line.startswith("slipperjax ")]
    run = subprocess.run(
        "\n".join(["set -e", *lines]), shell=True, capture_output=True, text=True, env=os.environ | here
    )
    if run.returncode:
        raise RuntimeError(run.stderr)
    return run.stdout


def execute(path: Path) -> None:
    """Run the blocks of a page in the current folder."""
    names: dict = {"__name__": "__main__"}
    printed = ""
    for mark, language, text, line in (listed := blocks(path)):
        if language == "python":
            out = io.StringIO()
            code = compile("\n" * (line - 1) + text, str(path), "exec")
            with contextlib.redirect_stdout(out):
                exec(code, names)
            printed = out.getvalue()
        elif language == "sh" and mark == "run":
            printed = shell(Block(mark, language, text, line))
        elif language == "text" and printed:
            if not same(text, printed, mark == "chaotic"):
                raise AssertionError(f"{path}, line {line}, says\n{text}\nbut printed is\n{printed}")
            printed = ""
    print(f"{path}: {sum(block.language == 'python' for block in listed)} blocks of Python")


def succeeds(page: Path) -> bool:
    """Execute a page in a folder of its own; prints what went wrong."""
    with tempfile.TemporaryDirectory() as folder:
        for file in EXAMPLES.glob("*.*"):
            shutil.copy(file, folder)
        with contextlib.chdir(folder):
            try:
                execute(page)
            except Exception:
                print(f"{page} fails:\n{traceback.format_exc()}", file=sys.stderr)
                return False
            finally:
                plt.close("all")  # the reader of the next page has none open
    return True


if __name__ == "__main__":
    os.environ["TQDM_DISABLE"] = "1"
    matplotlib.use("agg")
    # all of them, though one fails
    sys.exit(not all([succeeds(Path(name).resolve()) for name in sys.argv[1:]]))
