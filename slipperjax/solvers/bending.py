"""The rails in a step of `ImpulseRK4`: rigid ones, or rails that bend."""

from jaxtyping import Array

from ..model.beam import RailState, RailStep, pressed
from ..model.dynamics import Args
from ..model.kinematics import Contacts, RailFrame, at_all_points, bent

Wrench = list[Array]
"""As of `slipperjax.model.dynamics.resultants`, for rails that bend with the forces on their nodes as the last."""


class RigidRails:
    """Rigid rails, which change nothing."""

    def halfway(self, frame: RailFrame, wrench: Wrench) -> RailFrame:
        """Return the frame in the middle of the step, after a constant wrench."""
        return frame

    def end(self, frame: RailFrame, mean: Wrench, early: Wrench) -> tuple[RailFrame, RailState | None]:
        """Return the frame and the rails at the end of the step.

        **Arguments:** `mean`, `early`: means of the wrench, the second times the part of the step that is left.
        """
        return frame, None

    def compliance(self, frame: RailFrame, own: Array) -> Array:
        """Return rates of the points along their normals by their forces in the step, from those of the body."""
        return own

    def moved(self, old: RailFrame, new: RailFrame, now: Contacts) -> Contacts:
        """Return contacts with the frame `new` in place of `old`, which has the same normals."""
        return now


class BendingRails(RigidRails):
    """Rails that bend. A stage feels the free rails and the forces of earlier stages.

    As in Cox and Matthews' exponential Runge-Kutta methods (2002, doi:10.1006/jcph.2002.6995), forces of stages are
    constant over half a step, and waves move exactly. The forces of the whole step act by their two means.
    """

    def __init__(self, step: RailStep, start: RailState):
        self.step = step
        self.free = step.free(start.waves)
        self.middle = step.halfway(start, self.free)

    def halfway(self, frame, wrench):
        return bent(frame, pressed(self.middle, (self.step.half, wrench[-1])))

    def end(self, frame, mean, early):
        rail = self.step.end(self.free, mean[-1], early[-1])
        return bent(frame, rail), rail

    def compliance(self, frame, own):
        # by the force at the point's own node
        y, z = at_all_points(frame, self.step.own)
        _, n_y, n_z = frame.normal
        return own + n_y * n_y * y + n_z * n_z * z

    def moved(self, old, new, now):
        return now._replace(
            gap=now.gap + old.position - new.position,
            rate=now.rate + old.velocity - new.velocity,
        )


def rails_in_step(args: Args, t, dt, start: RailState | None) -> RigidRails:
    """Return the rails in a step of `dt` around the time `t` [forcing periods]."""
    step = args.bending(t, dt)
    if step is None:
        return RigidRails()
    if start is None:
        raise ValueError("Argument `start` must be of a scene with a beam: take a Motion, or a run's end.")
    return BendingRails(step, start)
