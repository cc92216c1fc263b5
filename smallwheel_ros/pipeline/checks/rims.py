# SPDX-License-Identifier: Apache-2.0
"""Rules of `checks` about the rims: wrong signs, repeated values, radii, and left confused with right."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.onboard.joint_units import UNITS_OF_TURNING
from smallwheel_ros.onboard.settings import IMU, ODOMETRY

from .lateness import MOVES, SIGN_SHARE
from .sums import Pieces, Run, RunningAgreement, Said, robust
from .window import AHEAD, STRAIGHT, CheckedWheels, Window

SIGN_WAY = 1.0  # m
DEAD_WAY = 2.0  # m
HELD = 10  # changes of the others
TURN, TURN_AGREES = 1.5, 0.5  # rad, 1
ROLL_PIECE, ROLL_PIECES = 1.0, 20  # m, and how many
ROLL_SCATTER, ROLL_OFF, ROLL_SURE = 0.02, 0.05, 5.0
LEVEL = 0.05  # of g: downhill wheels that brake do skid
# m, how many, and a factor that no wheel that rolls reaches (slip 0.75): units differ by 6 and more.
UNIT_PIECE, UNIT_PIECES, UNIT_FAR = 0.5, 6, 4.0
UNIT_SCATTER = 0.1  # a slip that grows by 0.01 at 0.9 is more
# A vehicle that has come 10 m while its rims turned so evenly does not dig in; before that, wheels that spin
# at a steady 0.9 look like rpm, and a warning must not end by a guess.
UNIT_SURE = 20
_UNIT_NEAR = 0.85, 1.5  # of a unit's factor: a slip of -0.2 to 0.3


class Mirrored:
    """Measures the share of the straight path over which each joint turned against the vehicle's travel."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.names = vehicle.names
        self.total, self.against = np.zeros((2, len(self.names)))

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Only straight rows on which the wheel turns count. If all wheels turn against the travel the odometry
        is reported, except where the vehicle may slide down a slope.
        """
        m = window.motion
        if m is not None:
            rows = m.inside & m.straight
            rim, v = m.rim[rows].T, m.v[rows]
            way = np.abs(v) * m.dt[rows] * (np.abs(rim) > MOVES / 2)
            self.total += way.sum(axis=1)
            self.against += (way * (rim * v < 0)).sum(axis=1)
        bad = (self.total > SIGN_WAY) & (self.against > SIGN_SHARE * self.total)
        against = window.memory.known.against  # also where nothing tells what is straight
        if len(bad) > 1 and bad.all() and window.memory.known.slides:
            return []  # down a slope, while the wheels drive up: that is slip, and no sensor's fault
        if len(bad) > 1 and (bad.all() or against > SIGN_WAY):
            text = (
                "all wheels turn against the travel: odometry looks backward, or joint_sign of all is"
                " wrong: check both; until then slip is not known"
            )
            return [Said(ODOMETRY, max(float(self.against.min()), against), text, (ODOMETRY,))]
        return [
            Said(
                self.names[i],
                float(self.against[i]),
                f"its joint turns against the travel on {self.against[i]:.1f} of {self.total[i]:.1f} m of"
                " straight driving: check joint_sign and joint",
                (f"{self.names[i]}/wheel_speed",),
            )
            for i in np.flatnonzero(bad)
        ]


class Dead:
    """Measures the path over which a joint shows exactly 0 on straight rows on which most others roll."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.names, self.runs = vehicle.names, [Run() for _ in vehicle.names]

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Rows that are not judged neither extend a run of zeros nor end it.
        """
        m, found = window.motion, []
        if m is None:
            return []
        rolls = m.straight[:, None] & (m.rim * m.v[:, None] > 0.5 * m.v[:, None] ** 2)
        for i, (name, run) in enumerate(zip(self.names, self.runs, strict=True)):
            others = np.delete(rolls, i, axis=1).sum(axis=1) > (len(self.names) - 1) / 2
            asked = others & m.inside
            run.extend(m.rim[asked, i] == 0, (np.abs(m.v) * m.dt)[asked], m.stamp[asked])
            if run.most > DEAD_WAY:
                text = (
                    f"its joint shows exactly 0 for {run.most:.1f} m on which the others roll: the encoder"
                    " is dead, or the wheel blocked"
                )
                found.append(Said(name, run.most, text, (f"{name}/wheel_speed",), run.began))
        return found


class Held:
    """Counts how often most other joints change while one repeats a value other than 0 bit for bit.

    Two kinds of values are excused: the largest one seen, if joints of both sides have shown it, since it is
    then a limit of the motor drivers; and one that another joint repeats bit for bit at the same time.
    """

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.names, self.runs = vehicle.names, [Run() for _ in vehicle.names]
        self.sides = [side for side in (vehicle.y > 0, vehicle.y <= 0) if side.any()]
        self.most = np.zeros(len(vehicle.names))

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Coarse encoders all repeat at a steady speed; then none is judged.
        """
        rims, found = window.rims, []
        if rims is None:
            return []
        rows, changes = rims.inside, rims.changes[rims.inside]
        x, t = rims.x[rows], rims.stamp[rows]
        self.most = np.fmax(self.most, np.nan_to_num(np.abs(x)).max(axis=0, initial=0.0))
        most = {float(self.most[side].max()) for side in self.sides}
        limit = most.pop() if len(self.sides) > len(most) == 1 else np.inf
        moves = np.nan_to_num(np.abs(x)).max(axis=1, initial=0.0) > MOVES
        for i, (name, run) in enumerate(zip(self.names, self.runs, strict=True)):
            others = np.delete(changes, i, axis=1).sum(axis=1) > (len(self.names) - 1) / 2
            held = np.delete(np.where(changes, np.nan, np.abs(x)), i, axis=1)
            shared = np.isin(np.abs(x[:, i]), held[np.isfinite(held)])
            own = ~shared & (x[:, i] != 0) & (np.abs(x[:, i]) != limit) & np.isfinite(x[:, i])
            run.extend(
                ~changes[:, i] & own,
                (others & moves).astype(float),
                t,
            )
            if run.most > HELD:
                text = (
                    f"its joint shows one value while those of the others changed {run.most:.0f} times:"
                    " check the encoder and its driver"
                )
                found.append(Said(name, run.most, text, (f"{name}/wheel_speed",), run.began))
        return found


class TurnRule:
    """Compares the direction of turning by wheels, gyro and odometry: two outvote the third."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.vehicle = vehicle
        self.left, self.right = vehicle.y > 0, vehicle.y < 0
        self.gyro, self.moves, self.both = (RunningAgreement(TURN) for _ in range(3))
        self.each = [(RunningAgreement(TURN), RunningAgreement(TURN)) for _ in vehicle.names]

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        A vehicle with wheels on one side only is not judged.
        """
        m = window.motion
        if m is None or not (self.left.any() and self.right.any()):
            return []
        rows = m.inside
        rim, w, gyro, dt = m.rim[rows], m.w[rows], m.gyro[rows], m.dt[rows]
        wheels = rim[:, self.right].mean(axis=1) - rim[:, self.left].mean(axis=1)
        self.gyro.extend(wheels, gyro, dt)
        self.moves.extend(wheels, w, dt)
        self.both.extend(gyro, w, dt)
        for i, (by_gyro, by_moves) in enumerate(self.each):
            own = (-1.0 if self.left[i] else 1.0) * (rim[:, i] - rim.mean(axis=1))
            by_gyro.extend(own, gyro, dt)
            by_moves.extend(own, w, dt)
        return self._judged()

    def _judged(self) -> list[Said]:
        by_gyro, by_odometry, both = self.gyro.value, self.moves.value, self.both.value
        low, subject = -TURN_AGREES, ""
        if both < low:
            subject = (
                "imu" if by_odometry > -low else "odometry" if by_gyro > -low else "imu or odometry"
            )
        elif both == 0.0 and min(by_gyro, by_odometry) < low:
            subject = "imu or wheels" if by_gyro < low else "odometry or wheels"
        if subject:
            text = (
                "it turns the other way than the others (wheels, gyro, odometry): check how the"
                " imu is mounted, the frame of the odometry, and the joints of left and right"
            )
            # Where nothing decides between imu and wheels, the imu is doubted: without the wheels no motion
            # is known.
            named = {"imu": IMU, "odometry": ODOMETRY, "imu or wheels": IMU}
            doubts: tuple[str, ...] = (named[subject],) if subject in named else ()
            return [Said(subject, both, text, doubts, taught=bool(doubts))]
        if -low >= both != 0.0:
            return []
        each = np.array([one[by_odometry > -low].value for one in self.each])
        bad = np.flatnonzero(each < low)
        if not (self.left[bad].any() and self.right[bad].any()):
            return []
        names = [self.vehicle.names[i] for i in bad]
        text = f"{' and '.join(names)} turn as the other side does: are their joints interchanged?"
        both_sides = tuple(f"{name}/wheel_speed" for name in names)
        return [Said(" and ".join(names), float(each[bad].max()), text, both_sides)]


class AnotherUnit:
    """Compares the path of the rims with that of the odometry, to find joints in another unit.

    A wrong unit gives the same ratio from the first metre to the last, and slip does not: one piece of
    path with an ordinary ratio rules out a wrong unit for the rest of the drive.
    """

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.vehicle, self.pieces = vehicle, Pieces(UNIT_PIECE, 2)
        self.ordinary = False

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Velocities that contradict the positions of their joint have been refused already (`VelocityUnit`).
        """
        m, known = window.motion, window.memory.known
        if m is None or self.ordinary or known.of_wheels or ODOMETRY in window.memory.doubted:
            return []
        way = np.median(np.abs(m.rim), axis=1)
        rows = m.inside & np.isfinite(way) & (way > 0.0) & (np.abs(m.v) > MOVES)
        moved, turned = np.abs(m.v[rows]) * m.dt[rows], way[rows] * m.dt[rows]
        self.pieces.extend(moved, np.column_stack([turned, moved]))
        if not len(self.pieces):
            return []
        ratio = self.pieces.rows[:, 0] / self.pieces.rows[:, 1]
        apart = np.fmax(ratio, 1.0 / np.fmax(ratio, 1e-9)) > UNIT_FAR
        self.ordinary = bool((~apart).any())
        if self.ordinary or len(ratio) < UNIT_PIECES:
            return []
        middle, scatter = robust(ratio)
        units = {**UNITS_OF_TURNING, "m/s at the rim": float(self.vehicle.radius.mean())}
        least, most = _UNIT_NEAR
        near = [u for u, f in units.items() if least < middle / f < most]
        # Wheels that spin on the spot exceed 1 as well; driven wheels do not skid that much.
        if not scatter <= UNIT_SCATTER * middle or (middle > 1.0 and not near):
            return []
        if middle > 1.0 and len(ratio) < UNIT_SURE:
            return []
        perhaps = " or ".join(near) or "another unit"
        text = (
            f"the rims travel {middle:.3g} times the distance by the odometry, evenly from the start: are"
            f" velocities (or positions) of the joints in {perhaps}? expected rad/s and rad"
        )
        every = tuple(f"{name}/wheel_speed" for name in self.vehicle.names)
        return [Said("joints", middle, text, every)]


class RollingAll:
    """Compares the path of the rims with that of the odometry on straight, level metres."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.y, n = vehicle.y, len(vehicle.names)
        self.half = 0.5 * float(np.ptp(self.y)) if n else 0.0
        self.pieces = Pieces(ROLL_PIECE, 2 * n)
        self.felt, self.count, self._level = 0.0, 0, LEVEL * vehicle.gravity

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Driven wheels do not skid on level ground: a ratio below 1 is not slip, a larger one may be.
        """
        m, imu, n = window.motion, window.imu, len(self.y)
        if imu is not None:
            felt = imu.x[imu.inside & ~imu.stale, AHEAD]
            felt = felt[np.isfinite(felt)]
            self.felt, self.count = self.felt + float(felt.sum()), self.count + felt.size
        if m is None:
            return []
        if ODOMETRY in window.memory.doubted:  # it is no evidence, nor was it before
            self.pieces = Pieces(ROLL_PIECE, 2 * n)
            return []
        # Rows are chosen by the rims alone, so that errors of the speed cancel over a metre: choosing by a
        # noisy speed would prefer rows in which it is too large. Rows on which the rims stand while a late
        # odometry still moves are left out, as are those on which the rims start before it.
        way, yaw = np.median(m.rim, axis=1), np.fmax(np.abs(m.w), np.abs(m.gyro))
        turns, straight = np.abs(way) > MOVES, yaw * self.half < STRAIGHT * np.abs(way)
        known = np.isfinite(m.rim).all(axis=1) & np.isfinite(m.v)
        rows = m.inside & turns & straight & known
        v, dt = m.v[rows], m.dt[rows]
        turned = np.nan_to_num(np.where(np.isfinite(m.w[rows]), m.w[rows], m.gyro[rows]))
        place = v[:, None] - turned[:, None] * self.y
        forward = np.sign(way[rows])[:, None] * dt[:, None]
        self.pieces.extend(
            np.abs(way[rows]) * dt, np.hstack([forward * m.rim[rows], forward * place])
        )
        if (
            len(self.pieces) < ROLL_PIECES
            or not self.count
            or abs(self.felt / self.count) >= self._level
        ):
            return []
        sums = self.pieces.rows
        ratio = np.median(sums[:, :n] / np.maximum(sums[:, n:], 0.1), axis=1)
        middle, scatter = robust(ratio)
        if not 0.1 < middle < 1.0 - max(ROLL_OFF, ROLL_SURE * scatter / np.sqrt(len(ratio))):
            return []
        text = (
            f"the rims travel {middle:.3f} times the distance by the odometry on {len(ratio)} m, straight and"
            " level: check the diameters and the scale of the odometry"
        )
        return [Said("radii", middle, text)]


class RollingPair:
    """Compares the paths of two rims of one side metre by metre, to find a wrong diameter; bends cancel."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        n, self.names = len(vehicle.names), vehicle.names
        pairs = [(i, j) for i in range(n) for j in range(i + 1, n) if vehicle.y[i] == vehicle.y[j]]
        self.pairs = {pair: Pieces(ROLL_PIECE, 2) for pair in pairs}

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        A wrong radius gives the same ratio on each metre; slip does not.
        """
        m, found = window.motion, []
        if m is None:
            return []
        for (i, j), pieces in self.pairs.items():
            pair, dt = np.abs(m.rim[m.inside][:, [i, j]]), m.dt[m.inside]
            rolls = np.nan_to_num(pair).min(axis=1) > MOVES
            pair, dt = pair[rolls], dt[rolls]
            pieces.extend(pair.mean(axis=1) * dt, pair * dt[:, None])
            if len(pieces) < ROLL_PIECES:
                continue
            sums = pieces.rows
            middle, scatter = robust(sums[:, 0] / sums[:, 1])
            if scatter < ROLL_SCATTER and abs(middle - 1.0) > ROLL_OFF:
                names = f"{self.names[i]} and {self.names[j]}"
                text = f"{names} turn {middle:.3f} to 1, evenly on each metre: check both diameters"
                found.append(Said(names, middle, text))
        return found
