# SPDX-License-Identifier: Apache-2.0
"""Each rule names its fault and is silent of good sensors; nothing depends on where blocks are cut.

`PYTHONPATH=. python test/pipeline/checks/test_rules.py` writes the table of docs/checks.md anew.

Tests `ground_speed.py`, `lateness.py`, `loads.py`, `odometry.py`, `rims.py`, `sums.py` and
`window.py`.
"""

from __future__ import annotations

import copy
import math
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).resolve().parent))
from raw_drives import MASS, NAMES, RADIUS, START, Rows, cut, drive, real_folder, settings

from smallwheel_ros.common.stamps import NEVER
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.checks.believed import RawRows
from smallwheel_ros.pipeline.checks.lateness import OfWheels
from smallwheel_ros.pipeline.checks.loads import impossible_soil
from smallwheel_ros.pipeline.checks.odometry import Tilt
from smallwheel_ros.pipeline.checks.rules import RULES, Finding, table
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.checks.window import SPAN, CheckedWheels
from smallwheel_ros.pipeline.intake.layout import rules_of, widths_of
from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.tables import Array

PAGE = Path(__file__).resolve().parents[3] / "docs" / "checks.md"
BEGIN, END = "<!-- rules -->\n", "<!-- end of rules -->\n"
LEFT = "front_left/wheel_speed"


class Listening:
    """Checks that are given blocks of rows, as a pipeline gives them."""

    def __init__(self, onboard: OnboardSettings | None = None) -> None:
        onboard = onboard or settings()
        self.streams = Streams(widths_of(onboard), rules_of(onboard))
        self.checks, self.until = SensorChecks(onboard), 0

    def take(self, rows: Rows, until: int, *, last: bool = False) -> list[Finding]:
        for name, block in rows.items():
            self.streams.all[name].extend(*block)
        self.until = until
        self.checks.take(RawRows(self.streams.kept(NEVER), until), last=last)
        return list(self.checks.findings)

    def flush(self) -> list[Finding]:
        return self.take({}, self.until, last=True)


def heard(rows: Rows, onboard: OnboardSettings | None = None) -> list[Finding]:
    listening = Listening(onboard)
    until = max(int(stamps[-1]) for stamps, _ in rows.values())
    return [*listening.take(rows, until), *listening.flush()]


def said(rows: Rows) -> set[tuple[str, str]]:
    return {(finding.rule, finding.subject) for finding in heard(rows)}


@pytest.fixture(scope="module")
def good() -> Rows:
    return drive()


def hold(rows: Rows, name: str, after: float = 30.0) -> None:
    stamps, values = rows[name]
    i = int(np.searchsorted(stamps, START + round(after * 1e9)))
    values[i:] = values[i]


def scale(rows: Rows, name: str, factor: float, columns: Any = slice(None)) -> None:
    rows[name][1][:, columns] *= factor


def swap(rows: Rows, one: str, two: str) -> None:
    rows[one], rows[two] = rows[two], rows[one]


def of_wheels(rows: Rows) -> None:
    stamps, values = rows[ODOMETRY]
    rims = [RADIUS * np.interp(stamps, *_column(rows, f"{name}/wheel_speed")) for name in NAMES]
    values[:, 0] = np.mean(rims, axis=0)
    values[:, 1] = (rims[1] + rims[3] - rims[0] - rims[2]) / 2 / 0.6


def _column(rows: Rows, name: str) -> tuple[Any, Any]:
    return rows[name][0], rows[name][1][:, 0]


def late(rows: Rows) -> None:
    rows[ODOMETRY] = rows[ODOMETRY][0] + 350_000_000, rows[ODOMETRY][1]


def jump(rows: Rows) -> None:
    rows[ODOMETRY][1][600:, 2] += 3.0


def tilted(rows: Rows) -> None:
    rows[IMU][1][:, 1] += 9.8 * math.sin(math.radians(4))


def no_gravity(rows: Rows) -> None:
    rows[IMU][1][:, 3] -= GRAVITY


def zero(rows: Rows) -> None:
    rows[LEFT][1][900:] = 0.0


def all_radii(rows: Rows) -> None:
    for name in NAMES:
        scale(rows, f"{name}/wheel_speed", 0.8)


def all_joints(factor: float) -> Callable[[Rows], None]:
    def make(rows: Rows) -> None:
        for name in NAMES:
            scale(rows, f"{name}/wheel_speed", factor)

    return make


def twist_of_the_map(rows: Rows) -> None:
    """As Gazebo's p3d publishes it: the speed along x of the pose's frame."""
    values = rows[ODOMETRY][1]
    values[:, 0] *= values[:, 4]


FAULTS: dict[str, tuple[str, str, Callable[[Rows], None]]] = {
    "encoder 0": ("dead", "front_left", zero),
    "encoder holds": ("held", "front_left", lambda r: hold(r, LEFT)),
    "mirrored": ("mirrored", "front_left", lambda r: scale(r, LEFT, -1.0)),
    "radius": ("rolling", "front_left and rear_left", lambda r: scale(r, LEFT, 1.1)),
    "all radii": ("rolling", "radii", all_radii),
    "rpm": ("unit", "joints", all_joints(30.0 / math.pi)),
    "m/s at the rim": ("unit", "joints", all_joints(RADIUS)),
    "joints interchanged": (
        "turn", "front_left and front_right", lambda r: swap(r, LEFT, "front_right/wheel_speed"),
    ),
    "odometry repeats": ("repeats", "odometry", lambda r: hold(r, ODOMETRY)),
    "no twist": ("no twist", "odom", lambda r: scale(r, ODOMETRY, 0.0, [0, 1])),
    "twist of the map": ("frame", "odometry", twist_of_the_map),
    "of wheels": ("of wheels", "odometry", of_wheels),
    "late": ("late", "odometry", late),
    "jumps": ("jumps", "odometry", jump),
    "tilt": ("tilt", "imu", tilted),
    "imu in g": ("gravity", "imu", lambda r: scale(r, IMU, 1.0 / GRAVITY, [1, 2, 3])),
    "gravity taken out": ("gravity", "imu", no_gravity),
    "z down": ("z down", "imu", lambda r: scale(r, IMU, -1.0, [0, 2, 3])),
    "gyro": ("turn", "imu", lambda r: scale(r, IMU, -1.0, [0])),
    "imu frozen": ("frozen", "imu", lambda r: hold(r, IMU)),
    "kg": ("weight", "loads", lambda r: [scale(r, f"{n}/load", 1 / 9.80665) for n in NAMES] and None),
    "loads swapped": (
        "swapped", "front_left and front_right", lambda r: swap(r, "front_left/load", "front_right/load"),
    ),
    "load frozen": ("held load", "front_left load", lambda r: hold(r, "front_left/load")),
    "load dead": ("weight", "front_left", lambda r: scale(r, "front_left/load", 0.01)),
    "sinkage frozen": ("held sinkage", "front_left sinkage", lambda r: hold(r, "front_left/sinkage")),
    "mm": ("sinkage", "front_left sinkage", lambda r: scale(r, "front_left/sinkage", 1e3, [0])),
    "above ground": ("sinkage", "front_left sinkage", lambda r: scale(r, "front_left/sinkage", -1.0, [0])),
}  # fmt: skip


def test_two_joints_that_stand_at_one_value_stand_at_a_limit(good: Rows) -> None:
    rows = copy.deepcopy(good)
    one, other = LEFT, "rear_left/wheel_speed"
    fastest = float(np.quantile(rows[one][1], 0.7))
    for name in (one, other):
        np.clip(rows[name][1], None, fastest, out=rows[name][1])
    assert not [finding for finding in heard(rows) if finding.rule == "held"]


@pytest.mark.parametrize("off", np.linspace(-np.pi, np.pi, 9)[:-1])
@pytest.mark.parametrize("moves", [1.0, -1.0, 0.0])
def test_a_twist_along_the_heading_is_in_no_other_frame(
    good: Rows, off: float, moves: float
) -> None:
    """Whatever heading the pose shows, ahead and back, and of a vehicle that is towed, its wheels still."""
    rows = copy.deepcopy(good)
    values = rows[ODOMETRY][1]
    values[:, 0] *= moves
    heading = np.arctan2(values[:, 5], values[:, 4]) + off
    values[:, 4], values[:, 5] = np.cos(heading), np.sin(heading)
    assert "frame" not in {rule for rule, _ in said(rows)}


def test_nothing_is_said_of_good_sensors(good: Rows) -> None:
    assert said(good) == set()


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_and_no_other(good: Rows, name: str) -> None:
    rule, subject, make = FAULTS[name]
    rows = copy.deepcopy(good)
    make(rows)
    assert said(rows) == {(rule, subject)}


def test_every_rule_has_its_fault() -> None:
    # Faults of steering are those of test_steering_sign.py: these wheels are not steered.
    named = {rule for rule, _, _ in FAULTS.values()} | {"steering"}
    assert {rule.name for rule in RULES} == named


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0 / GRAVITY, "gravity in g?"),
        (0.0, "accelerations are all 0"),
        (1.5, "expected 9.81 m/s^2"),
    ],
)
def test_accelerations_that_are_not_gravity_say_what_they_are(
    good: Rows, factor: float, words: str
) -> None:
    rows = copy.deepcopy(good)
    scale(rows, IMU, factor, [1, 2, 3])
    (found,) = (finding for finding in heard(rows) if finding.rule == "gravity")
    assert words in found.text


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_speed_is_no_scale_of_radii(seed: int) -> None:
    """Poses that scatter make speeds and yaw rates noisy; over a metre that is nothing."""
    rows = drive(120.0, seed, (0.03,) * 4)
    _, values = rows[ODOMETRY]
    rng = np.random.default_rng(seed)
    moves = values[:, 0] != 0.0
    for column, noise in ((0, 0.4), (1, 0.15)):  # m/s, rad/s; over half a second the same
        lasting = np.convolve(rng.standard_normal(moves.size), np.full(7, 7**-0.5), "same")
        values[:, column] += np.where(moves, noise * lasting, 0.0)
    assert not [finding for finding in heard(rows) if finding.rule == "rolling"]


def test_a_vehicle_that_spins_on_a_diagonal_has_good_encoders() -> None:
    assert said(drive(slips=(0.89, 0.2, 0.2, 0.85), uneven=0.3)) == set()


def stood(headings: Array, slopes: Array, zero: float) -> Tilt:
    """A judge of an imu that shows so much too much, after stands on slopes (east, north)."""
    judge = Tilt(CheckedWheels.of(settings()))
    for a, (e, n) in zip(headings, slopes, strict=True):
        ahead, left = e * np.cos(a) + n * np.sin(a) + zero, n * np.cos(a) - e * np.sin(a)
        judge.stands.append(np.array([a, GRAVITY * ahead, GRAVITY * left]))
    return judge


@given(st.integers(0, 2**32), st.integers(4, 40), st.floats(0.0, 0.1), st.floats(0.0, 0.2))
def test_stands_in_one_heading_tell_no_tilt(
    seed: int, count: int, spread: float, slope: float
) -> None:
    rng = np.random.default_rng(seed)
    headings = rng.uniform(-3.0, 3.0) + spread * rng.uniform(-1.0, 1.0, count)
    assert stood(headings, slope * rng.uniform(-1.0, 1.0, (count, 2)), 0.0)._judged() == []


@pytest.mark.parametrize("count", [4, 6, 12])
def test_slopes_of_the_ground_are_no_tilt_of_the_imu(count: int) -> None:
    rng = np.random.default_rng(count)

    def named(zero: float, slope: float) -> float:
        drives = [
            stood(rng.uniform(-3.0, 3.0, count), slope * rng.standard_normal((count, 2)), zero)
            for _ in range(400)
        ]
        return float(np.mean([bool(judge._judged()) for judge in drives]))

    assert named(0.0, 0.1) < 0.01
    assert named(math.radians(4.0), 0.01) > (0.5 if count == 4 else 0.95)


@pytest.mark.parametrize(("wander", "low", "high"), [(1e-4, 1.0, 1.0), (5e-3, 0.0, 0.03)])
def test_an_odometry_that_wanders_as_the_best_do_is_not_made_of_wheels(
    wander: float, low: float, high: float
) -> None:
    def made(seed: int) -> bool:
        rng = np.random.default_rng(seed)
        way, rims = np.arange(1, 201) * 0.1, np.full(200, 0.1)
        pieces = rng.uniform(0.9, 1.1) * (1.0 + wander * rng.standard_normal(40))
        parts = np.column_stack([rims, rims * np.repeat(pieces, 5), np.zeros((200, 2))])
        return bool(OfWheels().take(way - 0.1, way, parts)[0].any())

    assert low <= np.mean([made(seed) for seed in range(300)]) <= high


@hypothesis_settings(max_examples=6)
@given(
    st.lists(st.floats(0.0, 90.0), max_size=12),
    st.sampled_from(["radius", "load frozen", "late", "of wheels"]),
)
def test_findings_do_not_depend_on_where_blocks_are_cut(edges: list[float], name: str) -> None:
    rows = drive()
    FAULTS[name][2](rows)
    whole = heard(rows)
    listening = Listening()
    ends = START + np.sort(np.round(np.array(edges) * 1e9)).astype(np.int64)
    found = [f for block, until in cut(rows, ends) for f in listening.take(block, until)]
    assert [*found, *listening.flush()] == whole
    assert whole


def test_doubted_is_a_stream_from_when_it_was_so_and_while_it_lasts(good: Rows) -> None:
    rows = copy.deepcopy(good)
    stamps, values = rows[LEFT]
    begin, end = np.searchsorted(stamps, [START + 30_000_000_000, START + 60_000_000_000])
    values[begin:end] = values[begin]
    listening, seen = Listening(), {}
    for block, until in cut(rows, START + np.arange(1, 90) * 1_000_000_000):
        listening.take(block, until)
        seen[until] = dict(listening.checks.rules.doubted)
    assert seen[START + 25_000_000_000] == {}
    assert abs(seen[START + 45_000_000_000][LEFT] - stamps[begin]) <= 34_000_000
    assert seen[START + 80_000_000_000] == {}


@pytest.mark.parametrize(
    ("name", "taught"), [("mm", True), ("load dead", True), ("late", False), ("tilt", False)]
)
def test_the_soil_begins_anew_once_and_not_before_what_had_taught_it_is_doubted(
    good: Rows, name: str, taught: bool
) -> None:
    rows = copy.deepcopy(good)
    FAULTS[name][2](rows)
    listening = Listening()
    until = max(int(stamps[-1]) for stamps, _ in rows.values())
    (finding,) = [*listening.take(rows, until), *listening.flush()]
    rules = listening.checks.rules
    assert len(rules.anew) == taught
    assert all(finding.stamp <= stamp <= finding.stamp + 2 * SPAN for stamp in rules.anew)
    assert ("what the soil has learnt until then is dropped" in finding.text) is taught


def test_memory_does_not_grow_with_the_drive() -> None:
    listening = Listening()
    sizes = []
    for lap in range(4):
        shift = lap * 90_000_000_000
        rows = {name: (stamps + shift, values) for name, (stamps, values) in drive().items()}
        heard_of = max(int(stamps[-1]) for stamps, _ in rows.values())
        listening.take(rows, heard_of)
        sizes.append(sum(stamps.size for stamps, _ in listening.checks.rules._rows.values()))
    assert max(sizes) < 8 * (30 * 4 + 20 * 4 + 10 * 4 + 15 + 50)


def test_loads_that_are_given_are_not_weighed(good: Rows) -> None:
    rows = {name: rows for name, rows in good.items() if not name.endswith("/load")}
    assert heard(rows, settings(**{"load.source": "static", "vehicle.mass": MASS})) == []


def test_a_silent_wheel_and_values_that_are_not_known_are_no_fault(good: Rows) -> None:
    rows = copy.deepcopy(good)
    stamps, values = rows[LEFT]
    rows[LEFT] = stamps[:900], values[:900]
    rows[ODOMETRY][1][300:330] = np.nan
    rows[IMU][1][500:600, :4] = np.nan
    assert said(rows) == set()


def test_nothing_at_all_is_no_fault() -> None:
    listening = Listening()
    assert listening.take({}, START) == []
    assert listening.flush() == []


@pytest.mark.parametrize("slip", [0.8, 0.9, 0.95])
def test_wheels_that_spin_are_in_no_other_unit(good: Rows, slip: float) -> None:
    """One that digs in changes its slip; one that has ever rolled is in rad/s."""
    rows = copy.deepcopy(good)
    spins = 1.0 - slip * np.linspace(0.85, 1.0, len(rows[LEFT][0]))
    for name in NAMES:
        rows[f"{name}/wheel_speed"][1][:, 0] /= spins
    stood = copy.deepcopy(good)
    for name in NAMES:
        stood[f"{name}/wheel_speed"][1][200:] /= 1.0 - slip
    assert not [
        finding for rows in (rows, stood) for finding in heard(rows) if finding.rule == "unit"
    ]


@pytest.mark.parametrize(("seconds", "ends"), [(15.0, False), (60.0, True)])
def test_rims_that_may_slip_evenly_keep_their_slip_until_the_vehicle_has_driven_on(
    good: Rows, seconds: float, ends: bool
) -> None:
    """Slip of a steady 0.9 looks like rpm: over the first 10 m it stays known, and a warning may go on."""
    until = START + round(seconds * 1e9)
    rows = {
        n: (stamps[stamps < until], values[stamps < until]) for n, (stamps, values) in good.items()
    }
    for name in NAMES:
        rows[f"{name}/wheel_speed"] = (
            rows[f"{name}/wheel_speed"][0], 9.0 * rows[f"{name}/wheel_speed"][1]
        )  # fmt: skip
    listening = Listening()
    found = [*listening.take(rows, until), *listening.flush()]
    text = "; ".join(finding.text for finding in found if finding.rule == "unit")
    assert ("in rpm" in text) == ends
    doubted = frozenset().union(*listening.checks.doubts.now.streams)
    assert (doubted >= {f"{name}/wheel_speed" for name in NAMES}) == ends
    assert bool(doubted & {f"{name}/wheel_speed" for name in NAMES}) == ends


def test_numbers_that_no_soil_has_are_a_fault_of_the_sensor() -> None:
    assert impossible_soil(1.5e6, 1.0, 0.0, 0.1) == ""
    assert impossible_soil(5e3, 0.5, 0.0, 0.1) == ""
    assert "sinkage" in impossible_soil(8e16, 1.0, 0.0, 0.1)
    assert "sinkage" in impossible_soil(1.0, 1.0, 0.0, 0.1)
    assert "sinkage" in impossible_soil(math.nan, 1.0, 0.0, 0.1)


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("warthog_grass", set()),
        ("warthog_grass_pose_only", {("no twist", "odom")}),
        ("warthog_sand1", set()),
        ("pathfinder_flat", {("z down", "imu"), ("rolling", "radii")}),
        ("husky_snow", {("of wheels", "odometry")}),
    ],
)
def test_good_sensors_of_real_robots_are_not_accused(
    name: str, right: set[tuple[str, str]]
) -> None:
    drive = import_module("rates.real_drives").real_drive(real_folder(), name)
    heard = import_module("rates.faults").heard
    found = {(finding.rule, finding.subject) for finding, _ in heard(drive)}
    assert found == right


def rewritten(text: str) -> str:
    before, rest = text.split(BEGIN)
    return before + BEGIN + table() + END + rest.split(END)[1]


def test_the_page_has_the_rules_as_they_are() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert rewritten(text) == text, f"run `PYTHONPATH=. python {__file__}`"


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
