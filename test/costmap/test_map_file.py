# SPDX-License-Identifier: Apache-2.0
"""Cost maps as files of Nav2's map_server."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from smallwheel_ros.costmap.grid import CostMapError, Grid, read_map, write_map


@given(
    cells=arrays(
        np.int8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(-1, 100)
    ),
    origin=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
)
def test_what_is_written_is_read(
    tmp_path_factory: pytest.TempPathFactory, cells: np.ndarray, origin: tuple[float, float]
) -> None:
    path = tmp_path_factory.mktemp("map") / "cost_map.yaml"
    write_map(path, Grid("map", 0.1, origin, cells))
    found = read_map(path)
    assert found.geometry == ("map", 0.1, origin, cells.shape)
    assert np.array_equal(found.cells, cells)


def test_it_is_as_map_server_reads_it(tmp_path: Path) -> None:
    """nav2_map_server, map_io.cpp: raw takes a pixel for the cost, over 100 for unknown; top row first."""
    cells = np.array([[0, 100, -1], [7, 50, 99]], np.int8)
    write_map(tmp_path / "cost_map.yaml", Grid("map", 0.05, (1.0, -2.0), cells))
    content = yaml.safe_load((tmp_path / "cost_map.yaml").read_text())
    assert content["image"] == "cost_map.pgm"
    assert content["mode"] == "raw"
    assert content["negate"] == 0
    assert content["origin"] == [1.0, -2.0, 0.0]
    data = (tmp_path / "cost_map.pgm").read_bytes()
    assert data == b"P5\n3 2\n255\n" + bytes([7, 50, 99, 0, 100, 255])


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("m.yaml", b"mode: raw", b"mode: trinary", "expected mode raw"),
        ("m.yaml", b"resolution: 0.1", b"resolution: -1", "resolution"),
        ("m.yaml", b"frame", b"frames", "frame"),
        ("m.yaml", b"image", b"- image", "not YAML text: line 2"),
        ("m.pgm", b"P5", b"P2", "no binary PGM"),
        ("m.pgm", b"255\n", b"255\n\x00", "has 5 pixels, expected 2 . 2"),
    ],
)
def test_what_cannot_be_used_is_said(
    tmp_path: Path, name: str, old: bytes, new: bytes, words: str
) -> None:
    path = tmp_path / "m.yaml"
    write_map(path, Grid("map", 0.1, (0.0, 0.0), np.zeros((2, 2), np.int8)))
    file = tmp_path / name
    file.write_bytes(file.read_bytes().replace(old, new, 1))
    with pytest.raises(CostMapError, match=words):
        read_map(path)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(CostMapError, match="No such file"):
        read_map(tmp_path / "none.yaml")
