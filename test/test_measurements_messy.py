"""Tables as outsiders have them: they read as what was measured, or say everything that is wrong."""

from __future__ import annotations

from pathlib import Path

import messy_tables as messy
import numpy as np
import pytest

from smallwheel_ros.measurements.table import Measurements, MeasurementsError, read_measurements


def read(folder: Path, content: bytes) -> Measurements:
    path = folder / "table"
    path.write_bytes(content)
    return read_measurements(path)


@pytest.mark.parametrize("name", messy.GOOD)
def test_a_table_reads_as_what_was_measured(tmp_path: Path, name: str) -> None:
    data = read(tmp_path, messy.GOOD[name])
    run, load, diameter, width, slip, sinkage = (list(c) for c in zip(*messy.TRUTH, strict=True))
    assert data.run.tolist() == run
    np.testing.assert_allclose(data.conditions.load, load, rtol=1e-5)
    np.testing.assert_allclose(data.conditions.diameter, np.array(diameter) / 1000.0)
    np.testing.assert_allclose(data.conditions.width, np.array(width) / 1000.0)
    np.testing.assert_allclose(data.conditions["slip"], np.array(slip) / 100.0)
    np.testing.assert_allclose(data.channels["sinkage"], np.array(sinkage) / 1000.0)


@pytest.mark.parametrize("name", messy.BAD)
def test_everything_that_is_wrong_is_said_at_once(tmp_path: Path, name: str) -> None:
    content, words = messy.BAD[name]
    with pytest.raises(MeasurementsError) as caught:
        read(tmp_path, content)
    for word in words:
        assert word in str(caught.value)
