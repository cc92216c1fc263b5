# SPDX-License-Identifier: Apache-2.0
"""What holds for any table and any bytes."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import MeasurementsError

LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254, "µm": 1e-6, "km": 1e3}
FORCES = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": 4.4482216152605, "kgf": 9.80665}
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3}

ROWS = st.lists(
    st.tuples(
        st.floats(0.1, 1e4),  # load
        st.floats(0.02, 2.0),  # diameter
        st.floats(0.01, 1.0),  # width
        st.floats(0.0, 0.5),  # sinkage over diameter
        st.floats(-1.0, 1.0),  # slip
        st.floats(-1.5, 1.5),  # slope
    ),
    min_size=1,
    max_size=20,
    unique=True,  # copies count once
)


def read(content: bytes) -> object:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        path.write_bytes(content)
        return read_measurements(path)


@settings(max_examples=examples(60))
@given(
    ROWS,
    st.tuples(*(st.sampled_from(list(LENGTHS)) for _ in range(3))),
    st.sampled_from(list(FORCES)),
    st.sampled_from(list(ANGLES)),
)
def test_a_table_in_any_units_reads_as_written_in_si(
    rows: list[tuple[float, ...]], lengths: tuple[str, str, str], force: str, angle: str
) -> None:
    table = np.array(rows)
    table[:, 3] *= table[:, 1]
    units = [force, *lengths, "1", angle]
    names = ["load", "diameter", "width", "sinkage", "slip", "slope"]
    factors = [FORCES[force], *(LENGTHS[u] for u in lengths), 1.0, ANGLES[angle]]
    lines = [",".join(f"{name} [{unit}]" for name, unit in zip(names, units, strict=True))]
    lines += [",".join(repr(float(v)) for v in row) for row in table / factors]
    data = read(("\n".join(lines)).encode())
    got = [data.conditions.load, data.conditions.diameter, data.conditions.width]  # type: ignore[attr-defined]
    got += [data.channels["sinkage"], data.conditions["slip"], data.conditions["slope"]]  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.stack(got, axis=1), table, rtol=1e-9, atol=1e-30)


@settings(max_examples=examples(300))
@given(st.binary(max_size=300))
def test_any_bytes_are_a_table_or_a_measurements_error(content: bytes) -> None:
    try:
        read(content)
    except MeasurementsError as error:
        assert str(error)  # noqa: PT017


CELLS = st.one_of(
    st.sampled_from(
        [
            "",
            "1",
            "0.1",
            "-1",
            "nan",
            "inf",
            "1e999",
            "a",
            "1,5",
            '"',
            "plate",
            "rolling",
            "%",
            "[",
            "8",
        ]
    ),
    st.text(max_size=6),
    st.floats(allow_nan=False).map(repr),
)
HEADERS = st.one_of(
    st.sampled_from(
        ["load", "load [N]", "diameter", "width [mm]", "sinkage [mm]", "slip", "contact", "run"]
    ),
    st.sampled_from(["speed [mm/s]", "pass_number", "moisture", "sinkage_std", "soil"]),
    st.text(max_size=8),
)  # fmt: skip


@settings(max_examples=examples(150))
@given(st.lists(HEADERS, max_size=7), st.lists(st.lists(CELLS, max_size=7), max_size=5))
def test_any_table_is_read_or_refused_and_never_holds_an_infinity(
    header: list[str], rows: list[list[str]]
) -> None:
    text = "\n".join(",".join(cells) for cells in [header, *rows])
    check(text)


@settings(max_examples=examples(150))
@given(
    st.lists(HEADERS, max_size=4, unique=True),
    st.lists(st.lists(CELLS, min_size=8, max_size=8), min_size=1, max_size=4),
)
def test_a_table_that_is_nearly_right_is_read_or_refused(
    extra: list[str], rows: list[list[str]]
) -> None:
    names = ["load", "diameter", "width", "sinkage", *extra]
    good = ["60", "0.2", "0.1", "0.01"]
    lines = [good[:k] + row[k : len(names)] for k, row in zip((4, 3, 2, 4), rows, strict=False)]
    check("\n".join(",".join(cells) for cells in [names, *lines]))


def check(text: str) -> None:
    try:
        data = read(text.encode("utf-8", "surrogatepass"))
    except MeasurementsError:
        return
    conditions = data.conditions  # type: ignore[attr-defined]
    assert np.all(conditions.load > 0)
    assert np.isfinite(conditions.load).all()
    assert np.isfinite(conditions.diameter).all()
    rolling = conditions.contact == "rolling"
    for values in conditions.covariates.values():
        assert np.isfinite(values[rolling]).all()
    for values in data.channels.values():  # type: ignore[attr-defined]
        assert not np.isinf(values).any()
