"""The rail-head section: contact points, the flat faces they bound, face normals and the play per face."""

import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..tools.checks import finite, not_negative, require, shown_number, warn, warn_unless_within
from ..tools.fields import ShapeChecked, field
from ..tools.tracing import is_traced
from ..tools.types import AnyArray

_FACES = (("J", "A"), ("B", "C"), ("D", "E"), ("F", "G"), ("H", "I"))


class Section(ShapeChecked):
    """A rail-head section: points, and the faces between pairs of them.

    Both corners of a face have the face's normal, which points out of the rail head. The two corners of a face are
    named clockwise in the view with y to the right and z up, so that the normal points to the left of the direction
    from the first corner to the second.
    """

    points: Float[Array, "points 2"] = field("m", finite)
    """y and z of the slipper's contact points [m] in the slipper's frame, whose origin is its centre of mass."""
    play: Float[Array, " faces"] = field("m", not_negative, shown_unit="mm")
    """Gap at each face when slipper and rail are centred [m]."""
    names: tuple[str, ...] = eqx.field(static=True, default=tuple("ABCDEFGHIJ"))
    """Names of the points, of letters, digits, _ and -."""
    faces: tuple[tuple[str, str], ...] = eqx.field(static=True, default=_FACES)
    """Names of the corners of each face."""

    def __repr__(self) -> str:
        names = " ".join(self.names)
        faces = " ".join("-".join(face) for face in self.faces)
        play = shown_number(self.play)
        # play that is the same for all faces is shown once
        if not is_traced(self.play) and np.ptp(np.asarray(self.play)) == 0:
            play = shown_number(np.ravel(self.play)[0])
        return f"Section(points={names}, faces={faces}, play={play} m)"

    def __check_init__(self):
        is_word = lambda name: isinstance(name, str) and re.fullmatch(r"[\w-]+", name)
        plain = isinstance(self.names, tuple) and all(map(is_word, self.names))
        require(plain, "names", "be a tuple of names of letters, digits, _ and -", self.names)
        require(len(set(self.names)) == len(self.names), "names", "be a tuple of different names", self.names)
        pairs = isinstance(self.faces, tuple) and all(isinstance(f, tuple) and len(f) == 2 for f in self.faces)
        # each point may be the corner of only one face
        corners = [corner for face in self.faces for corner in face] if pairs else []
        different = pairs and len(set(corners)) == len(corners)
        require(different, "faces", "be a tuple of pairs of different points", self.faces)
        require(set(corners) <= set(self.names), "faces", "name points", self.faces)
        count = len(self.faces)
        require(
            self.play.shape[-1:] == (count,),
            "play",
            f"have one value per face, {count}",
            shown=f"shape {self.play.shape}",
        )
        require(
            self.points.shape[:1] == (len(self.names),) == (2 * count,),
            "points",
            "have two points per face and one per name",
            shown=f"shape {self.points.shape} with {count} faces and {len(self.names)} names",
        )
        if not is_traced(self.points) and self.points.shape[1:] == (2,):
            self._check_points()

    def _check_points(self):
        points = np.asarray(self.points)
        warn_unless_within("points", np.max(np.abs(points)), 2e-3, 2.0, "m")
        low = np.min(points, axis=0)
        high = np.max(points, axis=0)
        if np.all(low < high) and np.any((low > 0) | (high < 0)):  # a single face encloses nothing
            warn("Argument `points` has its origin, the slipper's centre of mass, outside of the section.")
        start, end = points[self._corners]
        along = end - start
        if np.any(np.all(along == 0, axis=1)):
            raise ValueError("Argument `points` must have two different corners for each face, but two are equal.")
        # the gaps between faces in order are the faces of a list that begins one point later
        gaps = points[np.roll(self._corners.T.ravel(), -1).reshape(-1, 2).T]
        widths = lambda first, last: np.sum(np.linalg.norm(last - first, axis=1))
        late = widths(start, end) < widths(*gaps)
        if late and not _carries(points, start, end) and _carries(points, *gaps):
            warn(
                "Argument `points` has no face over its middle that can carry the weight, but a gap between faces "
                "could. Does the list of corners begin one corner late?"
            )
        # area around the centre between the faces, positive where their normals point away from the centre
        out = (start + end) / 2 - points.mean(axis=0)
        area = float(np.sum(along[:, 0] * out[:, 1] - along[:, 1] * out[:, 0]))
        if area < -1e-6 * float(np.ptp(points)) ** 2:
            raise ValueError(
                f"Argument `points` must be in an order in which the faces' normals point out of the rail head "
                f"(each face's corners clockwise, y to the right, z up), but they point inwards around {-area:g} m^2."
            )

    @property
    def _corners(self) -> np.ndarray:
        """Indices of the first and of the second corner of each face, shape (2, faces)."""
        return np.array([[self.names.index(corner) for corner in face] for face in self.faces]).T

    @property
    def face_of_point(self) -> np.ndarray:
        """Index of each point's face, shape (points,)."""
        return np.array([[name in face for face in self.faces].index(True) for name in self.names])

    @property
    def directions(self) -> Int[AnyArray, "*cases faces"]:
        """Direction of each face: 0 where its normal is nearer to the lateral axis, 1 nearer to the vertical axis."""
        start, end = self._corners
        xp = jnp if is_traced(self.points) else np
        along = xp.asarray(self.points)[..., end, :] - xp.asarray(self.points)[..., start, :]
        # the normal is perpendicular to the way from corner to corner
        return xp.argmin(abs(along), axis=-1)

    @property
    def widths(self) -> Float[Array, " faces"]:
        """Width of each face [m]."""
        start, end = self._corners
        return jnp.linalg.norm(self.points[end] - self.points[start], axis=1)

    @property
    def normals(self) -> Float[Array, "points 2"]:
        """Unit normal (y, z) at each point, out of the rail head [1]."""
        # the normal is to the left of the way from the first to the second corner
        start, end = self._corners
        along = self.points[end] - self.points[start]
        normal = jnp.stack([-along[:, 1], along[:, 0]], axis=1)
        normal = normal / jnp.linalg.norm(normal, axis=1, keepdims=True)
        return normal[self.face_of_point]

    @property
    def track_points(self) -> Float[Array, "points 2"]:
        """The matching points on the rail head, in the track node's frame [m]: w_T = w_S - play n0."""
        # when centred, slipper and rail are apart by the play along the normal
        return self.points - self.play[self.face_of_point][:, None] * self.normals


def _carries(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> bool:
    """Return whether one of some faces, given by their corners, faces up over the middle of the section."""
    middle = (points[:, 0].min() + points[:, 0].max()) / 2
    along = end - start
    over = (np.minimum(start, end)[:, 0] <= middle) & (middle <= np.maximum(start, end)[:, 0])
    # clockwise, a face that faces up leads to the right, within 60 degrees
    return bool(np.any(over & (along[:, 0] > 0.5 * np.hypot(*along.T))))
