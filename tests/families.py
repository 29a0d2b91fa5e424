"""Programs that many tests share: one for each kind of argument, whatever its numbers are.

An operation of JAX outside of a program is a program of its own, for each shape. Numbers of rails are asked for here.
"""

from typing import Any

import equinox as eqx


@eqx.filter_jit
def irregularity_of(track: Any, places: Any) -> Any:
    """Displacements of a rail: one program for each kind of rail and number of places."""
    return track.irregularity(places)


@eqx.filter_jit
def motion_of(track: Any, places: Any) -> Any:
    """Displacements of a rail and their slopes: one program for each kind of rail and number of places."""
    return track.motion(places)


@eqx.filter_jit
def facts_of(track: Any) -> tuple[Any, Any, Any]:
    """Recurrence [m], steepest slope [1] and shortest wavelength [m] of a rail: one program for each kind."""
    return track.recurrence, track.steepest_slope, track.shortest_wavelength


def largest(one: Any, other: Any) -> float:
    """The greatest difference of displacements that both have."""
    return max(float(abs(a - b).max()) for a, b in zip(one, other, strict=True) if a is not None)
