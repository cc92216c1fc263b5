# SPDX-License-Identifier: Apache-2.0
"""Comments of the messages say what the code does: numbers, flags, units, names of parameters and topics."""

from __future__ import annotations

import re
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

import pytest

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import VALID, VEHICLE_VALID
from smallwheel_ros.onboard.declared import PARAMETERS
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE
from smallwheel_ros.pipeline.mobility.status import MarginSource, SoilStatus, Status
from smallwheel_ros.pipeline.mobility.wheel import HARDLY_TRAVELS
from smallwheel_ros.pipeline.warning.hazard import PERIOD, SLIP_S
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel

FOLDER = Path(__file__).resolve().parents[2] / "msg"
MESSAGES = sorted(path.stem for path in FOLDER.glob("*.msg"))
OF_DEVIATION = "_standard_deviation"


class Field(NamedTuple):
    """One field: its comment behind it; all comments before it since the last field."""

    type: str
    name: str
    comment: str
    before: str


def text_of(message: str) -> str:
    return (FOLDER / f"{message}.msg").read_text(encoding="utf-8")


def fields_of(message: str) -> list[Field]:
    found, before = [], []
    for line in text_of(message).splitlines():
        code, _, comment = (part.strip() for part in line.partition("#"))
        if not code:
            before.append(comment)
        elif "=" not in code:
            found.append(Field(*code.split(), comment, " ".join(before)))
            before = []
    return found


@pytest.mark.parametrize(
    ("message", "prefix", "enum"),
    [
        ("MobilityEstimate", "STATUS", Status),
        ("SoilEstimate", "STATUS", SoilStatus),
        ("VehicleMobility", "LEVEL", WarningLevel),
        ("VehicleMobility", "MARGIN", MarginSource),
    ],
)
def test_constants_and_their_comments_are_those_of_the_enum(
    message: str, prefix: str, enum: type[IntEnum]
) -> None:
    found = re.findall(rf"^uint8 {prefix}_(\w+) = (\d+) +# (.+)$", text_of(message), re.MULTILINE)
    assert found == [(one.name, str(int(one)), one.meaning) for one in enum]  # type: ignore[attr-defined]


def test_no_constant_is_left_out() -> None:
    found = re.findall(r"^uint8 [A-Z_]+ *=", "".join(map(text_of, MESSAGES)), re.MULTILINE)
    assert len(found) == sum(len(one) for one in (Status, SoilStatus, WarningLevel, MarginSource))


@pytest.mark.parametrize(
    ("message", "flags"), [("MobilityEstimate", VALID), ("VehicleMobility", VEHICLE_VALID)]
)
def test_a_flag_stands_before_what_it_is_about(
    message: str, flags: dict[str, tuple[str, ...]]
) -> None:
    """Its quantities follow it, each with its deviation, with no other flag between."""
    names = [field.name for field in fields_of(message)]
    assert {name for name in names if name.endswith("_valid")} == set(flags)
    for flag, about in flags.items():
        after = names[names.index(flag) + 1 :]
        own = after[: next((i for i, n in enumerate(after) if n.endswith("_valid")), len(after))]
        assert [name for name in own if name in about] == list(about), flag


@pytest.mark.parametrize("message", MESSAGES)
def test_each_number_has_its_unit_and_a_deviation_that_of_its_quantity(message: str) -> None:
    units = {}
    for field in fields_of(message):
        if field.type.startswith("float64"):
            found = re.match(r"\[([^\]]+)\]", field.comment or field.before.split(". ")[-1])
            listed = re.search(r"Units?: |\[([^\]]+)\]", field.comment + field.before)
            assert found or listed, field.name
            units[field.name] = found[1] if found else ""
    for name, unit in units.items():
        if name.endswith(OF_DEVIATION):
            assert unit == units[name.removesuffix(OF_DEVIATION)], name


@pytest.mark.parametrize("message", MESSAGES)
def test_parameters_that_comments_name_exist(message: str) -> None:
    comments = " ".join(re.findall(r"#(.*)$", text_of(message), re.MULTILINE))
    said = set(re.findall(r"(?:<wheel>|noise|vehicle|soil|timing|cost|load)\.[a-z_]+", comments))
    said |= set(re.findall(r"parameter +([a-z_]+\.[a-z_]+|<wheel>\.[a-z_]+)", comments))
    said |= set(re.findall(r"([a-z_]+) \(a parameter of the node\)", comments))
    assert said <= set(PARAMETERS), said - set(PARAMETERS)
    if message == "MobilityEstimate":
        assert {"reference_slip", "<wheel>.frame"} <= said


@pytest.mark.parametrize("message", MESSAGES)
def test_topics_and_fields_that_comments_name_exist(message: str) -> None:
    comments = " ".join(re.findall(r"#(.*)$", text_of(message), re.MULTILINE))
    node = (FOLDER.parent / "docs" / "node.md").read_text(encoding="utf-8")
    for topic in re.findall(r"~/[a-z_/<>]+[a-z>]", comments):
        assert f"`{topic}`" in node, topic
    known = {field.name for one in MESSAGES for field in fields_of(one)} | set(PARAMETERS)
    words = set(re.findall(r"\b[a-z]+_[a-z_]+[a-z]\b", comments)) - {"base_link", "frame_id"}
    words -= {name.removeprefix("<wheel>.") for name in PARAMETERS if name.startswith("<wheel>")}
    parts = {part for name in known for part in name.split(".")}
    assert words <= parts | {"smallwheel_ros"}, words - parts


def test_numbers_in_comments_are_those_of_the_code() -> None:
    wheel = {field.name: field for field in fields_of("MobilityEstimate")}
    vehicle = {field.name: field for field in fields_of("VehicleMobility")}
    soil = {field.name: field for field in fields_of("SoilEstimate")}
    assert f"at a slip over {HARDLY_TRAVELS:g}" in wheel["energy_valid"].before
    assert {10: "ten messages a second"}[SECOND // PERIOD] in text_of("VehicleMobility")
    assert {0.5: "over half a second"}[SLIP_S] in vehicle["slip_valid"].before
    assert f"model files have {REFERENCE_DIAMETER:g} m" in soil["reference_diameter"].comment
    assert soil["reference_sinkage"].comment.endswith(f", {REFERENCE_SINKAGE:g}")


def test_what_may_be_a_priors_says_where_that_is_told() -> None:
    """Margin, soil and strength: each number's comment names the field that says so."""
    wheel = {field.name: field.before for field in fields_of("MobilityEstimate")}
    vehicle = {field.name: field.before for field in fields_of("VehicleMobility")}
    assert "of a prior" in wheel["mobility_margin"]
    assert "status_text" in wheel["thrust"]
    assert "status_text" in vehicle["energy_valid"]
    assert (
        "prior" in text_of("SoilEstimate").split("bool k_identifiable")[0].split("# ---- What")[-1]
    )
