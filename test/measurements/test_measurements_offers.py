# SPDX-License-Identifier: Apache-2.0
"""Where headers are not understood, a line is offered: pasted, the table is read, and as it is meant."""

from __future__ import annotations

import shlex
from pathlib import Path

import messy_tables as messy
import numpy as np
import pytest
import unknown_tables as unknown
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.measurements.shear import ShearTests
from smallwheel_ros.measurements.table import Measurements, MeasurementsError
from smallwheel_ros.measurements.wheels import read_tests

FEWEST_RIGHT = 0.85  # of tables; in the mean of five sets of rigs it is 0.90


def offered(path: Path, **how: object) -> tuple[dict[str, str], str]:
    """The header of each of our names on the offered line, and all that is said."""
    with pytest.raises(MeasurementsError) as caught:
        read_tests(path, **how)  # type: ignore[arg-type]
    said = str(caught.value)
    line = next(line for line in said.splitlines() if line.strip().startswith("--map"))
    words = shlex.split(line)
    assert set(words[::2]) == {"--map"}
    return dict(word.split("=", 1) for word in words[1::2]), said


def written(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_line_reads_every_made_table_and_is_right_in_most(tmp_path: Path) -> None:
    """44 tables in twelve languages; with units in the headers each column on the line is right."""
    wrong, surely_wrong = [], []
    tables = unknown.tables()
    for table in tables:
        path = written(tmp_path, table.text)
        mapping, said = offered(path)
        assert isinstance(read_tests(path, map=mapping), Measurements)
        ours = {
            name.partition(" [")[0].replace("radius", "diameter"): n for name, n in mapping.items()
        }
        bad = {n: h for n, h in ours.items() if table.truth.get(n) != h and n != h}
        wrong += [table.name] if bad else []
        assert not bad or "none" in table.name, (table.name, bad)
        surely_wrong += [n for n, h in bad.items() if f"'{h}', NOT DECIDED" not in said]
    assert len(tables) == 44
    assert len(wrong) <= (1.0 - FEWEST_RIGHT) * len(tables), wrong
    assert not surely_wrong


DUTCH = """proef;belasting [N];wieldiameter [mm];wielbreedte [mm];insporing [mm];slip [%];trekkracht [N]
p1;20;200;100;4,1;10;3,4
p1;20;200;100;4,3;10;3,2
p2;40;200;100;7,1;20;8,1
p3;60;200;100;10,5;30;12,4
"""


def test_the_line_is_pasted_behind_the_command(tmp_path: Path) -> None:
    path = written(tmp_path, DUTCH.replace("belasting [N]", "Kraft' [N]"))
    run = CliRunner().invoke
    refused = run(main, ["fit", str(path)])
    assert refused.exit_code == 2
    line = next(x for x in refused.stderr.splitlines() if x.strip().startswith("--map"))
    read = run(main, ["fit", str(path), *shlex.split(line)])
    assert read.exit_code == 0, read.output
    assert "'Kraft' [N]' -> load [N]" in read.stderr


def test_each_guess_has_its_reason(tmp_path: Path) -> None:
    mapping, said = offered(written(tmp_path, DUTCH))
    assert mapping["width"] == "wielbreedte [mm]"
    for words in (
        "load: 'belasting [N]', 20 to 60 N; [N]; near to 'belastung'; the largest force",
        "diameter: 'wieldiameter [mm]', 0.2 m; [mm]; near to 'diameter'; larger than the width",
        "left out, as nothing decides it: 'trekkracht [N]': ",
        "run: 'proef', 3 names, each of one setting",
    ):
        assert words in said


def test_what_the_user_said_stays_on_the_line(tmp_path: Path) -> None:
    mapping, _ = offered(written(tmp_path, DUTCH), map={"drawbar_pull": "trekkracht [N]"})
    assert mapping["drawbar_pull"] == "trekkracht [N]"
    assert mapping["load"] == "belasting [N]"


def test_a_size_that_no_column_has_is_asked_for(tmp_path: Path) -> None:
    rows = [line.split(";") for line in DUTCH.splitlines()]
    text = "\n".join(";".join(row[:2] + row[4:]) for row in rows)
    path = written(tmp_path, text)
    mapping, said = offered(path)
    assert "diameter: no column can be it, give --diameter" in said
    assert "with it there is left" in said
    sizes = {"diameter": 0.2, "width": 0.1}
    mapping, said = offered(path, **sizes)
    assert "with it there is left" not in said
    assert len(read_tests(path, map=mapping, **sizes)) == 4  # type: ignore[arg-type]


def test_known_headers_without_their_unit_are_on_the_line(tmp_path: Path) -> None:
    path = written(tmp_path, messy.text(messy.BARE))
    mapping, _ = offered(path)
    assert mapping == {
        "diameter [mm]": "diameter", "width [mm]": "width", "sinkage [mm]": "sinkage", "slip [%]": "slip",
    }  # fmt: skip
    data = read_tests(path, map=mapping)
    assert isinstance(data, Measurements)
    assert data.conditions["slip"].tolist() == pytest.approx([0.1, 0.1, 0.2, 0.2])


def test_plates_and_shear_tests_are_offered_too(tmp_path: Path) -> None:
    plate = [
        "proef,druk [kPa],ingang [mm]",
        *(f"p{i // 9},{i % 9 - 0.5},{i % 9}" for i in range(18)),
    ]
    path = written(tmp_path, "\n".join(plate))
    mapping, _ = offered(path, diameter=0.1)
    assert mapping == {"pressure": "druk [kPa]", "sinkage": "ingang [mm]", "run": "proef"}
    shear = ["druk [kPa],afschuif [kPa],weg [mm]"]
    shear += [f"{10 * (1 + i // 9)},{i % 9 + 0.25},{i % 9}" for i in range(18)]
    path = written(tmp_path, "\n".join(shear))
    mapping, _ = offered(path)
    assert mapping["normal_stress"] == "druk [kPa]"
    assert isinstance(read_tests(path, map=mapping), ShearTests)


@pytest.mark.parametrize(
    "text",
    [
        "a,b\nx,y\n",
        "a,b,c\n1,2,inf\n",
        "a,a,a,a\n1,2,3,4\n",
        "a [N],b [foo],c\n1e308,-1e308,0\n",
        "a [N],b [mm],c [mm]\n1,2,\n,,\n",
    ],
)
def test_a_table_of_which_nothing_is_known_is_refused_as_it_was(tmp_path: Path, text: str) -> None:
    with pytest.raises(MeasurementsError) as caught:
        read_tests(written(tmp_path, text))
    assert "--map '" not in str(caught.value).partition("By units")[2]


def test_what_is_wrong_with_the_values_is_said_beside_the_line(tmp_path: Path) -> None:
    _, said = offered(written(tmp_path, DUTCH.replace("10,5", "-10,5")))
    assert "sinkage" not in said.partition("By units")[2].partition("\n    load")[0]


def test_a_long_table_is_judged_by_some_of_its_rows(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [
        f"{w},200,100,{z:.6f}" for w, z in zip(*rng.uniform(1.0, 9.0, (2, 30_000)), strict=True)
    ]
    path = written(tmp_path, "last_N,rond_mm,breed_mm,diep_mm\n" + "\n".join(rows))
    mapping, _ = offered(path)
    assert mapping["sinkage"] == "diep_mm"
