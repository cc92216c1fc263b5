# SPDX-License-Identifier: Apache-2.0
"""Twist of rims and imu: whether its covariance is right, and what it gains over rims with a constant.

Peers: the rims' mean with the constant that is best on this drive, and with one fitted on the other drives.
Reach: NEES of vx .2 to 2 on the two real drives and .9 of the errors within two deviations, .5 to 2 on the
simulated ones, a log score above the best constant's, 0.2 ms a message.

`python -m rates.twist --figure docs/images/odometry.png`; real drives are looked for in
../shared/data, and left out without.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from filterpy.kalman import ExtendedKalmanFilter

from rates._twist_drives import REAL, Array, Drive, real, simulated
from smallwheel_ros.pipeline.twist.twist import Twists, TwistState, messages, twist

CUT = 4.0  # deviations that count for more count as these in the log score
GAP, FIXES, FIX_STD, GYRO_STD = 30.0, 30.0, 0.1, 0.02  # s, s, m, rad/s
RAW = 0.001  # m^2/s^2: what makers tell
Ends = tuple[list[float], list[bool]]  # errors (m), and whether the covariance holds them


# --- The filter of others

X, Y, YAW, VX, VY, TURN, AX, AY = range(8)
OF_TWIST = {0: VX, 1: VY, 5: TURN}  # twist0_config: by place in the message's covariance
_NOISE = np.diag([1e-4, 1e-4, 1e-4, 1.0, 1.0, 1.0, 0.01, 0.01])
_LEAST = 1e-9


class Ekf:
    """In the plane, taking twist, gyro and fixes as ekf_node of robot_localization documents it; from rest.

    State x, y, yaw, vx, vy, yaw rate, ax, ay; the omnidirectional model of its documentation; each fused
    variable is a measurement with the variance of its message, one under 1e-9 is 1e-9; a rejection threshold
    is a Mahalanobis distance beyond which a message is left out. Process noise a second: its own ekf.yaml
    takes a vehicle to change its speed by 0.16 m/s in a second (0.025), and the filter then lags behind a
    twist that is told with an honest variance: here 1 m/s. Of x, y and yaw next to nothing, so that the
    covariance is what the twist tells.
    """

    def __init__(self, pose: Array) -> None:
        self.filter = ExtendedKalmanFilter(8, 1)
        self.filter.x = np.array([*pose, 0.0, 0.0, 0.0, 0.0, 0.0])
        self.filter.P = np.diag([1e-2] * 3 + [1.0] * 3 + [1e-2] * 2)
        self.rejected = 0

    @property
    def x(self) -> Array:
        """The state, (8,)."""
        return np.asarray(self.filter.x)

    @property
    def P(self) -> Array:
        """Its covariance, (8, 8)."""
        return np.asarray(self.filter.P)

    def predict(self, dt: float) -> None:
        """On by dt seconds."""
        x = self.filter.x
        c, s = np.cos(x[YAW]), np.sin(x[YAW])
        a, b = x[VX] * dt + 0.5 * x[AX] * dt * dt, x[VY] * dt + 0.5 * x[AY] * dt * dt
        F = np.eye(8)
        F[X, [VX, VY, AX, AY]] = c * dt, -s * dt, 0.5 * c * dt * dt, -0.5 * s * dt * dt
        F[Y, [VX, VY, AX, AY]] = s * dt, c * dt, 0.5 * s * dt * dt, 0.5 * c * dt * dt
        F[X, YAW], F[Y, YAW] = -s * a - c * b, c * a - s * b
        F[YAW, TURN] = F[VX, AX] = F[VY, AY] = dt
        x = x + np.array(
            [c * a - s * b, s * a + c * b, x[TURN] * dt, x[AX] * dt, x[AY] * dt, 0.0, 0.0, 0.0]
        )
        self.filter.x = x
        self.filter.P = F @ self.filter.P @ F.T + _NOISE * dt

    def fuse(
        self, values: Array, variances: Array, places: list[int], threshold: float = np.inf
    ) -> None:
        """One message: values of state variables and their variances."""
        H = np.eye(8)[places]
        R = np.diag(np.maximum(np.abs(variances), _LEAST))
        e = values - H @ self.filter.x
        if float(e @ np.linalg.solve(H @ self.filter.P @ H.T + R, e)) > threshold**2:
            self.rejected += 1
            return
        self.filter.dim_z = len(places)
        self.filter._I = np.eye(8)
        self.filter.update(values, lambda _: H, lambda x: H @ x, R=R)

    def twist(
        self, linear: Array, angular: Array, covariance: Array, threshold: float = np.inf
    ) -> None:
        """A geometry_msgs/TwistWithCovariance: (3,), (3,), (36,)."""
        told = np.array([*linear, *angular])
        if not np.isfinite(told).all() or not np.isfinite(covariance).all():
            raise ValueError("a message that is not finite would make every estimate NaN")
        axes = list(OF_TWIST)
        self.fuse(
            told[axes], covariance.reshape(6, 6)[axes, axes], list(OF_TWIST.values()), threshold
        )


# --- What is judged


def told(drive: Drive) -> tuple[Twists, float]:
    """The drive's twists, and seconds of processor that each took."""
    state = TwistState(drive.vehicle, drive.settings)
    start = time.process_time()
    found = twist(state, drive.rows)
    return found, (time.process_time() - start) / max(len(found), 1)


def judged(drive: Drive) -> np.ndarray:
    """Rows with truth, the first half second of a piece left out: its beginning knows no speed."""
    known = np.isfinite(drive.truth[:, 0])
    begins = np.flatnonzero(np.diff(drive.piece, prepend=-1) != 0)
    since = (
        drive.time - drive.time[begins][np.searchsorted(begins, np.arange(known.size), "right") - 1]
    )
    return known & (since > 0.5)


def scores(error: Array, variance: Array) -> tuple[float, float, float, float]:
    """NEES, share within 1 and 2 deviations, mean log score."""
    z2 = error**2 / variance
    log = -0.5 * np.log(2.0 * np.pi * variance) - 0.5 * np.minimum(z2, CUT**2)
    return float(z2.mean()), float((z2 < 1).mean()), float((z2 < 4).mean()), float(log.mean())


def drift(drive: Drive, speed: Array, length: float = 10.0) -> float:
    """Error over `length` m of way, as a share of it: root of the mean square, heading by the gyro."""
    use = np.isfinite(drive.truth[:, 0])
    dt = np.minimum(np.diff(drive.time, prepend=drive.time[0]), 0.2)[use]
    heading = np.cumsum(drive.yaw_rate[use] * dt)
    turn = np.exp(1j * heading)
    wrong = np.cumsum(turn * ((speed - drive.truth[:, 0])[use] - 1j * drive.truth[use, 1]) * dt)
    way = np.cumsum(np.hypot(*drive.truth[use].T) * dt)
    ends = np.searchsorted(way, np.arange(0.0, way[-1], length))
    if ends.size < 2:
        return float("nan")
    return float(np.sqrt(np.mean(np.abs(np.diff(wrong[ends])) ** 2)) / length)


def gaps(drive: Drive, rows: Twists, variance: float | None) -> tuple[list[float], list[bool]]:
    """Errors (m) at the ends of gaps in the fixes, and whether they are in 95 % of the filter's covariance.

    variance: of the rims' mean, sent as it is; None: our messages. Pieces of a drive are put end to end.
    """
    use = np.flatnonzero(np.isfinite(drive.truth[:, 0]))
    rng = np.random.default_rng(46)
    dt = np.minimum(np.diff(drive.time, prepend=drive.time[0] - 0.05), 0.2)[use]
    truth, gyro = drive.truth[use], drive.yaw_rate[use]
    heading = np.cumsum(gyro * dt)
    place = np.cumsum(np.exp(1j * heading) * (truth[:, 0] + 1j * truth[:, 1]) * dt)
    linear, angular, covariance = (one[use] for one in messages(rows, drive.settings))
    if variance is not None:
        linear = np.column_stack([drive.rims[use], np.zeros((use.size, 2))])
        covariance = covariance.copy()
        covariance[:, 0] = covariance[:, 7] = variance
    errors, inside = [], []
    clock, fixed, ekf = 0.0, 0.0, Ekf(np.array([place[0].real, place[0].imag, heading[0]]))
    for i in range(use.size):
        ekf.predict(float(dt[i]))
        ekf.twist(linear[i], angular[i], covariance[i])
        ekf.fuse(gyro[i : i + 1], np.array([GYRO_STD**2]), [TURN])
        clock += dt[i]
        fixed += dt[i]
        if clock <= FIXES and fixed >= 1.0:
            fixed = 0.0
            at = np.array([place[i].real, place[i].imag]) + rng.normal(0.0, FIX_STD, 2)
            ekf.fuse(at, np.full(2, FIX_STD**2), [X, Y])
        if clock >= FIXES + GAP:
            e = np.array([place[i].real, place[i].imag]) - ekf.x[:2]
            S = ekf.P[:2, :2] + FIX_STD**2 * np.eye(2)
            errors.append(float(np.hypot(*e)))
            inside.append(bool(e @ np.linalg.solve(S, e) < 5.99))
            clock = 0.0
    return errors, inside


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=6, help="simulated drives of each slip")
    parser.add_argument("--figure", type=Path, help="picture of the errors at the ends of gaps")
    chosen = parser.parse_args()
    drives = [simulated(seed, slip) for slip in (0.05, 0.2, 0.4) for seed in range(chosen.seeds)]
    groups = [("simulated", drives)]
    if REAL.is_dir():
        groups.append(("real", [real(name) for name in ("warthog_grass", "warthog_sand1")]))
    else:
        print(f"no real drives: there is no {REAL}")
    ends = {group: table(group, members) for group, members in groups}
    if chosen.figure:
        figure(ends, chosen.figure)


def figure(groups: dict[str, dict[str, Ends]], path: Path) -> None:
    """Errors at the ends of gaps, those within 95 % of the filter's covariance full, others hollow."""
    canvas, axes = plt.subplots(1, len(groups), figsize=(8, 2.6), layout="constrained")
    for ax, (group, ends) in zip(np.atleast_1d(axes), groups.items(), strict=True):
        for height, (errors, inside) in enumerate(ends.values()):
            jitter = height + np.random.default_rng(0).uniform(-0.2, 0.2, len(errors))
            faces = np.where(inside, f"C{height}", "none")
            ax.scatter(errors, jitter, s=22, edgecolors=f"C{height}", facecolors=faces)
            ax.plot([np.median(errors)] * 2, [height - 0.35, height + 0.35], color="k", lw=1.5)
        ax.set_yticks(range(len(ends)), [f"{n}: {np.mean(i):.0%}" for n, (_, i) in ends.items()])
        ax.invert_yaxis()
        ax.set_xlabel(f"error after {GAP:g} s without fixes [m]")
        ax.set_title(f"{group}: {len(next(iter(ends.values()))[0])} gaps", fontsize=10)
    canvas.savefig(path, dpi=110)


def table(group: str, drives: list[Drive]) -> dict[str, Ends]:
    found = [told(drive) for drive in drives]
    rows = [each[0] for each in found]
    masks = [judged(drive) for drive in drives]
    raw = [(d.rims - d.truth[:, 0])[m] for d, m in zip(drives, masks, strict=True)]
    squares = [float(np.mean(e**2)) for e in raw]
    print(f"\n{group}: vx; log score cut at {CUT:g} deviations")
    kept = []
    ends: dict[str, Ends] = {name: ([], []) for name in ("raw", "constant", "ours")}
    for i, (drive, row, mask) in enumerate(zip(drives, rows, masks, strict=True)):
        extra = drive.truth_var[mask]
        error = (row.vx - drive.truth[:, 0])[mask]
        nees, one, two, log = scores(error, row.vx_var[mask] + extra)
        best = scores(raw[i], np.full(raw[i].size, squares[i]))[3]
        other = float(np.mean(squares[:i] + squares[i + 1 :]))
        nees_other, _, _, log_other = scores(raw[i], np.full(raw[i].size, other))
        kept.append((nees, one, two, log, best, log_other))
        ways = [100 * drift(drive, speed) for speed in (drive.rims, row.vx)]
        cells = {
            "rms": np.sqrt(squares[i]), "ours": np.sqrt(np.mean(error**2)), "NEES": nees, "in 1": one,
            "in 2": two, "log": log, "best": best, "NEES*": nees_other, "log*": log_other,
            "drift%": ways[0], "ours%": ways[1], "ms": 1e3 * found[i][1],
        }  # fmt: skip
        if i == 0:
            print(f"{'drive':<24}" + "".join(f"{head:>8}" for head in cells))
        print(f"{drive.name:<24}" + "".join(f"{value:8.3g}" for value in cells.values()))
        for name, variance in (("raw", RAW), ("constant", other), ("ours", None)):
            errors, inside = gaps(drive, row, variance)
            ends[name][0].extend(errors)
            ends[name][1].extend(inside)
    mean = np.mean(kept, axis=0)
    print(f"mean: NEES {mean[0]:.2f}, in 1 and 2 deviations {mean[1]:.2f} / {mean[2]:.2f}, log {mean[3]:.2f},"
          f" best constant {mean[4]:.2f}, constant of the other drives (*) {mean[5]:.2f}")  # fmt: skip
    print(f"ends of gaps of {GAP:g} s ({len(ends['raw'][0])}): in gate, error median / rms, m")
    for name, (errors, inside) in ends.items():
        rms = float(np.sqrt(np.mean(np.square(errors))))
        print(f"  {name:<9}{np.mean(inside):5.2f} {np.median(errors):6.2f} / {rms:.2f}")
    return ends


if __name__ == "__main__":
    main()
