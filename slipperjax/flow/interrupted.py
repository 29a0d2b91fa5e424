"""What is left of a run that was interrupted."""

import threading
from typing import Any

import jax
import numpy as np

from .status import Status

ASKED = threading.Event()
"""Set by programs that catch signals themselves: all runs end as by Ctrl-C, within a quarter of a second.

An exception that a signal's handler raises is lost where it meets a callback, such as JAX's in the garbage collector.
"""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a sweep, with the cases that were finished.

    `sweep`, `follow` and `lyapunov_sweep` raise it instead of a `KeyboardInterrupt`:

    ```python
    try:
        ds = sj.sweep(scene, grid)
    except sj.Interrupted as stop:
        ds = stop.dataset
    ```

    In an interactive session `sys.last_value.dataset` is the same. The run's threads end after the call that they are
    in.
    """

    def __init__(self, dataset: Any, finished: int, cases: int):
        super().__init__(dataset, finished, cases)
        self.dataset = dataset
        """The result, an `xarray.Dataset`, where cases that were not finished have `Status.NOT_RUN`; None where no
        case was finished."""
        self.finished = finished
        """How many cases were."""
        self.cases = cases
        """How many there are."""

    def __str__(self) -> str:
        if self.dataset is None:
            return f"interrupted before any of {self.cases} cases was finished"
        return (
            f"{self.finished} of {self.cases} cases were finished, see the attribute `dataset` of this exception "
            "(in an interactive session: sys.last_value.dataset)"
        )


def blank(found, lanes: int):
    """A result of a chunk that was not finished, in the shape of another chunk's: NaN and zeros, with its status.

    **Arguments:** `found`: a named tuple of arrays (lanes, ...) that has a field `status`; `lanes`: how many there
    are.
    """
    empty = jax.tree.map(lambda a: _empty(np.asarray(a), lanes), found)
    return empty._replace(status=np.full(lanes, int(Status.NOT_RUN)))


def _empty(like: np.ndarray, lanes: int) -> np.ndarray:
    return np.full((lanes, *like.shape[1:]), np.nan if like.dtype.kind == "f" else 0, like.dtype)
