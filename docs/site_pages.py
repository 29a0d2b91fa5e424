"""MkDocs hooks: pages of the notebooks, and links from names in texts to the API pages."""

import base64
import json
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
ROOMS = ("model", "solvers", "flow", "sweeps", "orbits", "analysis", "plots", "design")


def on_files(files: Files, *, config: Any) -> None:
    """Adds a page for each notebook, its pictures, and a page with all of them."""
    gallery = "# Notebooks\n\nEach picture leads to the code above it.\n"
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text, pictures = _page(path)
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        gallery += f'\n## [{text.splitlines()[0][2:]}]({path.stem}.md)\n\n<div class="gallery" markdown>\n\n'
        gallery += (
            "\n".join(f"[![{name}]({name})]({path.stem}.md#{name[:-4]})" for name in pictures)
            + "\n\n</div>\n"
        )
    files.append(File.generated(config, "notebooks/index.md", content=gallery))


def _page(path: Path) -> tuple[str, dict[str, bytes]]:
    """The Markdown of a notebook, and its pictures by name."""
    parts, pictures = [], {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            if "text" in output:
                parts.append("```text\n" + "".join(output["text"]).rstrip() + "\n```")
            elif "image/png" in output.get("data", {}):
                name = f"{path.stem}_{len(pictures) + 1}.png"
                pictures[name] = base64.b64decode(output["data"]["image/png"])
                parts.append(f'<a id="{name[:-4]}"></a>\n![{name}]({name})')
    title, _, rest = parts[0].partition("\n")
    return "\n\n".join(
        [title, f"The notebook is `notebooks/{path.name}`.", rest, *parts[1:]]
    ), pictures


def _public_paths() -> dict[str, str]:
    """Paths of the public names that texts may mean: those with a capital or an underscore; words are left alone."""
    paths = {}
    for room in ("", *ROOMS):
        file = ROOT / "slipperjax" / room / ("__init__.py" if room else "__init__.pyi")
        for name in re.findall(
            r"^from .* as (\w+)$", file.read_text(encoding="utf-8"), re.MULTILINE
        ):
            path = f"slipperjax.{room}.{name}" if room else f"slipperjax.{name}"
            paths[path] = path
            if re.search("[A-Z_]", name):
                paths.setdefault(name, path)
    return {
        written: path
        for written, path in paths.items()
        if path not in {f"slipperjax.{room}" for room in ROOMS}
    }


PATHS = _public_paths()


def on_page_markdown(markdown: str, *, page: Any, **kwargs: Any) -> str:
    """Leads to pages of notebooks instead of their files, and from names in texts to the API."""
    # the site has the documentation of these names below
    markdown = re.sub("<!-- names -->.*?<!-- end of names -->", "", markdown, flags=re.DOTALL)
    up = "../" * page.file.src_uri.count("/")
    markdown = markdown.replace("../docs/", up)
    markdown = re.sub(r"\((?:\.\./)+notebooks\)", f"({up}notebooks/index.md)", markdown)
    markdown = re.sub(
        r"\((?:\.\./)+notebooks/(\w+)\.ipynb\)", rf"({up}notebooks/\1.md)", markdown
    )
    parts = re.split(
        r"(^```.*?^```$|^#.*?$|\[[^\]]*\]\([^)]*\))", markdown, flags=re.MULTILINE | re.DOTALL
    )
    link = lambda m: f"[{m[0]}][{PATHS[m[1]]}]" if m[1] in PATHS else m[0]
    return "".join(
        part if k % 2 else re.sub(r"`([\w.]+)`", link, part) for k, part in enumerate(parts)
    )
