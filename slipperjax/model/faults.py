"""Faults of rails: dips, steps and joints at single places, as a scene's file lists them."""

import functools

import equinox as eqx
from jaxtyping import Array, Float

from ..tools.checks import finite, instance, one_of, positive, require, tuple_of
from ..tools.fields import field
from .tracks import SHAPES, AbstractLocalTrack, AbstractSum, AbstractTrack, StraightTrack, SumTrack, TwoRails


class Fault(AbstractLocalTrack):
    """One fault of a rail, see `FaultyTrack`."""

    at: Float[Array, ""] = field("m", finite)
    """Distance of its middle [m], in a file also a station such as 8+00."""
    height: Float[Array, ""] = field("m", finite, shown_unit="mm")
    """Displacement in the middle, for a step its height [m]; negative downwards, or to the right."""
    length: Float[Array, ""] = field("m", positive)
    """Length from end to end [m]."""
    kind: str = eqx.field(static=True, default="dip")
    """"dip", "step" or "joint"."""
    direction: str = eqx.field(static=True, default="vertical")
    """"lateral" or "vertical"."""
    name: str = eqx.field(static=True, default="")
    """Name in paths such as track.faults.joint 7.height, without points; empty: its number."""

    def __check_init__(self):
        one_of("kind", self.kind, tuple(SHAPES))
        require("." not in self.name, "name", "have no points, which separate the words of a path", self.name)

    @property
    def place(self):
        return self.at

    @property
    def shape(self):
        return self.kind


class FaultyTrack(AbstractSum):
    """A track with faults, whose numbers are parameters: track.faults.0.height, track.left.faults.0.at.

    ```python
    track = sj.model.FaultyTrack(survey, [sj.model.Fault(at=20.0, height=-1e-3, length=0.5, kind="joint")])
    ```
    """

    one: AbstractTrack
    """The track without faults, which defines the forcing period."""
    faults: tuple[Fault, ...] = eqx.field(
        converter=lambda faults: tuple_of("faults", faults, Fault, "a list of slipperjax.model.Fault(...)"),
        default=(),
    )
    """Faults of the rail, or of both rails."""
    left: AbstractTrack | None = None
    """Faults of the left rail alone, such as a `FaultyTrack` on a `StraightTrack`; None: it has no more faults."""
    right: AbstractTrack | None = None
    """Faults of the right rail alone."""

    def __check_init__(self):
        straight = StraightTrack()
        for name, track in {"one": self.one, "left": self.left or straight, "right": self.right or straight}.items():
            instance(name, track, AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)")
        require(len(set(self.names)) == len(self.names), "faults", "have different names", self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the faults in paths, for those without a name their number; empty where none has a name."""
        if not any(fault.name for fault in self.faults):
            return ()
        return tuple(fault.name or str(k) for k, fault in enumerate(self.faults))

    @property
    def other(self):
        straight = StraightTrack()
        faults = functools.reduce(SumTrack, self.faults, straight)
        if not self.one.rails:
            return faults
        return SumTrack(faults, TwoRails(self.left or straight, self.right or straight))
