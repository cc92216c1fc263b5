# SPDX-License-Identifier: Apache-2.0
"""The cost map: ground that the wheels have crossed, and expectations about the ground ahead.

    map = CostMap(CostSettings(), wheels)
    map.add(wheel, "odom", Pose(3.1, 0.2, 0.0), 17.4, Quantity(0.12, 0.02))
    grids = map.grids()
    grids.bare      # each cell its own cost: for readers that lay the vehicle's footprint over it
    grids.spread    # each cell the highest around it: for readers that check the cell under base_link alone

Its layers, from the lowest to the uppermost: expectations by terrain class; expectations where the
slope ahead is known; ground crossed on earlier drives; ground crossed on this one. The lower two
are predictions, 99 at most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.costmap.ahead import GroundAhead
from smallwheel_ros.costmap.cost import PASSABLE, CostSettings
from smallwheel_ros.costmap.crossed_ground import CrossedGround, Outline
from smallwheel_ros.costmap.elevation import Elevation
from smallwheel_ros.costmap.grid import HERE, HIGHEST, UNKNOWN, Grid, Pose, lay_over, union
from smallwheel_ros.costmap.own_track import OwnTrack
from smallwheel_ros.costmap.spread import Spreader, wide
from smallwheel_ros.costmap.terrain import REFERENCE_SLIP
from smallwheel_ros.physics.wheel import Quantity, Wheel

COST_PERIOD = 1.0  # s between two grids at least: planners plan anew about once a second
_SLOPE = math.tan(math.radians(5.0))  # of ground that nobody has seen
COST_TOPICS = ("cost_bare", "cost")  # below the node's name, of each grid of `CostGrids`


class CostGrids(NamedTuple):
    """The costs at one moment, as two grids of the same cells.

    Attributes
    ----------
    bare
        Each cell's own cost.
    spread
        The highest cost within `CostMap.spread` of each cell.
    """

    bare: Grid
    spread: Grid


class CostMap:
    """Costs of ground, from wheels' margins as they arrive.

    Parameters
    ----------
    settings
        Window and rules of the map.
    wheels
        All wheels of the vehicle, for its outline.
    prior
        Largest pull over load (1) to expect of any ground before driving; None if unknown.
    names
        Names of the terrain classes, in the order of their numbers.
    reference_slip
        Slip at which margins are defined, 1.

    Attributes
    ----------
    settings, outline
        The settings given, and the outline of the vehicle.
    free
        Cost up to which crossed ground counts as free, 0.
    spread
        Distance over which costs are spread, m.
    changed
        Whether there is something to publish: a cell has changed, or the vehicle has moved.
    frame
        Frame of the positions; empty while unknown.
    reference_slip
        Slip at which margins are defined, 1.
    ahead
        Expectations about ground that no wheel has been on.
    remembered
        Ground crossed on earlier drives.
    """

    def __init__(
        self,
        settings: CostSettings,
        wheels: Sequence[Wheel],
        prior: Quantity | None = None,
        names: Sequence[str] = (),
        reference_slip: float = REFERENCE_SLIP,
    ) -> None:
        self.settings = settings
        self.outline = Outline(wheels)
        # To the outermost corner, and in addition from a cell's middle to its corner.
        corner = self.outline.around + math.sqrt(0.5) * settings.resolution
        self.spread = corner if settings.spread is None else settings.spread
        self._spreader = Spreader(self.spread)
        self.free = 0.0
        if settings.free_below is not None:
            self.free = settings.free_below
        elif prior is not None:
            self.free = settings.rules.cost(prior.value - _SLOPE, prior.standard_deviation)
        self.changed = False
        self.reference_slip = reference_slip
        self.ahead = GroundAhead(settings, prior, names, reference_slip)
        self._ground = CrossedGround(settings.size, settings.resolution, self.outline.length)
        self.remembered: Grid | None = None
        self.frame = ""
        self._frames: dict[str, Pose] = {}  # of our frame in those above it
        self._pose: Pose | None = None
        self._given: Pose | None = None  # the pose at the last grid
        self._track = OwnTrack(settings.resolution)
        # The pose at the last grid if the vehicle then stood on ground that cannot be crossed.
        self._held: Pose | None = None

    def clear(self) -> None:
        """Forget all costs of crossed and remembered ground; keep the grids of ground ahead."""
        self._ground.clear()
        self.ahead.clear()
        self._pose = self._held = self.remembered = None
        self._track.clear()
        self.changed = True

    def add(
        self,
        wheel: Wheel,
        frame: str,
        pose: Pose,
        travel: float,
        margin: Quantity | None,
        *,
        stuck: bool = False,
        beyond: float = 0.0,
        risk: float = 0.0,
        slope: float = 0.0,
        demand: float = math.nan,
        shown: float = -math.inf,
        course: float = 0.0,
        measured: bool = True,
    ) -> None:
        """Write the cost of the ground that an axle has crossed since the last call for the same wheel.

        The cost follows from the vehicle's margin: its drawbar pull over its load. It is written at the
        wheel's axle over the whole width of the vehicle, and updates the terrain class under the wheel.

        Parameters
        ----------
        wheel
            The wheel whose axle has crossed the ground.
        frame
            Name of the frame of the pose. If it differs from the last one, all crossed ground is forgotten.
        pose
            Present pose of base_link in that frame.
        travel
            Distance that the vehicle has travelled since its start, m.
        margin
            Drawbar pull over load of the vehicle at the reference slip and on level ground, 1; None if
            unknown: then only `stuck` and `risk` count.
        stuck
            Whether the vehicle was seen to be stuck there, which costs 100 whatever the margin is. Otherwise
            the cost is 99 at most, since the vehicle does drive there.
        beyond
            Gain of the margin from the reference slip to the slip at which the vehicle no longer moves, 1.
        risk
            Probability of getting stuck according to the warning, 0 to 1; 0 without a warning. The cost is at
            least 100 times that, 99 at most, until the vehicle has got through.
        slope
            Tangent of the steepest slope of the ground there, 1.
        demand
            Pull over load that is required there in the direction of travel, 1, positive uphill. On the way
            back it helps by the same amount. NaN if unknown.
        shown
            Pull over load that the ground gave when it was crossed, 1: a lower limit of the margin there;
            minus infinity if there is none.
        course
            Angle of the direction of travel to the left of the heading, rad.
        measured
            Whether the margin was measured on that ground. If not, it is the expectation for any ground, and
            does not update a terrain class that has a prior of its own.
        """
        self._enter(frame)
        moved = self._ground.follow(pose.x, pose.y)
        given = self._given
        self.changed |= (
            moved
            or given is None
            or (math.dist(pose[:2], given[:2]) > 0.5 * self.settings.resolution)
        )
        cost = mark = UNKNOWN
        home = PASSABLE
        if margin is not None:
            rules, most = self.settings.rules, margin.value + beyond
            spread_ = margin.standard_deviation
            cost = min(rules.cost(most - slope, spread_, shown - slope), PASSABLE)
            # On the way back, what is required here helps: uphill becomes downhill.
            back = cost if math.isnan(demand) else rules.cost(most + demand, spread_)
            home = min(cost, back)
        if stuck:
            mark = home = HIGHEST
        elif risk > 0.0:
            mark = min(round(HIGHEST * risk), PASSABLE)
        self._track.follow(self._pose or pose, pose, home)
        self._pose = pose
        if cost == mark == UNKNOWN:
            self._ground.skip(wheel.name)
            return
        across = self.outline.across(pose, wheel, course)
        self.changed |= self._ground.cross(wheel.name, across, travel, cost, mark)
        if margin is not None and not stuck:
            x, y = pose.place(wheel.longitudinal_position, wheel.lateral_position)
            terrain, classes = self.ahead.class_at(self.frame, x, y), self.ahead.classes
            if measured or not classes.has_prior(terrain):
                self.changed |= classes.learn(wheel.name, x, y, terrain, margin, beyond)

    # --- What is expected

    def expect(self, most: Quantity) -> None:
        """Set the largest pull over load that ground like the present one gives, for ground ahead."""
        self.changed |= self.ahead.elevation is not None and most != self.ahead.most
        self.ahead.most = most

    def take_classes(self, grid: Grid) -> None:
        """Take a grid of terrain classes: whole numbers from 0 on, below 0 is not classified."""
        self.changed |= self.ahead.take_classes(grid)

    def take_elevation(self, elevation: Elevation) -> None:
        """Take the slopes of ground ahead."""
        self.ahead.take_elevation(elevation)
        self.changed = True

    # --- What was found before

    def remember(self, grid: Grid) -> None:
        """Lay costs of an earlier drive under those of this drive."""
        self.remembered, self.changed = grid, True

    def place_frame(self, above: str, pose: Pose) -> None:
        """Set the pose of the frame of the vehicle's positions in its parent frame, such as of odom in map.

        Parameters
        ----------
        above
            Name of the parent frame, such as map.
        pose
            Pose of the frame of the vehicle's positions (`frame`) in the parent frame.
        """
        moved = self._frames.get(above) != pose
        others = self.remembered is not None or self.ahead.elevation is not None
        self.changed |= moved and others
        self._frames = {above: pose}

    def whole(self) -> Grid | None:
        """All ground crossed on this drive and earlier ones, also outside the window; None if there is none.

        It is in the frame above that of the positions if there is one. Earlier drives in another frame are
        left out.
        """
        ground, old = self._ground.whole(self.frame), self.remembered
        for above, pose in self._frames.items():
            if ground is not None:
                ground = union(above, [(ground, pose)])
        if old is None or ground is None or old.frame != ground.frame:
            return ground if ground is not None else old
        return union(ground.frame, [(old, HERE), (ground, HERE)])

    def spread_whole(self) -> Grid | None:
        """`whole` with costs spread, for planners that only check the cell under base_link."""
        ground = self.whole()
        if ground is None:
            return None
        ground = wide(self._freed(ground), self.spread)
        self._leave_way_home(ground)
        return ground

    # --- The grids

    def grids(self) -> CostGrids | None:
        """Return the present costs; None until the vehicle's position is known.

        The cells are those of the grid of terrain classes if there is one, otherwise those of the window.
        """
        bare = self._laid()
        self.changed, self._given = False, self._pose
        if bare is None:
            return None
        self._let_out(bare)
        dear = self._spreader.spread(bare)
        self._leave_way_home(dear)
        return CostGrids(bare, dear)

    def _laid(self) -> Grid | None:
        """All layers in one grid, expectations below crossed ground; None while there is no grid at all."""
        ground, old = self._ground.grid(self.frame), self.remembered
        self.ahead.stuck_at(self.frame, self._ground.stuck_places())
        costs, slopes = self.ahead.by_class(), self.ahead.by_slope()
        if costs is None and ground is not None:
            if old is None and slopes is None:
                return self._freed(ground)
            costs = replace(ground, cells=np.full_like(ground.cells, UNKNOWN))
        if costs is None:
            return None
        if slopes is not None:
            self._lay(costs, slopes)
        if old is not None:
            self._lay(costs, self._freed(old))
        if ground is not None:
            self._lay(costs, self._freed(ground))
        return costs

    def _lay(self, costs: Grid, above: Grid) -> None:
        """Lay a grid over another one if the pose of its frame in that of the other is known."""
        if above.frame == costs.frame:
            lay_over(costs, above)
        elif costs.frame == self.frame and above.frame in self._frames:
            lay_over(costs, above, self._frames[above.frame].inverse())

    def _freed(self, seen: Grid) -> Grid:
        """Crossed ground, with costs up to `free` replaced by 0."""
        cells = seen.cells.copy()
        cells[(cells > 0) & (cells <= math.floor(self.free))] = 0
        return replace(seen, cells=cells)

    def _leave_way_home(self, costs: Grid) -> None:
        """Reduce the costs along base_link's own track to those of driving back there."""
        pose = HERE if costs.frame == self.frame else self._frames.get(costs.frame)
        if pose is not None:
            self._track.leave_way_home(costs, pose, math.floor(self.free))

    def _let_out(self, costs: Grid) -> None:
        """Leave no cell that cannot be crossed around a vehicle that stands on one, until it has left.

        A planner finds no way for a vehicle inside an obstacle. Costs of 100 become 99 around the vehicle, to
        the distance to which they are spread.
        """
        if self._pose is None or costs.frame != self.frame:
            self._held = None
            return
        outline, side = self.outline, costs.resolution
        far = outline.radius + max(self.spread, outline.half_width) + side
        near = costs.around(self._pose.x, self._pose.y, outline.around + far)
        part = costs.cells[near]
        rows, columns = np.nonzero(part == HIGHEST)
        x: NDArray[np.float64] = costs.origin[0] + side * (near[1].start + columns + 0.5)
        y: NDArray[np.float64] = costs.origin[1] + side * (near[0].start + rows + 0.5)
        gap = outline.gap(self._pose, x, y)
        touched = far if self._held is not None else 0.7 * side
        inside = bool((gap <= touched).any())
        self._held = self._pose if inside else None
        if inside:
            part[rows[gap <= far], columns[gap <= far]] = PASSABLE

    def _enter(self, frame: str) -> None:
        """Note the frame of positions; if it has changed, forget the crossed ground."""
        if frame != self.frame:
            if self.frame:
                remembered = self.remembered
                self.clear()
                self.remembered = remembered
            self.frame = frame

    # --- What to say of it

    @property
    def in_other_frame(self) -> bool:
        """Whether the grid of terrain classes is in another frame than the positions."""
        classes = self.ahead.class_grid
        return classes is not None and bool(self.frame) and classes.frame != self.frame

    def is_placed(self, frame: str) -> bool:
        """Whether a frame can be located: it is the positions' own, or tf relates the two."""
        return not self.frame or frame in (self.frame, *self._frames)

    @property
    def problem(self) -> str:
        """Why inputs cannot be used, in words; empty if all can."""
        found = []
        classes, elevation, old = self.ahead.class_grid, self.ahead.elevation, self.remembered
        if classes is not None and self.in_other_frame:
            found.append(
                f"terrain_classes is in frame {classes.frame}, positions are in"
                f" {self.frame}: it is not known on which class a wheel is, so the classes have no"
                " cost. Feed odometry of that frame, or publish the classes in it"
            )
        if elevation is not None and not self.is_placed(elevation.frame):
            found.append(
                f"the map of elevations is in frame {elevation.frame}, positions are in {self.frame}: it"
                " is used once tf relates the two"
            )
        if old is not None and not self.is_placed(old.frame):
            found.append(
                f"the saved cost map is in frame {old.frame}, positions are in {self.frame}: it"
                " is used once tf relates the two"
            )
        return "; ".join([*found, *self.ahead.classes.contradictions()])
