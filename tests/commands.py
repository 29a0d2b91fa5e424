"""Runs the commands that README and the first hours print: `python -m tests.commands`.

Each must end with exit code 0, and its last line must have the words of the page; numbers of chaotic motions depend
on the processor. `reproduce` runs with `--quick`.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from .pages import EXAMPLES, ROOT, Block, blocks, commands, same

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs" / "first_hour").glob("*.md"))]


def changed(text: str, block: Block) -> str:
    """Return a scene's file in which lines of a block replace those of their names, or follow their header."""
    table, *rows = block.text.strip().splitlines()
    for row in rows:
        name = row.partition(" = ")[0]
        inside = text.index(table)
        line = re.compile(rf"^{name} = .*$", re.MULTILINE)
        found = line.search(text, inside)
        ends = text.find("\n[", inside + 1)
        if found and (found.start() < ends or ends < 0):
            text = text[: found.start()] + row + text[found.end() :]
        else:
            text = text.replace(table, f"{table}\n{row}", 1)
    return text


def words_of(line: str) -> list[str]:
    """Return the words of a command after its program's name; none where it does not call slipperjax."""
    found = re.search(r"(?:^|/bin/)slipperjax (.*)", line)
    return shlex.split(found[1], comments=True) if found else []


def run(words: list[str], folder: Path) -> str:
    """Run a command and return the last line that it prints."""
    begun = time.perf_counter()
    command = [str(Path(sys.executable).with_name("slipperjax")), *words]
    quiet = os.environ | {"TQDM_DISABLE": "1"}
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=quiet)
    seconds = time.perf_counter() - begun
    print(f"slipperjax {shlex.join(words)}: exit code {ended.returncode}, {seconds:.0f} s", flush=True)
    if ended.returncode:
        raise SystemExit(ended.stderr)
    return ended.stdout.strip().rpartition("\n")[2]


def follow(page: Path, folder: Path) -> None:
    """Do in a folder what a page says: run its commands, and change the scene's file as its blocks show."""
    last = ""
    for block in blocks(page):
        if block.language == "sh":
            for words in filter(None, map(words_of, commands(block))):
                last = run(words, folder)
        elif block.language == "toml":
            scene = folder / "sled.toml"
            scene.write_text(changed(scene.read_text(), block))
        elif block.language == "text" and last:
            wanted = block.text.strip().rpartition("\n")[2]
            if not same(wanted, last, chaotic=True):
                raise SystemExit(f"{page}, line {block.line}, ends with\n{wanted}\nbut printed is\n{last}")
            last = ""
        elif block.language == "python":
            last = ""  # the text below is what Python printed
    # commands in tables
    for inline in re.findall(r"\| `slipperjax ([^`]+)` \|", page.read_text(encoding="utf-8")):
        words = shlex.split(inline)
        run([*words, "--quick"] if words == ["reproduce"] else words, folder)


if __name__ == "__main__":
    for page in PAGES:
        with tempfile.TemporaryDirectory() as folder:
            for file in EXAMPLES.glob("*.*"):
                shutil.copy(file, folder)
            follow(page, Path(folder))
