# SPDX-License-Identifier: Apache-2.0
"""Tests `declared.py`, `prior.py`, `settings.py` and `template.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
import yaml
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.common.node_parameter import (
    NodeParameter,
    filled,
    group,
    group_per_wheel,
    parameter,
    rows_of,
    topic,
)
from smallwheel_ros.costmap.cost import CostSettings
from smallwheel_ros.effects.registry import effect, effect_class
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.init.rover import rover_of_wheels
from smallwheel_ros.model.measured import Measured
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import write_model
from smallwheel_ros.onboard.declared import (
    GENERAL,
    PARAMETERS,
    PER_WHEEL,
    Parameters,
    SensorNoise,
    Timing,
    parameters_for,
)
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    problems,
    read_parameters,
    settings_from,
    unknown_parameters,
)
from smallwheel_ros.onboard.prior import EstimatorSettings
from smallwheel_ros.onboard.template import template
from smallwheel_ros.physics.soil import soil

TWO_WHEELS = {
    "wheels": ["a", "b"],
    **{f"{name}.{key}": 0.2 for name in "ab" for key in ("diameter", "width")},
}
ONE_WHEEL = {"wheels": ["front"], "front.diameter": 0.25, "front.width": 0.1}


@dataclass(frozen=True, kw_only=True)
class Radar:
    delay: float = parameter(0.1, "s", (0.0, 1.0), "Delay.")
    kind: Literal["short", "long"] | None = parameter(None, text="Kind.")


@dataclass(frozen=True, kw_only=True)
class Hitch:
    width: float = parameter(None, "m", (0.1, 2.0), "Width.", required=True)
    topic: str = topic("<wheel>/hitch", "Topic.")


@dataclass(frozen=True, kw_only=True)
class WithRadar(Parameters):
    names: tuple[str, ...] = parameter(("a",), text="Names.")
    radar: Radar = group(Radar)
    hitches: Mapping[str, Hitch] = group_per_wheel(Hitch)


class TestTable:
    def test_every_default_is_allowed(self) -> None:
        for one in parameters_for(["front"]):
            if one.default is not None:
                assert one.problem(one.default) is None, one.name

    def test_every_number_has_a_range_and_every_parameter_words(self) -> None:
        for one in GENERAL + PER_WHEEL:
            assert one.description.endswith("."), one.name
            if one.kind == "double":
                assert one.unit, one.name
                assert one.low is not None, one.name
                assert one.high is not None, one.name

    def test_names_are_unique(self) -> None:
        names = [p.name for p in parameters_for(["a", "b"])]
        assert len(set(names)) == len(names)

    def test_parameters_of_a_group_stand_together(self) -> None:
        groups = [p.name.split(".")[0] for p in parameters_for(["front"])]
        begins = [g for i, g in enumerate(groups) if i == 0 or groups[i - 1] != g]
        assert len(set(begins)) == len(begins)

    def test_a_declaration_is_all_that_a_parameter_takes(self) -> None:
        rows = rows_of(WithRadar)
        found = {row.name: row for row in rows}
        assert [row.name for row in rows][:3] == ["names", "radar.delay", "radar.kind"]
        assert set(PARAMETERS) < set(found)
        delay = NodeParameter("radar.delay", "double", 0.1, "Delay.", "s", 0.0, 1.0)
        assert found["radar.delay"] == delay
        assert found["radar.kind"].choices == ("short", "long")
        assert found["<wheel>.width"].required
        assert found["<wheel>.topic"].for_wheel("left").default == "left/hitch"
        values = {p.name: p.default for row in rows for p in (row.for_wheel("left"),)}
        values |= {"wheels": ["left"], "left.diameter": 0.2, "left.width": 0.7, "radar.delay": 0.3}
        made = filled(WithRadar, values)
        assert made.radar == Radar(delay=0.3)
        assert made.hitches["left"] == Hitch(width=0.7, topic="left/hitch")
        assert made.inputs["left"].joint == "left_joint"
        assert made.wheels == ("left",)


class TestSettings:
    def test_defaults(self) -> None:
        made = settings_from(ONE_WHEEL)
        assert made.onboard.estimator == EstimatorSettings()
        assert made.onboard.noise == SensorNoise()
        assert made.onboard.timing == Timing()
        wheel = made.onboard.wheels[0]
        assert (wheel.name, wheel.diameter, wheel.width) == ("front", 0.25, 0.1)
        assert made.inputs["front"].load_topic == "front/load"
        assert made.inputs["front"].sinkage_topic == "front/sinkage"
        assert made.inputs["front"].joint == "front_joint"
        assert made.onboard.prior.soil.name == "dry_sand"
        assert made.onboard.effects == ()
        assert made.onboard.static_loads == {}
        assert made.onboard.velocity == "odometry"
        assert made.load.source == "wrench"
        assert made.cost == CostSettings()

    def test_values_arrive(self) -> None:
        made = settings_from(
            {
                **ONE_WHEEL,
                "soil.name": "moist_earth",
                "noise.sinkage": 0.002,
                "sinkage_zero_std": 3e-4,
                "noise.load": 3.0,
                "timing.reorder_time": 0.5,
                "front.contact": "pressed",
                "front.sinkage_topic": "",
                "front.load_sign": -1,
            }
        )
        onboard = made.onboard
        assert onboard.prior.m == -0.49  # of that soil
        assert onboard.strength.cohesion.value == soil("moist_earth").cohesion
        assert onboard.estimator.sinkage_std == 0.002
        assert onboard.estimator.sinkage_zero_std == 3e-4
        assert onboard.noise.load == 3.0
        assert onboard.timing.reorder_time == 0.5
        assert onboard.wheels[0].contact == "pressed"
        assert onboard.without_sinkage == {"front"}
        assert made.inputs["front"].load_sign == -1

    def test_signs_are_of_each_wheel(self) -> None:
        inputs = settings_from({**TWO_WHEELS, "b.load_sign": -1, "b.joint_sign": -1}).inputs
        assert (inputs["a"].load_sign, inputs["a"].joint_sign) == (1, 1)
        assert (inputs["b"].load_sign, inputs["b"].joint_sign) == (-1, -1)

    def test_the_soil_is_reported_at_the_mean_diameter(self) -> None:
        assert settings_from({**TWO_WHEELS, "b.diameter": 0.4}).onboard.mean_diameter == 0.3

    def test_torque_is_measured_where_an_effort_has_one(self) -> None:
        made = settings_from({**TWO_WHEELS, "b.torque_per_effort": 24.0})
        assert made.onboard.with_torque == {"b"}

    def test_static_loads_are_the_weight_split_over_the_wheels(self) -> None:
        two = {**TWO_WHEELS, "load.source": "static", "vehicle.mass": 20.0}
        loads = settings_from(two).onboard.static_loads
        assert loads["a"].value == loads["b"].value == pytest.approx(98.0665)
        assert loads["a"].standard_deviation == pytest.approx(0.3 * 98.0665)
        shared = {**two, "a.load_share": 0.6, "b.load_share": 0.4}
        loads = settings_from(shared).onboard.static_loads
        assert loads["b"].value == pytest.approx(0.4 * 196.133)
        assert loads["b"].standard_deviation == pytest.approx(0.12 * 196.133)

    @pytest.mark.parametrize("name", ["load", "/a/b_1", "~/load", "A/b/c"])
    def test_names_of_topics(self, name: str) -> None:
        made = settings_from({**ONE_WHEEL, "front.load_topic": name})
        assert made.inputs["front"].load_topic == name

    def test_velocity_sources(self) -> None:
        def source(**changes: object) -> str:
            return settings_from({**ONE_WHEEL, **changes}).onboard.velocity

        assert source(velocity_topic="radar") == "topic"
        assert source(odometry_from_wheels=True) == "none"
        assert source(odometry_from_wheels=True, velocity_topic="r") == "topic"

    def test_a_range_sensor_has_its_height(self) -> None:
        made = settings_from({**ONE_WHEEL, "front.range_height": 0.31})
        assert made.inputs["front"].range_height == 0.31

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"front.diameter": 0.0}, "front.diameter is 0.0, expected a double from 0.005 to 5 m"),
            ({"front.diameter": True}, "front.diameter is bool True, expected a double from 0.005"),
            ({"front.diameter": 9}, "front.diameter is 9, expected a double from 0.005 to 5 m"),
            ({"vehicle.mass": 10**400}, "vehicle.mass is 1000000.*, expected a double from 0.01"),
            ({"odom_topic": ""}, "odom_topic is '', expected the name of a topic"),
            ({"all_wheels.width": 9.0}, "all_wheels.width is 9.0, expected a double from 0.001"),
            ({"wheels": ["all_wheels"]}, "'all_wheels': there is a group of parameters of that"),
            ({"front.diameter": "0.2"}, "front.diameter is string '0.2', .*without quotes"),
            ({"front.diameter": float("nan")}, "front.diameter is nan"),
            ({"front.diameter": None}, "front.diameter is missing, expected a double"),
            ({"front.width": -0.1}, r"front.width is -0\.1"),
            (
                {"front.contact": "plate"},
                "front.contact is 'plate', expected 'rolling' or 'pressed'",
            ),
            (
                {"front.joint": 5},
                "front.joint is integer 5, expected a string: write '5' in quotes",
            ),
            ({"front.load_sign": 0}, "load_sign is 0, expected 1 or -1"),
            ({"front.load_sign": 10**400}, "load_sign is 1000000000.*, expected 1 or -1"),
            ({"front.load_sign": 1.0}, r"load_sign is double 1\.0, .*: write 1"),
            ({"front.joint_sign": 0}, "front.joint_sign is 0, expected 1 or -1"),
            ({"vehicle.mass": 0.0}, r"vehicle.mass is 0\.0, expected a double from 0\.01"),
            ({"sinkage_zero_std": -0.001}, r"sinkage_zero_std is -0\.001"),
            ({"gravity": 0.0}, r"gravity is 0\.0, expected a double from 0\.01 to 100"),
            ({"gravity": -1.62}, r"gravity is -1\.62, expected a double from 0\.01"),
            ({"autostart": 1}, "autostart is integer 1, expected a bool"),
            ({"soil.name": "dry_snad"}, "soil.name: no soil 'dry_snad': did you mean 'dry_sand'"),
            ({"load.source": "static"}, "vehicle.mass is missing: load.source static needs"),
            ({"load.source": "scale"}, "load.source is 'scale', expected 'wrench' or 'joint_st"),
            (
                {"load.source": "static", "vehicle.mass": 9.0, "front.load_share": 0.5},
                "1 of 1 wheels have one, with a sum of 0.5",
            ),
            ({"cost.size": 400.0, "cost.resolution": 0.01}, "cells, expected at most 4000000"),
            ({"effects_file": "mine.py"}, "effects_file is given without model_file"),
            ({"model_file": "none.yaml"}, "none.yaml: cannot be read"),
            ({"model_file": "/dev/zero"}, "/dev/zero: cannot be read: it is a device or a pipe"),
            ({"model_file": "a\0b"}, "the name is not possible"),
            ({"soil.file": "~nouser/x"}, "soil.file is '~nouser/x', expected the path of a file"),
            ({"soil.file": "x" * 5000}, "File name too long"),
            ({"front.load_topic": "a b"}, "'a b', expected the name of a topic"),
            ({"front.load_topic": "a/"}, "'a/', expected the name of a topic"),
            ({"front.load_topic": "//a"}, "'//a', expected the name of a topic"),
            ({"front.load_topic": "a~"}, "'a~', expected the name of a topic"),
            ({"front.load_topic": "läst"}, "expected the name of a topic"),
            ({"velocity_topic": "v" * 201}, "expected the name of a topic, at most 200 letters"),
            (
                {"reference_slip": 1.5},
                r"reference_slip is 1\.5, expected a double from 0\.02 to 0\.9",
            ),
            ({"wheels": []}, r"wheels is missing: name the wheels, for example wheels: \["),
            ({"wheels": "front"}, r"wheels is string 'front', .*: write \[front\]"),
            ({"wheels": ["front", "front"]}, "'front': it is there twice"),
            ({"wheels": ["soil"]}, "'soil': there is a group of parameters of that name"),
            ({"wheels": ["front left"]}, "'front left': expected letters, digits and _"),
        ],
    )
    def test_refusals_name_parameter_and_mend(self, changes: dict[str, object], words: str) -> None:
        with pytest.raises(ParametersError, match=words):
            settings_from({**ONE_WHEEL, **changes})

    def test_all_problems_are_said_at_once(self) -> None:
        found = problems({"wheels": ["a", "b"], "a.diameter": 0.0, "a.width": 0.1, "b.width": 9})
        assert len(found) == 3
        assert "a.diameter" in found[0]
        assert "b.diameter" in found[1]
        assert "b.width" in found[2]

    def test_a_wrong_value_of_all_wheels_is_said_once(self) -> None:
        wheels = {"wheels": ["a", "b"], "all_wheels.width": 0.1}
        (once,) = problems({**wheels, "all_wheels.diameter": "wide"})
        assert "all_wheels.diameter is string 'wide'" in once
        both = problems({**wheels, "all_wheels.diameter": "wide", "b.diameter": 9.0})
        assert [text.split()[1] for text in both] == ["all_wheels.diameter", "b.diameter"]
        assert problems({**wheels, "all_wheels.diameter": 0.3}) == []
        (topic,) = problems(
            {**wheels, "all_wheels.diameter": 0.3, "all_wheels.load_topic": "<wheel> x"}
        )
        assert "all_wheels.load_topic" in topic

    def test_an_integer_where_a_double_is_meant_is_taken(self) -> None:
        made = settings_from({**ONE_WHEEL, "vehicle.mass": 280, "imu_yaw": 0})
        assert (repr(made.vehicle.mass), repr(made.imu_yaw)) == ("280.0", "0.0")

    def test_a_topic_of_all_wheels_has_the_name_of_each(self) -> None:
        values = {
            "wheels": ["a", "b"],
            "all_wheels.diameter": 0.3,
            "all_wheels.width": 0.1,
            "all_wheels.sinkage_topic": "/range/<wheel>",
        }
        made = settings_from(values)
        assert [made.inputs[name].sinkage_topic for name in "ab"] == ["/range/a", "/range/b"]

    def test_a_wheel_has_its_own_then_what_all_have_then_the_description_then_the_default(
        self,
    ) -> None:
        values = {
            "wheels": ["a", "b"],
            "all_wheels.diameter": 0.3,
            "all_wheels.joint": "drive_<wheel>",
            "all_wheels.sinkage_topic": "",
            "b.diameter": 0.2,
            "a.width": 0.1,
        }
        described = {"b.width": 0.12, "b.diameter": 0.9, "a.lateral_position": 0.4}
        made = settings_from(values, described)
        assert [wheel.diameter for wheel in made.onboard.wheels] == [0.3, 0.2]
        assert [wheel.width for wheel in made.onboard.wheels] == [0.1, 0.12]
        assert [wheel.lateral_position for wheel in made.onboard.wheels] == [0.4, 0.0]
        assert [made.inputs[name].joint for name in "ab"] == ["drive_a", "drive_b"]
        assert made.onboard.without_sinkage == {"a", "b"}
        assert unknown_parameters({**values, "all_wheels.joints": "x"}, ["a", "b"]) == [
            "parameter all_wheels.joints is unknown and not used: did you mean 'all_wheels.joint'?"
        ]

    @pytest.mark.parametrize(("base_at", "behind"), [("middle", 0.0), ("rear_axle", 0.3)])
    def test_track_and_wheelbase_place_wheels_whose_names_say_where(
        self, base_at: str, behind: float
    ) -> None:
        names = ["front_left", "Middle_right", "left", "rear", "bogie_3"]
        values = {"wheels": names, "all_wheels.diameter": 0.3, "all_wheels.width": 0.1}
        values |= {"vehicle.track": 0.5, "vehicle.wheelbase": 0.6, "vehicle.base_at": base_at}
        values["bogie_3.lateral_position"] = 7.0
        wheels = settings_from(values, {"left.longitudinal_position": 5.0}).onboard.wheels
        found = [(w.lateral_position, w.longitudinal_position) for w in wheels]
        ahead = 0.3 + behind
        assert found == [
            (0.25, ahead),
            (-0.25, behind),
            (0.25, 5.0),
            (0.0, behind - 0.3),
            (7.0, 0.0),
        ]

    def test_places_that_contradict_the_track_are_refused(self) -> None:
        values = {"wheels": ["left"], "left.diameter": 0.3, "left.width": 0.1, "vehicle.track": 0.5}
        assert settings_from({**values, "left.lateral_position": 0.26}).onboard.wheels[0]
        words = (
            r"left.lateral_position is 0.4, but vehicle.track \(0.5\) says 0.25: expected the same"
        )
        with pytest.raises(ParametersError, match=words):
            settings_from({**values, "left.lateral_position": 0.4})
        settings = settings_from(
            values, {"left.lateral_position": 0.4}
        )  # a description comes first
        assert settings.onboard.wheels[0].lateral_position == 0.4

    def test_unknown_parameters_are_named_with_the_nearest(self) -> None:
        values = {
            **ONE_WHEEL,
            "front.widht": 0.1,
            "timing.reorder": 1.0,
            "bananas": True,
            "use_sim_time": True,
        }
        found = unknown_parameters(values, ["front"])
        assert len(found) == 3
        assert "front.widht is unknown and not used: did you mean 'front.width'?" in found[0]
        assert "did you mean 'timing.reorder_time'?" in found[1]
        assert "bananas is unknown and not used" in found[2]


@pytest.mark.parametrize(
    ("places", "unknown"),
    [
        ([None, None], "a, b"),
        ([(0.0, 0.3), (0.0, -0.3)], ""),
        ([(0.2, 0.0), (-0.2, 0.0)], ""),
        ([(0.2, 0.3), (0.2, 0.3)], "a, b"),
    ],
)
def test_positions_that_are_not_known_are_said_with_what_is_lost(
    places: list[tuple[float, float] | None], unknown: str
) -> None:
    values: dict[str, object] = {"wheels": ["a", "b"]}
    for name, place in zip("ab", places, strict=True):
        values |= {f"{name}.diameter": 0.2, f"{name}.width": 0.1}
        if place is not None:
            values[f"{name}.longitudinal_position"], values[f"{name}.lateral_position"] = place
    said = settings_from(values).onboard.unknown_positions
    assert bool(said) == bool(unknown)
    if unknown:
        for word in (f"({unknown}: all at one place)", "cost map", "slip in turns", "passes"):
            assert word in said
    pressed = settings_from({**values, "a.contact": "pressed", "b.contact": "pressed"})
    assert pressed.onboard.unknown_positions == ""


class TestModelFile:
    @pytest.fixture
    def model(self, tmp_path: Path) -> Path:
        path = tmp_path / "model.yaml"
        soils = [soil("moist_earth"), soil("dry_sand")]
        write_model(path, CalibratedModel(Model(soils, effects=[Exponential(a=1.3)])))
        return path

    def given(self, **changes: object) -> dict[str, object]:
        return {**ONE_WHEEL, **changes}

    def test_soil_and_effects_are_those_of_the_file(self, model: Path) -> None:
        values = self.given(model_file=str(model), **{"soil.name": "moist_earth"})
        made = settings_from(values).onboard
        assert made.effects == (Exponential(a=1.3),)
        assert made.prior.m == -0.49

    def test_several_soils_need_a_name(self, model: Path) -> None:
        with pytest.raises(ParametersError, match=r"model.yaml has several soils, parameter soil"):
            settings_from(self.given(model_file=str(model)))
        with pytest.raises(
            ParametersError, match=r"has no soil 'clay'.*xpected one of dry_sand, moist"
        ):
            settings_from(self.given(model_file=str(model), **{"soil.name": "clay"}))

    def test_one_soil_needs_none(self, tmp_path: Path) -> None:
        path = tmp_path / "model.yaml"
        write_model(path, CalibratedModel(Model(soil("moist_earth"))))
        made = settings_from(self.given(model_file=str(path))).onboard
        assert made.prior.soil.name == "moist_earth"

    def test_what_the_estimates_deviations_leave_out_is_in_a_note(self, tmp_path: Path) -> None:
        path, sand = tmp_path / "model.yaml", Model(soil("dry_sand"))
        measured = Measured(ranges={"load": (20.0, 130.0), "slip": (0.0, 0.5)})
        parts = (CalibratedModel(sand), CalibratedModel(sand + effect("slip_sinkage", a=0.8)))
        both = CalibratedModel(sand, measured=measured, rivals=tuple((0.5, one) for one in parts))
        write_model(path, both)
        note = settings_from(self.given(model_file=str(path))).onboard.model_note
        assert "deviations do not include what they differ by" in note
        assert "measured was load 20 N to 130 N and slip 0 to 0.5: beyond that" in note
        write_model(path, CalibratedModel(sand))
        assert settings_from(self.given(model_file=str(path))).onboard.model_note == ""

    def test_an_effects_file_is_run_once(self, tmp_path: Path) -> None:
        model, effects, proof = (tmp_path / name for name in ("m.yaml", "e.py", "runs"))
        effects.write_text(
            "from smallwheel_ros.effects.slip import Exponential\n"
            f"open({str(proof)!r}, 'a').write('x')\n"
            "from dataclasses import dataclass\n"
            "@dataclass(frozen=True)\nclass Mine(Exponential):\n    id = 'mine'\n"
        )
        write_model(model, CalibratedModel(Model(soil("dry_sand"))))
        settings_from(self.given(model_file=str(model), effects_file=str(effects)))
        assert proof.read_text() == "x"

    def test_the_geometry_of_the_file_is_the_robot_s(self, tmp_path: Path) -> None:
        path = tmp_path / "model.yaml"
        write_model(path, CalibratedModel(Model(soil("dry_sand"), geometry="closed_form")))
        onboard = settings_from(self.given(model_file=str(path))).onboard
        assert onboard.prior.geometry == "closed_form"

    def test_missing_covariates_are_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "model.yaml"
        effects = [effect_class("moisture", None)()]
        write_model(path, CalibratedModel(Model(soil("dry_sand"), effects=effects)))
        with pytest.raises(ParametersError, match="effect 'moisture' needs 'moisture'"):
            settings_from(self.given(model_file=str(path)))


class TestFiles:
    @pytest.mark.parametrize(("name", "text"), [("config/template.yaml", template())])
    def test_template_is_up_to_date(self, repository: Path, name: str, text: str) -> None:
        assert (repository / name).read_text() == text, (
            "run PYTHONPATH=. python docs/parameter_pages.py"
        )

    def test_template_gives_the_defaults(self, tmp_path: Path) -> None:
        path = tmp_path / "template.yaml"
        path.write_text(template())
        assert settings_from(read_parameters(path)).onboard.timing == Timing()
        # With every comment sign before a default taken off, the defaults are all spelled out.
        table = parameters_for(["front_left"])
        names = {part for p in table for part in p.name.split(".")}
        lines = []
        for line in template().splitlines():
            bare = line.strip().removeprefix("# ")
            name, sign, value = bare.partition(":")
            group = not value and any(p.name.startswith(f"{name}.") for p in table)
            if line.strip().startswith("# ") and sign and name in names and (value or group):
                line = line.replace("# ", "", 1)
            lines.append(line)
        path.write_text("\n".join(lines))
        values = read_parameters(path)
        expected = {p.name: p.default for p in table if p.default is not None}
        assert {name: values.get(name) for name in expected} == expected

    def test_shipped_files_are_good(self, repository: Path) -> None:
        paths = sorted((repository / "config").glob("*.yaml"))
        found = 0
        for path in paths:
            if "ros__parameters" not in path.read_text() or "\n    wheels:" not in path.read_text():
                continue
            found += 1
            values = read_parameters(path)
            assert settings_from(values).onboard.wheels
            assert unknown_parameters(values, values["wheels"]) == [], path
        assert found >= 4

    def test_sections(self, tmp_path: Path) -> None:
        path = tmp_path / "rover.yaml"
        path.write_text(
            "/**:\n  ros__parameters:\n    reference_slip: 2e-1\n    noise: {load: 1.5}\n"
            "other_node:\n  ros__parameters:\n    imu_yaw: 1.0\n"
            "/ns/mobility_estimator:\n  ros__parameters:\n    noise:\n      load: 2.5\n"
        )
        assert read_parameters(path) == {"reference_slip": 0.2, "noise.load": 2.5}

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("other:\n  ros__parameters: {a: 1}\n", "found other, expected a section /\\*\\*:"),
            ("", "found nothing"),
            ("/**:\n  wheels: [a]\n", "section /\\*\\* has no ros__parameters"),
            ("/**: [", "not YAML text: line 1: "),
            ("a\x00b", "not YAML text"),
        ],
    )
    def test_bad_files(self, tmp_path: Path, text: str, words: str) -> None:
        path = tmp_path / "rover.yaml"
        path.write_text(text)
        with pytest.raises(ParametersError, match=words) as caught:
            read_parameters(path)
        assert str(path) in str(caught.value)

    def test_missing_file(self, tmp_path: Path) -> None:
        with pytest.raises(ParametersError, match=r"no\.yaml: cannot be read: No such file"):
            read_parameters(tmp_path / "no.yaml")

    def test_the_command_prints_it_wherever_it_is_installed(self) -> None:
        """An installed wheel has no config/: what messages name has to be in it."""
        done = CliRunner().invoke(main, ["init", "--template"])
        assert (done.exit_code, done.output) == (0, template())
        (unknown,) = unknown_parameters({"zzzzzzzz": 1}, ["left"])
        for text in (unknown, rover_of_wheels(2).parameter_file()):
            assert "`smallwheel init --template`" in text
            assert "config/" not in text

    def test_template_is_plain_yaml_too(self) -> None:
        assert yaml.safe_load(template())["/**"]["ros__parameters"]["wheels"] == ["front_left"]
