"""What the pages tell the reader to type works: Python runs, commands and scenes can be read, files are there."""

import re
import shlex
import shutil
import subprocess
import sys

import click
import pytest

import slipperjax as sj
from slipperjax.cli import app

from .pages import EXAMPLES, ROOT, blocks, commands, same

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
WORDS = 21_700
"""Most words of the pages, outside of code."""
README_WORDS = 500
"""Most words of the README, outside of code."""
PAPER, PAPER_WORDS = ROOT / "paper.md", 750
"""The paper, and its most words, code included, without its header."""


def with_blocks(language, *but):
    """Pages with blocks of a language."""
    found = [page for page in PAGES if any(block.language == language for block in blocks(page))]
    return [page for page in found if page.stem not in but]


def having(language, *but):
    """One test for each page with blocks of a language."""
    return pytest.mark.parametrize("page", with_blocks(language, *but), ids=lambda page: page.stem)


@pytest.mark.parametrize(
    ("said", "printed", "chaotic", "expected"),
    [
        ("[2 1.50 ]", "[2 1.51]", False, True),
        ("[2 1.50 ]", "[2 1.60]", False, False),
        ("[2 1.50 ]", "[2 39.125]", True, True),
        ("[2 1.50 ]", "[2 39.125 3]", True, False),
        ("period 2", "periods 2", True, False),
    ],
)
def test_what_a_page_says_is_compared_with_what_is_printed(said, printed, chaotic, expected):
    """NumPy pads the shorter numbers of an array, so spaces do not count."""
    assert same(said, printed, chaotic) is expected


@pytest.mark.full
@pytest.mark.parametrize("part", range(2))
def test_python_of_the_pages_runs(part):
    """In two processes, which compile what several pages use once, and in which no warning is given."""
    quiet = ["-W", "error", "-W", "default:File", "-W", "default:slipperjax computes in its plain form"]
    pages = with_blocks("python", "engineer")[part::2]  # tests/cli/test_engineer.py runs the engineer's
    program = [sys.executable, *quiet, ROOT / "tests" / "pages.py", *pages]
    run = subprocess.run(program, capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr[-9000:]


def parsed(words):
    """The context of a command whose options could be read; nothing is run."""
    command, context = app, None
    while True:
        context = command.make_context(words[0] if context else "slipperjax", list(words[1:]), parent=context)
        if not isinstance(command, click.Group):
            return context
        _, command, words = command.resolve_command(context, context._protected_args + context.args)
        words = [command.name, *words]


@having("sh")
def test_commands_of_the_pages_can_be_read(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in blocks(page):
        for line in commands(block) if block.language == "sh" else ():
            words = shlex.split(line, comments=True)
            if "slipperjax" in words[:1]:
                parsed(words)
            for word in words:
                if re.match(r"(tests|notebooks|docs)/", word):
                    assert list(ROOT.glob(word.split("::")[0])), line


@having("toml", "engineer")
@pytest.mark.filterwarnings("default:File")  # columns of remarks
def test_scenes_of_the_pages_can_be_read(page, tmp_path):
    """Parts of a file complete that of the paper's slipper."""
    for file in EXAMPLES.glob("*.*"):
        shutil.copy(file, tmp_path)
    for block in blocks(page):
        if block.language == "toml":
            base = "" if re.search("^base", block.text, re.MULTILINE) else 'base = "paper"\n'
            (tmp_path / "part.toml").write_text(base + block.text)
            _ = sj.load(tmp_path / "part.toml").scene


def test_the_page_of_statuses_has_them_all():
    page = (ROOT / "docs" / "reference" / "status.md").read_text()
    rows = [f"| {int(status)} | {status.meaning} | {status.remedy} |" for status in sj.Status]
    assert [line for line in page.splitlines() if re.match(r"\| \d", line)] == rows


def counted(page):
    """Number of words of a page that a reader sees, without code and the targets of links."""
    text = re.sub(r"```.*?```|<!--.*?-->|(?<=\])\([^)\s]*\)", "", page.read_text(), flags=re.DOTALL)
    return len(re.findall(r"[A-Za-z][A-Za-z'’-]*", text))


def test_the_pages_stay_short():
    assert counted(ROOT / "README.md") <= README_WORDS
    pages = [page for page in PAGES if ROOT / "docs" in page.parents and page.parent.name != "api"]
    assert sum(map(counted, pages)) <= WORDS


def test_the_paper_is_short_and_what_it_names_exists():
    _, _, body = PAPER.read_text().split("---\n", 2)
    assert len(body.split()) <= PAPER_WORDS
    entries = re.findall(r"^@\w+\{(\w+),(.*?)^\}", PAPER.with_suffix(".bib").read_text(), re.MULTILINE | re.DOTALL)
    assert all("doi" in entry or "url" in entry for _, entry in entries)
    assert set(re.findall(r"@(\w+)", body)) == {name for name, _ in entries}
    for module in re.findall(r"python -m ([\w.]+)", body):
        assert (ROOT / f"{module.replace('.', '/')}.py").exists()
    for file in re.findall(r"python (\S+\.py)", body):
        assert (ROOT / file).exists()
