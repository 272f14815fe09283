"""The walks of the demo: a leader and a follower in the synthetic office."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from client_sim.plan import FloorPlan
from client_sim.synthetic.office import build_office
from client_sim.synthetic.outlines import outlines
from client_sim.synthetic.recordings import Recording, Role, Span, WalkPlan, plan_recording
from client_sim.synthetic.venue import Building
from client_sim.synthetic.walk_folders import write_recording

ROUTE = (
    (11.4, 2.7, 0.0),
    (18.9, 2.7, 0.0),
    (18.9, 13.5, 0.0),
    (11.8, 13.5, 0.0),
    (11.8, 11.3, 0.0),
)
"""Along two corridors and through the open office to its books: 28 m, three turns."""

START, DESTINATION = "Room 0.02", "Books"

COVERED = Span(8.0, 10.0)
"""When somebody's thumb is on the follower's lens."""

EYE_LEVEL = 1.2
"""Height above the floor at which the plan cuts the walls."""


def _office() -> Building:
    building = build_office()
    return replace(building, routes={"demo": ROUTE})


@dataclass(frozen=True)
class DemoWalks:
    """Both walks, planned; filming takes a while each.

    Attributes:
        seed: of the follower; the leader has its own.
    """

    seed: int = 5
    building: Building = field(default_factory=_office, repr=False)

    @property
    def leader(self) -> Recording:
        """Somebody who knows the way, alone."""
        return plan_recording(self.building, "demo", WalkPlan(seed=1))

    @property
    def follower(self) -> Recording:
        """With another phone, past two people, once with a thumb on the lens."""
        plan = WalkPlan(Role.FOLLOWER, self.seed, speed=1.2, people=2, covered=(COVERED,))
        return plan_recording(self.building, "demo", plan)

    def film(self, role: Role, folder: Path, on_progress: Callable[[float], None]) -> Path:
        """Write one walk's folder below ``folder`` and return it.

        Raises:
            OSError: a file cannot be written.
        """
        walk = folder / role.value
        write_recording(walk, self.leader if role is Role.LEADER else self.follower, on_progress)
        return walk

    def plan(self) -> FloorPlan:
        """The walls of the storey, and where the leader walks."""
        walls = outlines(self.building.world, ROUTE[0][2] + EYE_LEVEL, movable=False)
        motion = self.leader.motion
        return FloorPlan(walls, motion.times, motion.position)

    def measured_length(self) -> float:
        """What a tape measure along the leader's way says, metres to a decimetre."""
        return round(self.leader.motion.length, 1)
