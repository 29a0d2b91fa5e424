"""Branches of a user's own systems as results: they list, draw and write themselves like branches of slippers."""

import json
from collections.abc import Mapping

import numpy as np

from ..analysis.arclength import Node
from ..analysis.continuation import Branch
from ..analysis.events import MEANINGS
from ..results.result import Result
from ..tools.checks import instance, require
from ..tools.columns import column


def branch_result(branch: Branch, units: Mapping[str, str] | None = None) -> Result:
    """Return a branch over one parameter as a `Result`, with files, tables and a picture.

    ```python
    found = sj.orbits.branch_result(branch, {"frequency": "rad/s", "state_0": "m"})
    found.write("branch.nc", "branch.csv")
    found.plot(quantity="state_0")
    ```

    **Arguments:** `branch`: of `slipperjax.analysis.continue_motion`; `units`: of the parameter and of the numbers of
    the state, `state_0` and so on, by name; by default pure numbers.

    **Returns:** a `Result` along `point` with the parameter, by its name in the family, the numbers of the state at
    the start of the motion, `multiplier_real` and `multiplier_imag` [1], `outside`, `stable`, `label`, and along
    `event` the table of events.

    **Raises:** `ValueError` for a curve over several parameters, and for units of names that the branch does not
    have.
    """
    names = list(instance("branch", branch, Branch, "a branch of slipperjax.analysis.continue_motion").parameters)
    require(len(names) == 1, "branch", "be over one parameter", names)
    (name,) = names
    nodes = branch.nodes
    unknowns = np.array([node.z for node in nodes])
    size = unknowns.shape[1] - 1
    numbers = [f"state_{k}" for k in range(size)]
    given = dict(units or {})
    need = f"name {name} and some of {', '.join(numbers)}"
    require(set(given) <= {name, *numbers}, "units", need, given)
    of = lambda one: given.get(one, "1")
    multipliers = np.array([node.multipliers for node in nodes])
    data = {
        number: column("point", unknowns[:, k], of(number), f"number {k} of the state")
        for k, number in enumerate(numbers)
    }
    data |= {
        "multiplier_real": column(("point", "multiplier"), multipliers.real, "1", "Floquet multipliers, real parts"),
        "multiplier_imag": column(
            ("point", "multiplier"), multipliers.imag, "1", "Floquet multipliers, imaginary parts"
        ),
        "outside": column("point", [node.outside for node in nodes], "1", "multipliers outside the unit circle"),
        "stable": column("point", branch.stable, "1", "whether no multiplier lies outside the unit circle"),
        "residual": column("point", [float(node.residual) for node in nodes], "1", "scaled residual"),
        "label": column("point", [node.label for node in nodes], "1", "event: one of " + ", ".join(MEANINGS)),
    }
    coords = {name: column("point", unknowns[:, size], of(name), name.replace("_", " "))}
    attrs = {
        "call": json.dumps({"function": "continue_motion"}),
        "varied": json.dumps(names),
        "ended": list(branch.ended),
        "orbit_period": int(getattr(branch.equations, "intervals", 1)),
    }
    import xarray as xr  # here, because importing it takes long

    return Result(xr.Dataset(data | _events(branch, nodes, of(name)), coords, attrs))


def _events(branch: Branch, nodes: tuple[Node, ...], unit: str) -> dict[str, tuple]:
    """Return the variables along `event`."""
    # by identity, because two points may have the same value
    index = {id(node.z): k for k, node in enumerate(nodes)}
    events = branch.events
    columns = {
        "label": ([event.label for event in events], "1", "event: one of " + ", ".join(MEANINGS)),
        "value": ([float(event.node.z[-1]) for event in events], unit, "parameter's value at the event"),
        "low": ([event.low for event in events], unit, "lower bound of it"),
        "high": ([event.high for event in events], unit, "upper bound of it"),
        "converged": ([event.converged for event in events], "1", "whether the event is located"),
        "note": ([event.note for event in events], "1", "more about the event"),
        "point": ([index[id(event.node.z)] for event in events], "1", "place of the event among the points"),
        "multiplier_real": ([event.multiplier.real for event in events], "1", "critical multiplier, real part"),
        "multiplier_imag": ([event.multiplier.imag for event in events], "1", "critical multiplier, imaginary part"),
    }
    return {f"event_{name}": column("event", values, own, text) for name, (values, own, text) in columns.items()}
