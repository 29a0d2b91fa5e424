"""Scenes and results from files."""

import os
from typing import TYPE_CHECKING

from ..flow.datasets import function_of, read_dataset
from ..model.scene_files import SceneFile, scene_from_toml
from ..orbits.branches import OrbitBranch
from ..orbits.critical import OrbitCurve
from ..results.result import Result
from ..tools.checks import require
from ..tools.files import STANDARD_INPUT, content_of, readable, user_path
from .store import open_store

if TYPE_CHECKING:
    import xarray as xr


def load(source: "str | os.PathLike[str] | xr.Dataset") -> Result | SceneFile:
    """Return a result from its netCDF file, its store or its dataset, or the contents of a scene's TOML file.

    ```python
    file = sj.load("scene.toml")
    result = sj.run(file.scene, start=file.start, **file.run)
    result.write("run.nc", "run.png")
    sj.load("run.nc").plot()
    ```

    **Returns:** a `Result`; for `continue_orbit` an `OrbitBranch`, which can be extended; or a `SceneFile`.

    **Raises:** `ValueError` for any other source; `OSError` for a file that cannot be read.
    """
    if not isinstance(source, str | os.PathLike):
        # a result has its dataset, and a dataset has its attributes and coordinates
        ds = getattr(source, "ds", source)
        is_dataset = hasattr(ds, "attrs") and hasattr(ds, "coords")
        require(is_dataset, "source", "be a TOML or netCDF file, or a dataset of slipperjax", source)
        return _result(ds)
    path = user_path(source, "source")
    if path.suffix.lower() == ".toml" or path == STANDARD_INPUT:
        content = content_of(path)
        with readable(path, "TOML file in UTF-8"):
            text = content.decode()
        return scene_from_toml(text, str(path))
    if path.is_dir() or path.suffix == ".zarr":
        return _result(open_store(path))
    return _result(read_dataset(path))


def _result(ds: "xr.Dataset") -> Result:
    """Return the result of a dataset, of the class that the dataset's function returns."""
    function = function_of(ds)
    kinds: dict[str, type[Result]] = {"continue_orbit": OrbitBranch, "continue_event": OrbitCurve}
    return kinds.get(function, Result)(ds)
