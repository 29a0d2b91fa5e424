"""The command that lists kept compiled programs, and deletes them."""

from datetime import datetime

from ..tools.cache import OF_JAX, WHOLE, entries, kept_folder
from .options import app, flag


@app.command()
@flag("--clear", "Delete all programs of this kind of processor.")
def cache(clear: bool) -> None:
    """List kept compiled programs: their folder, number, size and oldest program."""
    folder = kept_folder()
    if folder is None:
        print("no programs are kept: the cache is off, or its folder cannot be used")
        return
    # the file that records a passed self-test is also a file there
    found = [entry for entry in entries(folder) if entry.path.name.endswith((WHOLE, OF_JAX))]
    size = f"{sum(entry.size for entry in found) / 1e6:.1f} MB"
    if clear:
        for entry in found:
            entry.path.unlink(missing_ok=True)
        print(f"deleted {len(found)} programs, {size}, of {folder}")
        return
    whole = sum(entry.path.name.endswith(WHOLE) for entry in found)
    print(f"folder    {folder}")
    print(f"programs  {len(found)}: {whole} of the package, {len(found) - whole} of JAX")
    print(f"size      {size}")
    if found:
        print(f"oldest    used last on {datetime.fromtimestamp(found[-1].used):%Y-%m-%d at %H:%M}")
