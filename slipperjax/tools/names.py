"""Where a public name stands that was looked for elsewhere."""

import difflib
import re
from collections.abc import Iterable
from pathlib import Path


def nearest_public(name: str, top: Iterable[str]) -> str | None:
    """Returns the path of the public name that is `name`, or is spelt most like it; None if there is none.

    `top` are the names of the top level; those of the rooms are read from their `__init__.py`, imported by nothing.
    """
    paths = {known: f"slipperjax.{known}" for known in top}
    for file in sorted(Path(__file__).parents[1].glob("*/__init__.py")):
        for known in re.findall(r"^from .* as (\w+)$", file.read_text(encoding="utf-8"), re.MULTILINE):
            paths.setdefault(known, f"slipperjax.{file.parent.name}.{known}")
    near = [name] if name in paths else difflib.get_close_matches(name, paths, 1)
    return paths[near[0]] if near else None
