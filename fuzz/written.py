# SPDX-License-Identifier: Apache-2.0
"""The files that people write, edit and bring along: tables, parameters, models, soils, robots."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from fuzz.target import NUMBERS, ROOT, Target
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.model.model_file import read_model
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.onboard.robot_description import Urdf
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import soil, usual_strength
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.soil.saved_state import read_state

SAND = soil("dry_sand")
VEHICLE = OnboardSettings((Wheel("w", 0.25, 0.1),), SoilPrior.from_soil(SAND), usual_strength(SAND))
YAML_WORDS = (
    *NUMBERS,
    b"&a ",
    b"*a",
    b"!!int ",
    b"<<: ",
    b"- ",
    b": ",
    b"[[",
    b"{",
    b"}",
    b"'",
    b"\t",
)


def numbers_in(thing: Any) -> Iterator[float]:
    """Every number in nested lists, dictionaries and arrays."""
    if isinstance(thing, dict):
        thing = thing.values()
    if isinstance(thing, np.ndarray):
        yield from thing.astype(float).ravel().tolist() if thing.dtype.kind in "fiub" else ()
    elif isinstance(thing, float | int):
        yield float(thing)
    elif not isinstance(thing, str | bytes) and hasattr(thing, "__iter__"):
        for part in thing:
            yield from numbers_in(part)


class Table(Target):
    """A table of measurements, as text."""

    name = "table"
    words = (
        *NUMBERS,
        b",",
        b";",
        b"\t",
        b"\n",
        b'"',
        b"[mm]",
        b"(N)",
        b"\xff\xfe",
        b"\x00",
        b"Mean",
        b"%",
    )

    def make_seeds(self) -> list[bytes]:
        rows = "\n".join(
            f"{20 + 10 * i},0.2,0.1,{4 + 0.7 * i:.2f},{0.05 * i:.2f},{i}" for i in range(8)
        )
        plain = "load [N],diameter [m],width [m],sinkage [mm],slip,run\n" + rows + "\n"
        comma = "\n".join(
            f"Sand {i % 2};{20 + 10 * i},5;{4 + 0.7 * i:.2f};20;10".replace(".", ",")
            for i in range(8)
        )
        german = "# Rad\nBoden;Radlast;Einsinkung;Durchmesser;Breite\n;N;mm;cm;cm\n" + comma + "\n"
        names = (
            "load,diameter,width,sinkage,resistance,slip_angle [deg],pass_number,contact,moisture"
        )
        more = "\n".join(
            f"{30 + i},0.2,0.1,{0.004 + 1e-4 * i:.4f},,{i},{1 + i // 4},,{0.1 * i}"
            for i in range(8)
        )
        return [plain.encode(), german.encode(), f"{names}\n{more}\n".encode()]

    def run(self, data: bytes) -> Iterator[float]:
        found = read_measurements(self.written(data, "table.csv"))
        yield from found.conditions.load.tolist()
        for values in found.channels.values():
            known = np.asarray(values, float)
            yield from known[~np.isnan(known)].tolist()  # a blank cell is NaN by contract


class Parquet(Table):
    """The same as Parquet."""

    is_text = False
    name = "parquet"
    words = (b"PAR1", b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\x15\x02")

    def make_seeds(self) -> list[bytes]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {
            "load": np.linspace(20.0, 90.0, 8),
            "diameter": np.full(8, 0.2),
            "width": np.full(8, 0.1),
            "sinkage": np.linspace(0.004, 0.011, 8),
        }
        path = self.folder / "seed.parquet"
        pq.write_table(pa.table(columns), path)
        return [path.read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        found = read_measurements(self.written(data, "table.parquet"))
        yield from found.conditions.load.tolist()


class Yaml(Target):
    """Plain YAML, as parameter files and model files have it."""

    name = "yaml"
    words = YAML_WORDS
    refusals: type[Exception] = PlainYamlError

    def make_seeds(self) -> list[bytes]:
        return [
            (ROOT / "config" / name).read_bytes() for name in ("four_wheels.yaml", "press_rig.yaml")
        ]

    def run(self, data: bytes) -> Iterator[float]:
        yield from numbers_in(read_yaml(self.written(data, "any.yaml")))


class ModelFile(Target):
    """A model file."""

    name = "model"
    words = (*YAML_WORDS, b"effects:", b"soil:", b"covariance:", b"slip_sinkage")

    def make_seeds(self) -> list[bytes]:
        from smallwheel_ros.effects.slip import Exponential
        from smallwheel_ros.model.model import CalibratedModel, Model
        from smallwheel_ros.model.model_file import parameter_names, write_model

        model = Model(soil("dry_sand")) + Exponential()
        names = parameter_names(model.soils, model.effects)
        path = self.folder / "seed.yaml"
        write_model(path, CalibratedModel(model, names, np.eye(len(names)) * 1e-4))
        return [path.read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        found = read_model(self.written(data, "model.yaml"))
        yield from numbers_in(found.covariance)


class Parameters(Yaml):
    """The node's parameter file, up to settings."""

    name = "parameters"
    refusals = SmallwheelError

    def make_seeds(self) -> list[bytes]:
        return [*super().make_seeds(), (ROOT / "config" / "template.yaml").read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        found = settings_from(read_parameters(self.written(data, "rover.yaml")))
        for wheel in found.onboard.wheels:
            yield wheel.diameter


class SavedSoil(Target):
    """The soil that the node saved."""

    name = "saved_soil"
    words = (*NUMBERS, b"[[", b"{}", b"null", b'"log_covariance":', b"NaN")

    def make_seeds(self) -> list[bytes]:
        pipeline = Pipeline(VEHICLE)
        for i in range(1, 1000):
            stamp, load = 20_000_000 * i, 60.0 + 20.0 * math.sin(0.1 * i)
            for name, values in (
                ("odom", (0.2, 0.0, 0.004 * i, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
                ("w/wheel_speed", (0.22 / 0.125,)),
                ("w/load", (load,)),
                ("w/sinkage", (2e-4 * load, 2.5e-7)),
            ):
                pipeline.streams.add(name, stamp, values)
        for _ in pipeline.turns(last=True):
            pass
        path = self.folder / "seed.json"
        pipeline.save(path)
        return [path.read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        path = self.written(data, "soil.json")
        read_state(path, VEHICLE.prior, ())
        pipeline = Pipeline(VEHICLE)
        pipeline.restore(path)
        found = pipeline.soil
        yield from (found.k, found.n, found.m)
        yield from numbers_in(found.log_covariance)


class RobotDescription(Target):
    """A robot description."""

    name = "urdf"
    words = (
        *NUMBERS,
        b"<joint",
        b"<link",
        b'"',
        b"&amp;",
        b"<!ENTITY a 'b'>",
        b"]]>",
        b"<cylinder",
    )

    def make_seeds(self) -> list[bytes]:
        return [
            b'<robot name="r"><link name="base_link"/><link name="w"><collision><geometry>'
            b'<cylinder radius="0.1" length="0.08"/></geometry></collision></link>'
            b'<joint name="j" type="continuous"><parent link="base_link"/><child link="w"/>'
            b'<origin xyz="0.3 0.2 0.1" rpy="1.5708 0 0"/><axis xyz="0 0 1"/></joint></robot>'
        ]

    def run(self, data: bytes) -> Iterator[float]:
        found = Urdf(data.decode(errors="replace"))
        for joint in found.joints.values():
            yield from numbers_in(joint.axis)
            yield from numbers_in(found.pose(joint.child, found.root(joint.child)))
            yield from numbers_in(found.cylinder(joint.child))


WRITTEN = (Table, Parquet, Yaml, Parameters, ModelFile, SavedSoil, RobotDescription)
