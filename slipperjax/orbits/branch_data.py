"""Branches of orbits as labelled datasets."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from ..analysis.continuation import Branch
from ..analysis.events import CRITICAL_DISTANCE, MEANINGS, Event
from ..flow.datasets import run_attributes, scene_attributes
from ..flow.record import SectionPoints, Sections, Strobe
from ..model.dynamics import State
from ..model.layout import coordinates
from ..model.paths import parameter
from ..model.scene import Scene
from .signature import Grazing, Signature, contact_names


class OrbitView(NamedTuple):
    """Contacts and sections of one orbit of a branch."""

    grazing: Grazing
    signature: Signature
    sections: SectionPoints
    """Of this orbit alone."""


class BranchEvent(NamedTuple):
    """A bifurcation, grazing or end point of a branch."""

    label: str
    """One of `slipperjax.analysis.events.MEANINGS`."""
    value: float
    """The parameter's value there [its SI unit]."""
    low: float
    """Lower bound of it."""
    high: float
    """Upper bound of it."""
    multiplier: complex
    """The critical multiplier [1]; NaN where there is none."""
    converged: bool
    note: str
    point: int
    """Its index among the branch's points."""


BIFURCATIONS = ("LP", "PD", "NS", "BP")
"""Events with a critical multiplier."""
FIELDS = {
    "value": "parameter's value at the event",
    "low": "lower bound of it",
    "high": "upper bound of it",
    "converged": "whether the event is located",
    "note": "more about the event",
    "point": "place of the event among the points",
}
"""Fields of `BranchEvent` that are variables of a dataset as they are, with their descriptions."""


def branch_dataset(branch: Branch, scene: Scene, name: str, states: State, call: Mapping[str, Any]) -> Any:
    """Makes an `xarray.Dataset` of a branch, from which the branch can be made again.

    **Arguments:** `scene`, `name`: the scene and its parameter that varies; `states`: those of the points, with a
    leading axis; `call`: arguments of `continue_orbit`.
    """
    import xarray as xr

    nodes, varied = branch.nodes, parameter(name, scene)
    views: list[OrbitView] = [node.view.data for node in nodes]
    z = np.array([node.spot.z for node in nodes])

    def of_points(values: Sequence[Any], text: str, unit: str = "1", dims: tuple[str, ...] = ()) -> tuple:
        return ("point", *dims), np.array(values), {"units": unit, "long_name": text}

    multipliers = np.array([node.multipliers for node in nodes])
    # at a bifurcation rounding decides on which side the critical multiplier lies
    critical = np.array([node.label in BIFURCATIONS for node in nodes])
    outside = np.sum(np.abs(multipliers) > 1 + CRITICAL_DISTANCE * critical[:, None], axis=1)
    data = {
        "state": of_points(z[:, :-1], "all numbers of the state, as in slipperjax.State", dims=("number",)),
        "tangent": of_points(
            [node.spot.tangent for node in nodes], "direction of the branch", dims=("number_and_parameter",)
        ),
        "multiplier_real": of_points(multipliers.real, "Floquet multipliers, real parts", dims=("multiplier",)),
        "multiplier_imag": of_points(multipliers.imag, "Floquet multipliers, imaginary parts", dims=("multiplier",)),
        "outside": of_points(outside, "multipliers outside the unit circle, without critical ones"),
        "stable": of_points((outside == 0) & ~critical, "whether all multipliers lie inside the unit circle"),
        "residual": of_points([node.spot.residual for node in nodes], "scaled residual"),
        "iterations": of_points([node.spot.iterations for node in nodes], "iterations of Newton's method"),
        "label": of_points(_texts(node.label for node in nodes), _MEANINGS),
        "signature": of_points(_texts(" ".join(v.signature.points) for v in views), "touchdowns in their order"),
        "slowest_touchdown": of_points([v.signature.slowest for v in views], "slowest touchdown", "m/s"),
        "grazing_gap": of_points([v.signature.nearest for v in views], "least magnitude of a gap's extreme", "m"),
        "touchdowns": of_points(
            np.array([v.grazing.touchdowns for v in views]).reshape(len(nodes), 2, -1),
            "touchdowns in a period of the orbit",
            dims=("end", "contact"),
        ),
    }
    together = jax.tree.map(lambda *parts: np.stack(parts), *(v.sections for v in views))
    sections, _ = Sections().label(scene, ("point",), together)
    strobe, coords = Strobe().label(scene, ("point",), coordinates(states)[:, None])
    coords |= {
        name: ("point", z[:, -1], varied.attributes),
        "end": ["front", "rear"],
        "contact": list(scene.section.names),
    }
    start = jax.tree.map(lambda a: np.asarray(a)[0], states)
    call = {"function": "continue_orbit", "parameter": name, **call}
    attrs = scene_attributes(scene, without=[name]) | run_attributes(scene, start, call, [name])
    attrs |= {
        "orbit_period": branch.equations.intervals,
        "ended": list(branch.ended),
        "next_steps": [end.step for end in branch.ends],
    }
    return xr.Dataset(
        data | sections | strobe | _event_variables(events_of(branch, scene), varied.unit), coords, attrs
    )


_MEANINGS = "event: " + "; ".join(f"{label}: {meaning}" for label, meaning in MEANINGS.items())


def _texts(words: Any) -> np.ndarray:
    return np.array([str(word) for word in words], dtype=str)


def events_of(branch: Branch, scene: Scene) -> tuple[BranchEvent, ...]:
    """Gives the events of a branch, with the touchdowns that a grazing changes in words."""
    # by identity: a bound and a grazing may share a value
    index = {id(node.spot.z): k for k, node in enumerate(branch.nodes)}
    events = []
    for event in branch.events:
        z, note = event.node.spot.z, "; ".join([*_touches(event, scene), *([event.note] if event.note else [])])
        bounds = event.low, event.high
        events.append(
            BranchEvent(event.label, float(z[-1]), *bounds, event.multiplier, event.converged, note, index[id(z)])
        )
    return tuple(events)


def _touches(event: Event, scene: Scene) -> list[str]:
    """Gives the touchdowns that a grazing changes, in words, in the direction of the branch."""
    names = contact_names(scene)
    view: OrbitView | None = event.node.view.data
    if view is None:
        return []
    return [
        f"{names[k]} {'opens' if view.grazing.opening[k] else 'touches'} once {'more' if change > 0 else 'less'}"
        for k, change in enumerate(event.change)
        if change
    ]


def _event_variables(events: Sequence[BranchEvent], unit: str) -> dict[str, Any]:
    """Gives the variables of the table of events."""
    critical = np.array([event.multiplier for event in events], complex)
    words = lambda text: {"units": unit if text in ("value", "low", "high") else "1", "long_name": FIELDS[text]}
    data: dict[str, Any] = {f"event_{name}": ("event", _column(events, name), words(name)) for name in FIELDS}
    data["event_label"] = ("event", _texts(event.label for event in events), {"units": "1", "long_name": _MEANINGS})
    for part in ("real", "imag"):
        attributes = {"units": "1", "long_name": f"critical multiplier, {part} part"}
        data[f"event_multiplier_{part}"] = ("event", getattr(critical, part), attributes)
    return data


def _column(events: Sequence[BranchEvent], name: str) -> np.ndarray:
    values = [getattr(event, name) for event in events]
    return _texts(values) if name == "note" else np.array(values, dtype=type(values[0]) if values else float)


def events_from(ds: Any) -> tuple[BranchEvent, ...]:
    """Reads the events of a branch's dataset."""
    columns = {name: ds[f"event_{name}"].values.tolist() for name in ("label", *FIELDS)}
    columns["multiplier"] = (ds["event_multiplier_real"].values + 1j * ds["event_multiplier_imag"].values).tolist()
    rows = zip(*(columns[name] for name in BranchEvent._fields), strict=True)
    return tuple(BranchEvent(*row) for row in rows)
