# SPDX-License-Identifier: Apache-2.0
"""What is fuzzed: each target takes bytes that nobody intended, and may refuse them in words only.

A target has seeds (valid inputs, from which mutations begin), words that mean something to it, and
`run`, which returns numbers that came out. What `run` raises besides SmallwheelError is a defect, and
so is a number that is not finite.
"""

from __future__ import annotations

import math
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.bags import BagReader, BagWriter, message_type
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.saved_state import read_state
from smallwheel_ros.estimator.soil_estimator import (
    SinkageMeasurement,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model_file import read_model
from smallwheel_ros.onboard.parameter_files import read_parameters, template
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.urdf import Urdf
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.plain_yaml import PlainYamlError, read_yaml

ROOT = Path(__file__).resolve().parent.parent
PRIOR = SoilPrior.from_soil(soil("dry_sand"))
NUMBERS = (b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-0", b"0", b"99999999999999999999")
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


class Target(ABC):
    """One way in."""

    name: str
    words: Sequence[bytes] = NUMBERS
    refusals: type[Exception] = SmallwheelError
    is_text = True

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seeds = self.make_seeds()

    @abstractmethod
    def make_seeds(self) -> list[bytes]:
        """Return valid inputs."""

    @abstractmethod
    def run(self, data: bytes) -> Iterator[float]:
        """Take an input; return the numbers that came of it, or raise SmallwheelError."""

    def written(self, data: bytes, name: str) -> Path:
        """Write a file for a reader that needs one."""
        path = self.folder / name
        path.write_bytes(data)
        return path


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
        return [plain.encode()]

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
        from smallwheel_ros.effects.slip_sinkage import Exponential
        from smallwheel_ros.model import Model
        from smallwheel_ros.model_file import CalibratedModel, parameter_names, write_model

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
        return [*super().make_seeds(), template().encode()]

    def run(self, data: bytes) -> Iterator[float]:
        found = settings_from(read_parameters(self.written(data, "rover.yaml")))
        for wheel in found.onboard.wheels:
            yield wheel.diameter


class SavedSoil(Target):
    """The soil that the node saved."""

    name = "saved_soil"
    words = (*NUMBERS, b"[[", b"{}", b"null", b'"log_covariance":', b"NaN")

    def make_seeds(self) -> list[bytes]:
        estimator = SoilEstimator(PRIOR)
        for i in range(300):
            estimator.update(
                SinkageMeasurement(
                    0.02 * i,
                    "w",
                    0.012,
                    2.5e-7,
                    60.0,
                    0.5,
                    0.25,
                    0.1,
                    0.02 * i,
                    slip=0.1,
                    speed=0.2,
                )
            )
        path = self.folder / "seed.json"
        estimator.save(path)
        return [path.read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        path = self.written(data, "soil.json")
        read_state(path, PRIOR, ())
        estimator = SoilEstimator(PRIOR)
        estimator.restore(path)
        found = estimator.estimate()
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


class Bag(Target):
    """A recorded bag, opened, and every message of it read, also where it is damaged."""

    suffix: str
    is_text = False
    words = (
        b"\x00" * 8,
        b"\xff" * 8,
        b"\x05\x89MCAP0\r\n",
        b"float64 x\n",
        b"string",
        b"[1000000000]",
    )

    def make_seeds(self) -> list[bytes]:
        folder = self.folder / f"seed_{self.suffix}"
        with BagWriter(folder, storage={"mcap": "mcap", "db3": "sqlite3"}[self.suffix]) as writer:
            time = message_type("builtin_interfaces/msg/Time")
            header = message_type("std_msgs/msg/Header")
            kind = message_type("smallwheel_ros/msg/WheelSinkage")
            for i in range(20):
                stamp = header(stamp=time(sec=i, nanosec=0), frame_id="front")
                message = kind(header=stamp, sinkage=0.01, variance=1e-6)
                writer.write(
                    "/front/sinkage", "smallwheel_ros/msg/WheelSinkage", i * 10**9, message
                )
        return [next(folder.glob(f"*.{self.suffix}")).read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        with BagReader(self.written(data, f"bag.{self.suffix}"), salvage=True) as reader:
            for raw in reader.raw_messages():
                yield float(raw.log_time)


class Mcap(Bag):
    """An mcap file."""

    name = "mcap"
    suffix = "mcap"


class Sqlite(Bag):
    """A sqlite3 file."""

    name = "sqlite"
    suffix = "db3"


class Messages(Target):
    """What comes over topics: a drive in which any field of any message may be anything.

    The bytes choose: which topic, which field, which value. What is spoilt comes beside the sound
    messages of the drive, of which some at least must still become estimates.
    """

    is_text = False
    name = "messages"
    words = (b"\x00", b"\xff", b"\x7f\xf0", b"\x01\x02\x03\x04")
    values = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -1.0, 1e9, -1e-9, 1e-9)
    integers = (0, -1, 2**31 - 1, -(2**31), 1, 999_999_999)

    def make_seeds(self) -> list[bytes]:
        return [bytes(range(60)), b"\x00" * 40, bytes(range(255, 0, -2))]

    def run(self, data: bytes) -> Iterator[float]:
        from fuzz import drive_messages

        feed, drive = drive_messages.feed(), drive_messages.drive()
        choices = iter(data)
        count = 0
        for topic, message, stamp in drive:
            results = list(feed[topic](message(), stamp))
            choice = next(choices, None)
            if choice is not None and choice % 3 == 0:
                spoilt = message()
                self._spoil(spoilt, next(choices, 0), next(choices, 0))
                results += feed[topic](spoilt, stamp)
            count += len(results)
            for result in results:
                yield from drive_messages.numbers(result)
        if not count:
            yield math.nan  # one spoilt message in three must not silence the rest

    def _spoil(self, message: Any, which: int, how: int) -> None:
        """Set one field, however deep, to a value that it should not have."""
        leaves = list(_leaves(message))
        owner, name, value = leaves[which % len(leaves)]
        if isinstance(value, str):
            setattr(owner, name, ("", "\x00", "é" * 300, "map")[how % 4])
        elif isinstance(value, bool | int):
            setattr(owner, name, self.integers[how % len(self.integers)])
        elif isinstance(value, float):
            setattr(owner, name, self.values[how % len(self.values)])
        elif isinstance(value, np.ndarray):
            bad = np.full(max(len(value) + how % 3 - 1, 0), self.values[how % len(self.values)])
            setattr(owner, name, bad)
        elif isinstance(value, list):
            setattr(owner, name, [value[:1], [], value * 2, ["x"] * 40][how % 4])


def _leaves(message: Any) -> Iterator[tuple[Any, str, Any]]:
    """The fields of a message that are no messages, however deep: owner, name, value."""
    for field in fields(message):
        value = getattr(message, field.name)
        if is_dataclass(value):
            yield from _leaves(value)
        elif not field.name.startswith("__"):
            yield message, field.name, value


def scratch() -> Path:
    """Return a folder for files of a target, in memory where there is such a place."""
    shared = Path("/dev/shm")
    return Path(
        tempfile.mkdtemp(prefix="fuzz-", dir=shared if os.access(shared, os.W_OK) else None)
    )


def is_good(value: float) -> bool:
    """Whether a number may come out."""
    return math.isfinite(value)
