# SPDX-License-Identifier: Apache-2.0
"""Maps of elevations: their layout as grid_map has it, slopes of known ground, and what is refused."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from smallwheel_ros.costmap.elevation import elevation_from, layer_of, slopes
from smallwheel_ros.costmap.grid import CostMapError

INFO = "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"
GRID_MAP = """std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
"""
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(
    get_types_from_msg(INFO, "grid_map_msgs/msg/GridMapInfo")
    | get_types_from_msg(GRID_MAP, "grid_map_msgs/msg/GridMap")
)


def grid_map(
    layers: dict[str, np.ndarray],
    resolution: float = 0.1,
    place: tuple[float, float] = (2.0, -1.0),
    start: tuple[int, int] = (0, 0),
    frame: str = "odom",
    **changes: Any,
) -> Any:
    """A message as a bag has it. layers: shape (rows along y, columns along x), from the smallest on.

    As grid_map stores them: index (i, j) at x_max - i, y_max - j, of a ring that begins at `start`, column by
    column (GridMapRosConverter::toMessage).
    """
    one = STORE.types
    array = one["std_msgs/msg/Float32MultiArray"]
    dimension = one["std_msgs/msg/MultiArrayDimension"]
    data = []
    for values in layers.values():
        stored = np.roll(values[::-1, ::-1].T, start, axis=(0, 1))  # [i, j]
        count = stored.size
        dims = [
            dimension("column_index", stored.shape[1], count),
            dimension("row_index", stored.shape[0], stored.shape[0]),
        ]
        layout = one["std_msgs/msg/MultiArrayLayout"](dims, 0)
        data.append(array(layout, np.asarray(stored.flatten(order="F"), dtype=np.float32)))
    rows, columns = next(iter(layers.values())).shape
    stamp = one["builtin_interfaces/msg/Time"](5, 0)
    pose = one["geometry_msgs/msg/Pose"](
        one["geometry_msgs/msg/Point"](*place, 0.0),
        one["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    info = one["grid_map_msgs/msg/GridMapInfo"](
        resolution, columns * resolution, rows * resolution, pose
    )
    message = one["grid_map_msgs/msg/GridMap"](
        one["std_msgs/msg/Header"](stamp, frame), info, list(layers), [], data, *start
    )
    # Through the bytes of a bag, as readers get it.
    read = STORE.deserialize_cdr(
        STORE.serialize_cdr(message, message.__msgtype__), message.__msgtype__
    )
    for name, value in changes.items():
        setattr(read, name, value)
    return read


class TestLayout:
    @settings(max_examples=examples(40))
    @given(
        rows=st.integers(1, 7),
        columns=st.integers(1, 9),
        start=st.tuples(st.integers(0, 8), st.integers(0, 6)),
    )
    def test_cells_come_out_where_they_were_whatever_the_ring_begins_with(
        self, rows: int, columns: int, start: tuple[int, int]
    ) -> None:
        values = np.arange(rows * columns, dtype=float).reshape(rows, columns)
        begin = start[0] % columns, start[1] % rows
        found = layer_of(grid_map({"a": values + 7, "b": values}, start=begin), "b")
        assert found.tolist() == values.tolist()

    def test_the_map_s_place_is_its_middle(self) -> None:
        heights = np.zeros((30, 50))
        heights[:, 40:] = np.nan
        found = elevation_from(grid_map({"elevation": heights}), "elevation", 0.5)
        assert found.frame == "odom"
        assert found.origin == pytest.approx((2.0 - 2.5, -1.0 - 1.5))
        assert found.slope.shape == (30, 50)
        assert np.isfinite(found.slope[15, 20])
        assert np.isnan(found.slope[15, 47])


class TestSlopes:
    @settings(max_examples=examples(25))
    @given(east=st.floats(-0.5, 0.5), north=st.floats(-0.5, 0.5), seed=st.integers(0, 99))
    def test_a_plane_with_holes_has_its_slope_and_no_deviation(
        self, east: float, north: float, seed: int
    ) -> None:
        y, x = (0.1 * index for index in np.ogrid[:40, :60])
        heights = 300.0 + east * x + north * y
        heights[np.random.default_rng(seed).uniform(size=heights.shape) < 0.15] = np.nan
        slope, deviation = slopes(heights, 0.1, 0.9)
        told = np.isfinite(slope)
        assert told[8:-8, 8:-8].mean() > 0.9
        assert slope[told] == pytest.approx(math.hypot(east, north), abs=1e-6)
        assert deviation[told].max() < 1e-5

    def test_noise_of_a_centimetre_and_holes_are_within_what_is_said(self) -> None:
        rng = np.random.default_rng(3)
        y, x = (0.1 * index for index in np.ogrid[:200, :200])
        for true in (0.0, 0.09, 0.175):
            heights = true * x + 0.0 * y + 0.01 * rng.standard_normal((200, 200))
            heights[rng.uniform(size=heights.shape) < 0.15] = np.nan
            slope, deviation = slopes(heights, 0.1, 0.9)
            told = np.isfinite(slope)
            off = slope[told] - true
            if true:
                assert math.sqrt(np.mean(off**2)) < 0.006
            assert np.mean(np.abs(off) < 2.0 * deviation[told]) > 0.99

    def test_bumps_make_it_unsure(self) -> None:
        y, x = (0.1 * index for index in np.ogrid[:60, :60])
        smooth = slopes(0.1 * x + 0.0 * y, 0.1, 0.9)[1]
        rough = slopes(0.1 * x + 0.1 * np.sin(12.0 * x) * np.sin(12.0 * y), 0.1, 0.9)[1]
        assert np.nanmedian(rough) > 10.0 * np.nanmedian(smooth) + 0.05

    def test_where_less_than_most_is_known_nothing_is_said(self) -> None:
        heights = np.zeros((60, 60))
        heights[:, 30:] = np.nan
        slope, _ = slopes(heights, 0.1, 0.9)
        assert np.isfinite(slope[30, 10])
        assert np.isnan(slope[30, 30:]).all()


def turned(message: Any) -> Any:
    message.info.pose.orientation.z = message.info.pose.orientation.w = math.sqrt(0.5)
    return message


def laid_out(message: Any, *labels: str) -> Any:
    for one, label in zip(message.data[0].layout.dim, labels, strict=True):
        one.label = label
    return message


def other_size(message: Any) -> Any:
    message.info.length_x = 9.0
    return message


def named(*layers: str) -> Any:
    """Gives a message with other names of its layers."""
    return lambda message: SimpleNamespace(**{**vars(message), "layers": list(layers)})


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (named("height"), "no layer 'elevation', it has height"),
        (named(), "no layer 'elevation', it has none"),
        (turned, "is turned in its frame"),
        (lambda m: laid_out(m, "x", "y"), "has the layout x, y, expected column_index, row_index"),
        (other_size, r"600 cells, 30 by 20; its lengths over its resolution say 90 by 20"),
    ],
)
def test_a_map_that_cannot_be_used_is_refused_in_words(spoil: Any, words: str) -> None:
    with pytest.raises(CostMapError, match=words):
        elevation_from(spoil(grid_map({"elevation": np.zeros((20, 30))})), "elevation", 0.5)


@pytest.mark.parametrize(
    ("heights", "changes", "words"),
    [
        (np.full((20, 30), np.nan), {}, "no cell of its layer 'elevation' is known"),
        (np.zeros((20, 30)), {"frame": ""}, "no frame: header.frame_id is empty"),
        (np.zeros((20, 30)), {"place": (math.nan, 0.0)}, "its middle is at nan"),
        (
            np.zeros((20, 30)),
            {"inner_start_index": 20},
            "inner_start_index is 20 .* less than 20 and 30",
        ),
        (
            np.zeros((20, 30)),
            {"outer_start_index": 30},
            "outer_start_index 30, expected less than 20 and",
        ),
    ],
)
def test_numbers_that_are_none_are_refused(
    heights: np.ndarray, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(CostMapError, match=words):
        elevation_from(grid_map({"elevation": heights}, **changes), "elevation", 0.5)


def test_layers_of_classes_are_probabilities() -> None:
    sand, silly = np.full((20, 30), 0.7), np.full((20, 30), 7.0)
    message = grid_map(
        {"elevation": np.zeros((20, 30)), "sand": sand, "grass": silly, "person": sand}
    )
    found = elevation_from(message, "elevation", 0.5, ("sand", "mud", "grass"))
    assert set(found.classes) == {"sand", "grass"}
    assert found.classes["sand"] == pytest.approx(0.7, abs=1e-6)
    assert found.classes["grass"].max() == 1.0
