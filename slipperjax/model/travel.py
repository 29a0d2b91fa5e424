"""Travel: how fast the slipper moves along the rail, at one place of its run."""

from typing import Any, NamedTuple


class Travel(NamedTuple):
    """Speed, and length of a forcing period, at a time given in forcing periods since the start."""

    speed: Any
    """Travelling speed [m/s]."""
    wavelength: Any
    """Distance that counts as a forcing period [m]."""

    @property
    def period(self) -> Any:
        """Time that a forcing period takes at this speed [s]."""
        return self.wavelength / self.speed
