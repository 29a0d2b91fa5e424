"""Elastic modes of a free sled: from finite elements, or of a beam in closed form."""

import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, not_negative, number, positive, require, whole
from ..tools.compile import is_traced
from ..tools.fields import ShapeChecked, field
from ..tools.types import Numbers, Real


class Modes(ShapeChecked):
    """Elastic modes of the free sled, each a damped oscillator that the contacts drive.

    A mode with the coordinate q [m kg^0.5] moves the sled by its shape times q, and

        q'' + 2 damping (2 pi frequency) q' + (2 pi frequency)^2 q = sum over contact points of (shape . n) F.

    Shapes are those of a free body, so that rigid motions and modes are orthogonal, with a modal mass of one.
    """

    frequency: Float[Array, " modes"] = field("Hz", positive, plausible=(0.1, 1e5))
    """Natural frequencies, from the lowest to the highest [Hz]."""
    damping: Float[Array, " modes"] = field("", not_negative, plausible=(0.0, 0.5))
    """Damping ratios [1]."""
    shapes: Float[Array, "modes mounts 3"] = field("kg^-0.5", finite)
    """Displacements of the mounts along x, y and z, of unit modal mass [kg^-0.5]."""
    places: Float[Array, "places 3"] | None = field("m", finite, default=None)
    """Places besides the mounts where shapes are known, such as a payload's, from the centre of mass [m]."""
    place_shapes: Float[Array, "modes places 3"] | None = field("kg^-0.5", finite, default=None)
    """Displacements of the places [kg^-0.5]."""

    @classmethod
    def beam(
        cls,
        places_of_mounts: Numbers,
        *,
        mass: Real,
        length: Real,
        stiffness: Numbers,
        count: int = 3,
        damping: Numbers = 0.01,
        places: Numbers | None = None,
    ) -> "Modes":
        """Return the lowest bending modes of a uniform free beam along the sled, with its middle at the centre of
        mass: Euler and Bernoulli's closed form.

        **Arguments:** `places_of_mounts`: x of each mount [m]; `mass` [kg] and `length` [m] of the beam;
        `stiffness`: of lateral and of vertical bending, E I [N m^2], or one number for both; `count`: of modes of
        both directions together; `damping`: ratios [1]; `places`: other places where shapes are wanted, (places, 3)
        [m].

        **Raises:** `ValueError` for places beyond the ends of the beam, and other numbers out of range.
        """
        mass, length = (number(positive, *given) for given in (("mass", mass, "kg"), ("length", length, "m")))
        whole("count", count, 1, 100)
        bending = np.broadcast_to(np.asarray(positive("stiffness", "N m^2")(stiffness)), (2,))
        along = np.asarray(finite("places_of_mounts", "m")(places_of_mounts))
        others = np.zeros((0, 3)) if places is None else np.asarray(finite("places", "m")(places)).reshape(-1, 3)
        x = np.append(along, others[:, 0])
        need = f"lie on the beam, within {length / 2:g} m of its middle"
        require(np.all(np.abs(x) <= length / 2), "places_of_mounts", need, x)
        found = []
        for k in range(1, count + 1):
            root = _free_root(k)
            shape = _free_shape(root, k % 2 == 1, x / length) / np.sqrt(mass)
            for axis, stiff in zip((1, 2), bending, strict=True):
                frequency = root**2 / (2 * np.pi * length**2) * np.sqrt(stiff * length / mass)
                found.append((frequency, np.eye(3)[axis] * shape[:, None]))
        found = sorted(found, key=lambda mode: mode[0])[:count]
        shapes = np.stack([shape for _, shape in found])
        return cls(
            frequency=np.array([frequency for frequency, _ in found]),
            damping=np.broadcast_to(np.asarray(damping, float), (count,)),
            shapes=shapes[:, : len(along)],
            places=None if places is None else others,
            place_shapes=None if places is None else shapes[:, len(along) :],
        )

    @property
    def count(self) -> int:
        """Number of modes."""
        return self.frequency.shape[-1]

    def __check_init__(self):
        count = self.frequency.shape[-1:]
        require(self.damping.shape[-1:] == count, "damping", f"have one value per mode, {count}", self.damping)
        of_modes = self.shapes.shape[-3:-2]
        require(of_modes == count, "shapes", f"have one row per mode, {count}", shown=f"shape {self.shapes.shape}")
        both = (self.places is None) == (self.place_shapes is None)
        require(both, "place_shapes", "be given together with `places`", self.place_shapes)
        if self.places is not None and self.place_shapes is not None:
            shape = (*count, self.places.shape[-2], 3)
            shown = self.place_shapes.shape
            require(shown[-3:] == shape, "place_shapes", f"be of shape {shape}", shown=f"of shape {shown}")
        if not is_traced(self.frequency):
            rises = np.all(np.diff(np.asarray(self.frequency)) >= 0)
            require(rises, "frequency", "rise from mode to mode", np.asarray(self.frequency))


def _free_root(k: int) -> float:
    """Return the k-th root of cos(x) cosh(x) = 1 above zero, of a beam with free ends [1]."""
    x = (k + 0.5) * np.pi
    # the second one is exact to the last bit already
    for _ in range(10):
        x -= (np.cos(x) - 1 / np.cosh(x)) / (np.tanh(x) / np.cosh(x) - np.sin(x))
    return float(x)


def _free_shape(root: float, even: bool, s: np.ndarray) -> np.ndarray:
    """Return the shape of a free beam's mode, with a mean square of one, at places from -1/2 to 1/2 of its length."""
    x = root * s
    # hyperbolic functions over that at the end, which alone would overflow
    grown = np.exp(np.abs(x) - root / 2)
    decayed = np.exp(-np.abs(x) - root / 2)
    end = np.exp(-root)
    if even:
        return np.cos(x) / np.cos(root / 2) + (grown + decayed) / (1 + end)
    return np.sin(x) / np.sin(root / 2) + np.sign(x) * (grown - decayed) / (1 - end)
