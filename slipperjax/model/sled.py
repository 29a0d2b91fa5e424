"""A sled: a body on several slippers, rigid or with elastic modes."""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, instance, not_negative, positive, require, tuple_of
from ..tools.fields import ShapeChecked, field
from ..tools.tracing import is_traced
from .modes import Modes
from .section import Section
from .slipper import AbstractBody, Mounted, check_inertia


class Mount(ShapeChecked):
    """A slipper's place on a sled, from the sled's centre of mass to the slipper's middle."""

    x: Float[Array, ""] | None = field("m", finite, plausible=(-50.0, 50.0), default=None)
    """Place along the track, positive forwards [m]; None: zero."""
    y: Float[Array, ""] | None = field("m", finite, plausible=(-5.0, 5.0), default=None)
    """Place across the track, positive to the left [m]; None: zero."""
    z: Float[Array, ""] | None = field("m", finite, plausible=(-5.0, 5.0), default=None)
    """Place upwards [m]; None: zero."""
    rail: str = eqx.field(static=True, default="")
    """Name of the mount's rail: "left" or "right" of `TwoRails`; any other track serves as every rail."""
    section: Section | None = None
    """Section of the slipper, with the slipper's middle as its origin; None: the section of the scene."""
    length: Float[Array, ""] | None = field("m", positive, plausible=(0.005, 20.0), default=None)
    """Distance between the slipper's front and rear section [m]; None: the length of the sled's slippers."""
    play: Float[Array, " faces"] | None = field("m", not_negative, default=None, shown_unit="mm")
    """Play of each face, in place of the section's play [m]."""
    name: str = eqx.field(static=True, default="")
    """Name in results; empty: the rail's name with a number, as "left1", or "slipper1" without a rail."""

    def __repr__(self) -> str:
        return super().__repr__().replace(", name=''", "").replace(", rail=''", "").replace("(rail=''", "(")

    def __check_init__(self):
        for name in ("rail", "name"):
            text = getattr(self, name)
            # in paths of parameters a number is a mount's place
            need = "be a word of letters, digits and _, the first no digit"
            require(isinstance(text, str) and (not text or text.isidentifier()), name, need, text)
        if self.section is not None:
            instance("section", self.section, Section, "a slipperjax.Section")


class Sled(AbstractBody):
    """A sled on slippers that move with it, such as three on a monorail or four on two rails.

    ```python
    corners = [(1.2, 0.9, "left"), (-1.2, 0.9, "left"), (1.2, -0.9, "right"), (-1.2, -0.9, "right")]
    mounts = [sj.Mount(x, y, -0.2, rail=rail) for x, y, rail in corners]
    sled = sj.Sled(mass=400.0, inertia=(150.0, 300.0, 350.0), mounts=mounts)
    ```

    When the scene has travelled a distance, the sled's centre of mass is half a slipper's `length` behind this
    distance. Therefore a slipper in the sled's middle begins at this distance, like a `Slipper`.
    """

    mass: Float[Array, ""] = field("kg", positive, plausible=(0.1, 1e6), symbol="m")
    """Mass, slippers included [kg]."""
    inertia: Float[Array, "3"] = field("kg m^2", positive, plausible=(1e-9, 1e7), symbol="J")
    """Principal moments of inertia about x, y and z of the sled's frame [kg m^2]."""
    mounts: tuple[Mount, ...] = eqx.field(  # pyright: ignore[reportGeneralTypeIssues]
        converter=lambda mounts: tuple_of("mounts", mounts, Mount, "a list of slipperjax.Mount(...)")
    )
    """Its slippers."""
    length: Float[Array, ""] = field("m", positive, plausible=(0.005, 20.0), symbol="L", default=0.2)
    """Distance between the front and the rear section of slippers without a length of their own [m]."""
    modes: Modes | None = None  # pyright: ignore[reportIncompatibleVariableOverride, reportAssignmentType]
    """Elastic modes; None for a rigid sled."""

    def __check_init__(self):
        names = self.names
        require(names, "mounts", "be one slipperjax.Mount(...) or more", self.mounts)
        require(len(set(names)) == len(names), "mounts", "have different names", names)
        if self.modes is not None:
            instance("modes", self.modes, Modes, "slipperjax.model.Modes(...)")
            count = self.modes.shapes.shape[-2]
            need = f"have shapes at each of the {len(names)} mounts"
            require(count == len(names), "modes", need, shown=f"shapes at {count}")
        if is_traced(self):
            return
        if self.modes is not None:
            self.modes.warn_of_scale(float(self.mass))
        # the distance between the outermost ends of the slippers
        ends = np.array([(x - length / 2, x + length / 2) for x, length in map(self._along, self.mounts)])
        across = [0.0 if mount.y is None else float(mount.y) for mount in self.mounts]
        check_inertia(self, max(float(np.ptp(ends)), float(np.ptp(across))), "sled lengths")
        for (one, a), (other, b) in itertools.combinations(zip(self.mounts, ends, strict=True), 2):
            apart = one.rail != other.rail or a[0] >= b[1] or b[0] >= a[1]
            both = f"{names[self.mounts.index(one)]} and {names[self.mounts.index(other)]}"
            require(apart, "mounts", "not overlap on a rail", shown=f"{both}, which do")

    def __repr__(self) -> str:
        head = super().__repr__().split(", mounts=")[0]
        modes = "" if self.modes is None else f", modes={self.modes!r}"
        return f"{head}, mounts={list(self.mounts)!r}, length={float(self.length):g} m{modes})"

    def _along(self, mount: Mount) -> tuple[float, float]:
        """Return a mount's place along the track and its length [m]."""
        length = self.length if mount.length is None else mount.length
        return 0.0 if mount.x is None else float(mount.x), float(length)

    @property
    def names(self):
        """Names of the mounts, in their order."""
        counts: dict[str, int] = {}
        names = []
        for mount in self.mounts:
            counts[mount.rail] = counts.get(mount.rail, 0) + 1
            names.append(mount.name or f"{mount.rail or 'slipper'}{counts[mount.rail]}")
        return tuple(names)

    @property
    def static_shares(self):
        """Shares of the slippers in the sled's weight [1], on level rails whose contacts are alike.

        Of all forces in balance, the least squares, as with equal springs; for two slippers in line, or three, only
        one solution is in balance.
        """
        places = jnp.array([[0.0 if place is None else place for place in (m.x, m.y)] for m in self.mounts])
        middle = jnp.mean(places, axis=0)
        x, y = (places - middle[None]).T
        xx, xy, yy = x @ x, x @ y, y @ y
        # shares are a plane over the places, or a line for slippers in line, so that the force has no moment about
        # the centre of mass. Without LAPACK, which two threads must not call at the same time.
        trace = xx + yy
        plane = xx * yy - xy * xy
        in_line = plane <= 1e-12 * trace * trace
        line = jnp.where(trace > 0, trace * trace, 1.0)
        inverse = jnp.where(
            in_line,
            jnp.array([[xx, xy], [xy, yy]]) / line,
            jnp.array([[yy, -xy], [-xy, xx]]) / jnp.where(in_line, 1.0, plane),
        )
        return 1 / len(self.mounts) - jnp.stack([x, y], axis=1) @ (inverse @ middle)

    def mounted(self, section):
        slippers = []
        for mount in self.mounts:
            length = self.length
            ahead = mount.x
            if mount.length is not None:
                length = mount.length
                longer = (mount.length - self.length) / 2
                ahead = longer if ahead is None else ahead + longer
            own = mount.section or section
            if mount.play is not None:
                own = eqx.tree_at(lambda section: section.play, own, mount.play)
            slippers.append(Mounted((mount.x, mount.y, mount.z), length, own, mount.rail, ahead))
        return tuple(slippers)


class Cut(ShapeChecked):
    """A plane across a sled, with the mass in front of it, for the loads between both parts of the sled."""

    x: Float[Array, ""] = field("m", finite)
    """Place of the plane along the track, from the sled's centre of mass [m]."""
    mass: Float[Array, ""] = field("kg", positive)
    """Mass in front of the plane, slippers included [kg]."""
    centre: Float[Array, "3"] = field("m", finite)
    """Centre of this mass, from the sled's centre of mass [m]."""
    inertia: Float[Array, "3"] = field("kg m^2", positive)
    """Moments of inertia of this mass about axes along x, y and z through its centre [kg m^2]."""
    name: str = eqx.field(static=True, default="")
    """Name in results; empty: "cut1", "cut2" and so on."""
