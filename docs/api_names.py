"""Lists the public names of each room on its API page, for readers in the repository: `python docs/api_names.py`.

On the site the documentation of each name stands in their place. With `--check` nothing is written, and the exit code
is 1 where a page is not as it would be written.
"""

import re
import sys
from pathlib import Path

import griffe

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "reference" / "api"
BEGIN, END = "<!-- names -->", "<!-- end of names -->"
"""What stands before and behind a list."""
SENTENCE = re.compile(r"(?<!Eq)(?<!Eqs)\.\s")
"""Where a sentence ends; not behind Eq. and Eqs."""


def names_of(module: griffe.Module) -> str:
    """Return the table of a module's public names, each with the first sentence of its docstring."""
    rows = ["| name | what it is |", "|---|---|"]
    public = {name: m for name, m in module.members.items() if m.is_alias and m.public}
    for name, member in sorted(public.items(), key=lambda item: item[0].lower()):
        target = member.final_target
        words = " ".join(target.docstring.value.split()) if target.docstring else ""
        sentence = SENTENCE.split(words, maxsplit=1)[0].rstrip(".").replace("|", "\\|")
        file = target.filepath.relative_to(ROOT)
        rows.append(f"| [`{name}`](../../../{file}) | {sentence} |")
    return "\n".join(rows)


def written(page: Path, module: griffe.Module) -> str:
    """Return the text of a page with the list of a module's names before its directive."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(f"{BEGIN}.*?{END}\n\n", "", text, flags=re.DOTALL)
    directive = f"::: {module.path}\n"
    return text.replace(directive, f"{BEGIN}\n{names_of(module)}\n{END}\n\n{directive}")


if __name__ == "__main__":
    extensions = griffe.load_extensions(str(ROOT / "docs" / "public_names.py"))
    package = griffe.load(
        "slipperjax", search_paths=[ROOT], extensions=extensions, allow_inspection=False
    )
    stale = []
    for page in sorted(PAGES.glob("*.md")):
        module = package if page.stem == "index" else package.modules[page.stem]
        text = written(page, module)
        if text != page.read_text(encoding="utf-8"):
            stale.append(page.name)
            if "--check" not in sys.argv:
                page.write_text(text, encoding="utf-8")
    print(f"{'stale' if '--check' in sys.argv else 'written'}: {', '.join(stale) or 'none'}")
    sys.exit(bool(stale) and "--check" in sys.argv)
