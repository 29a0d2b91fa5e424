"""Branches of a user's own systems as results: they list, draw and write themselves like branches of slippers."""

import json
from collections.abc import Mapping

import numpy as np

from ..analysis.continuation import Branch
from ..analysis.events import MEANINGS
from ..results.result import Result
from ..tools.checks import instance, require
from ..tools.columns import column
from .branches import curve_columns, event_columns, point_columns


def branch_result(branch: Branch, units: Mapping[str, str] | None = None) -> Result:
    """Return a branch over one parameter, or a curve over two, as a `Result` with files, tables and a picture.

    ```python
    found = sj.orbits.branch_result(branch, {"frequency": "rad/s", "state_0": "m"})
    found.write("branch.nc", "branch.csv")
    found.plot(quantity="state_0")
    ```

    **Arguments:** `branch`: of `continue_motion`, `continue_critical`, `continue_grazing` or `leave_grazing`;
    `units`: of the parameters and of the numbers of the state, `state_0` and so on, by name; by default pure numbers.

    **Returns:** a `Result` along `point` with the parameters, by their names in the family, the numbers of the state
    at the start of the motion, on curves of grazings at the touch, `multiplier_real` and `multiplier_imag` [1], NaN
    where an impact has no rate, `outside`, `stable`, `label`, and along `event` the table of events.

    **Raises:** `ValueError` for units of names that the branch does not have.
    """
    names = instance("branch", branch, Branch, "a branch of slipperjax.analysis.continue_motion").names
    curve = len(names) > 1
    label = getattr(branch.equations, "label", "")
    # all points of a curve are at the event: the label marks their critical multipliers
    nodes = [node._replace(label=label or node.label) for node in branch.nodes]
    motions = getattr(branch.equations, "motions", branch.equations)
    states = np.transpose([node.z[: motions.size] for node in nodes])
    numbers = [f"state_{k}" for k in range(len(states))]
    given = dict(units or {})
    need = f"name {' and '.join(names)} and some of {', '.join(numbers)}"
    require(set(given) <= {*names, *numbers}, "units", need, given)
    of = lambda one: given.get(one, "1")
    data = {
        number: column("point", states[k], of(number), f"number {k} of the state") for k, number in enumerate(numbers)
    }
    data |= point_columns(nodes)
    data |= {
        "stable": column("point", branch.stable, "1", "whether no multiplier lies outside the unit circle"),
        "label": column("point", [node.label for node in nodes], "1", "event: one of " + ", ".join(MEANINGS)),
    }
    coords = {
        name: column("point", values, of(name), name.replace("_", " "))
        for name, values in zip(names, branch.parameters.T, strict=True)
    }
    attrs = {
        "label": label,
        "call": json.dumps({"function": "continue_event" if curve else "continue_motion"}),
        "varied": json.dumps(names),
        "ended": list(branch.ended),
        "orbit_period": motions.intervals,
    }
    import xarray as xr  # here, because importing it takes long

    columns = curve_columns if curve else event_columns
    return Result(xr.Dataset(data | columns(branch, of(names[-1])), coords, attrs))
