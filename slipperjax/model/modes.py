"""Elastic modes of a free sled: from finite elements, or for a beam in closed form."""

import io
from collections.abc import Sequence, Set
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, not_negative, number, positive, require, tuple_of, warn, whole
from ..tools.fields import ShapeChecked, field
from ..tools.files import content_of, listed, readable, user_path
from ..tools.tables import Table, TableError
from ..tools.tracing import is_traced
from ..tools.types import AnyArray, Numbers, Real

MASS = "modal_mass"
"""Name of modal masses in files."""
LARGEST = 30.0
"""Square of a shape with unit modal mass, times the mass of the body, above which the shape is implausible [1]."""


class Modes(ShapeChecked):
    """Elastic modes of a free sled, each a damped oscillator that the contacts drive.

    A mode with the coordinate q [m kg^0.5] moves the sled by its shape times q, and

        q'' + 2 damping (2 pi frequency) q' + (2 pi frequency)^2 q = sum over contact points of (shape . n) F.

    Shapes belong to a free body, so that rigid motions and modes are orthogonal, with a modal mass of one.
    """

    frequency: Float[Array, " modes"] = field("Hz", positive, plausible=(0.1, 1e5))
    """Natural frequencies, from the lowest to the highest [Hz]."""
    damping: Float[Array, " modes"] = field("", not_negative, plausible=(0.0, 0.5))
    """Damping ratios [1]."""
    shapes: Float[Array, "modes mounts axes"] = field("kg^-0.5", finite)
    """Displacements of the mounts along x, y and z, or along y and z only, with unit modal mass [kg^-0.5]."""
    places: Float[Array, "places 3"] | None = field("m", finite, default=None)
    """Places other than mounts where shapes are known, such as a payload, from the centre of mass [m]."""
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
        mass, from Euler and Bernoulli's closed form.

        **Arguments:** `places_of_mounts`: x of each mount [m]; `mass` [kg] and `length` [m] of the beam;
        `stiffness`: of lateral and of vertical bending, E I [N m^2], or one number for both; `count`: number of
        modes, both directions together; `damping`: ratios [1]; `places`: other places where shapes are needed,
        (places, 3) [m].

        **Raises:** `ValueError` for places beyond the ends of the beam, and other numbers out of range.
        """
        mass = number(positive, "mass", mass, "kg")
        length = number(positive, "length", length, "m")
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
            damping=np.broadcast_to(np.asarray(not_negative("damping")(damping)), (count,)),
            shapes=shapes[:, : len(along), 1:],
            places=None if places is None else others,
            place_shapes=None if places is None else shapes[:, len(along) :],
        )

    @property
    def count(self) -> int:
        """Number of modes."""
        return self.frequency.shape[-1]

    def warn_of_scale(self, mass: float) -> None:
        """Warn of shapes that are too large for unit modal mass, for a body of some mass [kg]."""
        if is_traced(self.shapes):
            return
        # a uniform free beam has 4, at its ends
        ratio = float(np.max(np.asarray(self.shapes) ** 2, initial=0.0)) * mass
        if ratio > LARGEST:
            warn(
                f"Argument `modes` has shapes whose square times the sled's mass is {ratio:.3g}; plausible is up to "
                f"{LARGEST:g}. Are they of unit modal mass, and not of largest value 1? Divide them by the root of "
                "the modal mass, or give load_modes a column `modal mass [kg]`."
            )

    def check_place(self, place: AnyArray) -> None:
        """Raise `ValueError` unless a place is one of the modes' `places` [m]."""
        need = "be places of the modes, see slipperjax.model.Modes"
        require(self.places is not None, "places", need, place)
        apart = np.linalg.norm(np.asarray(self.places) - np.asarray(place), axis=1).min()
        # a place within a millimetre is the same place
        require(apart < 1e-3, "places", f"{need}, the nearest is {apart:.3g} m away", place)

    def shape_at(self, place: AnyArray) -> Float[Array, "modes 3"]:
        """Return the shapes at that of the `places` which is nearest to a place [kg^-0.5]."""
        assert self.places is not None  # see `check_place`
        assert self.place_shapes is not None
        return self.place_shapes[:, jnp.argmin(jnp.sum((self.places - jnp.asarray(place)[None]) ** 2, axis=1))]

    def __check_init__(self):
        count = self.frequency.shape[-1:]
        require(self.damping.shape[-1:] == count, "damping", f"have one value per mode, {count}", self.damping)
        of_modes = self.shapes.shape[-3:-2]
        shown = f"shape {self.shapes.shape}"
        require(of_modes == count, "shapes", f"have one row per mode, {count}", shown=shown)
        require(self.shapes.shape[-1] in (2, 3), "shapes", "be along y and z, or x, y and z", shown=shown)
        both = (self.places is None) == (self.place_shapes is None)
        require(both, "place_shapes", "be given together with `places`", self.place_shapes)
        if self.places is not None and self.place_shapes is not None:
            shape = (*count, self.places.shape[-2], 3)
            shown = self.place_shapes.shape
            require(shown[-3:] == shape, "place_shapes", f"be of shape {shape}", shown=f"of shape {shown}")
        if not is_traced(self.frequency):
            rises = np.all(np.diff(np.asarray(self.frequency)) >= 0)
            require(rises, "frequency", "rise from mode to mode", np.asarray(self.frequency))


def load_modes(file: str | Path, mounts: Sequence[str] | None = None) -> Modes:
    """Read the elastic modes of a free sled, as finite-element programs write them.

    A CSV file has a line of names, `frequency [Hz], damping, left1 x, left1 y, left1 z, right1 x, ...`, with the
    names of the mounts, and a line for each mode. An npz file of NumPy has arrays `frequency` [Hz], `damping` and
    `shapes` (modes, mounts, 3), optionally the names `mounts`, and `places` [m] with `place_shapes`, as in `Modes`.
    Shapes have a modal mass of one [kg^-0.5], in a CSV file also with another unit, as in `left1 x [t^-0.5]`. Shapes
    of other modal masses, such as shapes with a largest value of 1, need a column `modal mass [kg]` or an array
    `modal_mass`. A universal file, .unv, has normal modes in datasets 55 with masses in kg; its mounts are numbers of
    nodes. All shapes along x may be left out, which saves time where modes hardly move the slippers along the rail.

    **Arguments:** `file`: its path; `mounts`: names of the sled's mounts in their order, as `sled.names`; None for
    the mounts in the file's order.

    **Raises:** `ValueError` with all faults of the file: missing names, numbers or shapes, and frequencies that
    decrease; `OSError` for a file that cannot be read.
    """
    path = user_path(file, "file")
    content = content_of(path)
    if mounts is not None:
        mounts = tuple_of("mounts", mounts, str, "a list of names")
    read = _of_arrays if content.startswith(b"PK\x03\x04") else _of_table
    if path.suffix.lower() in (".unv", ".uff"):
        read = _of_universal
    try:
        return Modes(**_of_unit_mass(read(path, content, mounts)))
    except TableError:
        raise
    except ValueError as error:
        # an error for a file that is no npz file names the file
        where = "" if str(error).startswith(str(path)) else f"{path}: "
        raise TableError(f"{where}{error}") from None


def _of_arrays(path: Path, content: bytes, mounts: Sequence[str] | None) -> dict[str, Any]:
    """Return those arrays of an npz file that modes have, with the shapes at `mounts` in their order."""
    with readable(path, "npz file"), np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        names = ("frequency", "damping", MASS, "shapes", "mounts", "places", "place_shapes")
        found = {name: arrays[name] for name in names if name in arrays}
    absent = [name for name in ("frequency", "damping", "shapes") if name not in found]
    require(not absent, "file", "have arrays frequency, damping and shapes", shown=f"no {listed(absent)}")
    return _in_order(found, mounts)


def _of_universal(path: Path, content: bytes, mounts: Sequence[str] | None) -> dict[str, Any]:
    """Return the normal modes of a universal file, its datasets 55, at the nodes whose numbers `mounts` has."""
    try:
        import pyuff  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise TableError(f"{path}: universal files need pyuff: pip install slipperjax[modes].") from None
    with readable(path, "universal file"):
        sets = pyuff.UFF(str(path)).read_sets()
        sets = [sets] if isinstance(sets, dict) else sets
        # the first three of six numbers of a node are its displacement
        modes = [one for one in sets if one["type"] == 55 and one["analysis_type"] == 2]
        nodes = {tuple(map(int, one["node_nums"])) for one in modes}
        numbers = {"frequency": "freq", "damping": "modal_damp_vis", MASS: "modal_m"}
        found = {name: np.array([one[key] for one in modes]) for name, key in numbers.items()}
        shapes = [np.stack([one[f"r{axis}"] for axis in (1, 2, 3)], axis=-1).real for one in modes]
    require(len(nodes) == 1, "file", "have normal modes at the same nodes, datasets 55", shown=f"{len(nodes)} kinds")
    return _in_order(found | {"shapes": np.stack(shapes), "mounts": np.array(nodes.pop())}, mounts)


def _in_order(found: dict[str, Any], mounts: Sequence[str] | None) -> dict[str, Any]:
    """Return the arrays of modes with their shapes at `mounts`, in their order."""
    of_file = found.pop("mounts", None)
    if mounts is None:
        return found
    order = list(mounts) if of_file is None else [str(name) for name in of_file]
    absent = [name for name in mounts if name not in order]
    require(not absent, "shapes", f"have those at {listed(absent)}", shown=f"those at {listed(order)}")
    shown = found["shapes"].shape
    fits = len(shown) == 3 and shown[1] == len(order)
    require(fits, "shapes", f"be of shape (modes, {len(order)}, 3)", shown=f"of shape {shown}")
    return found | {"shapes": found["shapes"][:, [order.index(name) for name in mounts]]}


def _of_table(path: Path, content: bytes, mounts: Sequence[str] | None) -> dict[str, np.ndarray]:
    """Return the columns of a table of modes as the fields of `Modes`."""
    own = {"frequency": "Hz", "damping": "", MASS: "kg"}

    def wanted(names: Set[str]) -> dict[str, str]:
        found = [name[:-2] for name in names if name[-2:] in ("_x", "_y", "_z")]
        shapes = [f"{name}_{axis}".lower() for name in (mounts or found) for axis in "xyz"]
        return own | dict.fromkeys(shapes, "")

    table = Table(path, content, wanted, {})
    # modal masses are one kilogram where the file gives none
    table.wanted = {name: own.get(name, "kg^-0.5") for name in table.wanted}
    # without names of mounts, the file's mounts in its order
    mounts = mounts or list(dict.fromkeys(name[:-2] for name in table.columns if name not in own))
    # without any x, shapes have only y and z
    axes = "xyz" if any(name.endswith("_x") for name in table.columns) else "yz"
    columns = {name: [f"{name}_{axis}".lower() for axis in axes] for name in mounts}
    for name in ("frequency", "damping"):
        if name not in table.columns:
            table.fault(f"must have a column {name}")
    absent = [name for name, of_mount in columns.items() if not table.columns.keys() >= set(of_mount)]
    if absent or not columns:
        table.fault(f"must have the shapes {listed(list(axes))} of {listed(absent) or 'mounts'}, as in left1 y")
    if "frequency" in table.columns:
        values = table.columns["frequency"].values
        for k in np.flatnonzero(np.diff(values) < 0):
            table.fault(f"frequency {values[k + 1]:g} is below that of the mode before", table.numbers[k + 1])
    found = table.si()
    of_mounts = [np.stack([found[column] for column in of_mount], axis=-1) for of_mount in columns.values()]
    return {"shapes": np.stack(of_mounts, axis=1)} | {name: found[name] for name in own if name in found}


def _of_unit_mass(found: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of modes, with shapes of unit modal mass."""
    mass = found.pop(MASS, None)
    if mass is None:
        return found
    root = np.sqrt(np.asarray(positive(MASS, "kg")(mass)))
    need = f"have one value per mode, {len(found['frequency'])}"
    require(root.shape == np.shape(found["frequency"]), MASS, need, shown=f"shape {root.shape}")
    shapes = {name: found[name] / root[:, None, None] for name in ("shapes", "place_shapes") if name in found}
    return found | shapes


def _free_root(k: int) -> float:
    """Return the k-th positive root of cos(x) cosh(x) = 1, for a beam with free ends [1]."""
    x = (k + 0.5) * np.pi
    # already the second iterate is exact to the last bit
    for _ in range(10):
        x -= (np.cos(x) - 1 / np.cosh(x)) / (np.tanh(x) / np.cosh(x) - np.sin(x))
    return float(x)


def _free_shape(root: float, even: bool, s: np.ndarray) -> np.ndarray:
    """Return the shape of a free beam's mode, with a mean square of one, at places from -1/2 to 1/2 of its length."""
    x = root * s
    # hyperbolic functions divided by their value at the end, because they would overflow otherwise
    grown = np.exp(np.abs(x) - root / 2)
    decayed = np.exp(-np.abs(x) - root / 2)
    end = np.exp(-root)
    if even:
        return np.cos(x) / np.cos(root / 2) + (grown + decayed) / (1 + end)
    return np.sin(x) / np.sin(root / 2) + np.sign(x) * (grown - decayed) / (1 - end)
