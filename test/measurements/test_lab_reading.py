# SPDX-License-Identifier: Apache-2.0
"""The tables that a lab types: pressure, rectangles, compliance, curves, shear; and what is wrong there.

Tests `lab.py`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from lab_truth import plate_rows, shear, write

from smallwheel_ros import cli
from smallwheel_ros.api.fit import fit
from smallwheel_ros.api.read import read_test
from smallwheel_ros.measurements.cells import MeasurementsError
from smallwheel_ros.measurements.from_file import read_measurements, read_tests
from smallwheel_ros.measurements.measurements import (
    Measurements,
    ShearTests,
    joined,
    joined_shear,
)
from smallwheel_ros.model.model_file import read_model


def table(tmp_path: Path, text: str, name: str = "t.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def curve(loads: list[float], depths: list[float], run: str = "a") -> str:
    """Rows of run, contact, diameter, load, sinkage."""
    return "".join(f"{run},plate,0.1,{w},{z}\n" for w, z in zip(loads, depths, strict=True))


HEADER = "run,contact,diameter,load,sinkage\n"


def test_pressure_times_area_is_the_load(tmp_path: Path) -> None:
    data = read_measurements(
        table(
            tmp_path,
            "diameter [mm];Pressung;pressure [kPa];sinkage [mm]\n100;x;20;5\n100;y;40;11\n",
        ),
    )
    assert data.conditions.plate.all()  # a pressure, and no width
    assert data.conditions.load == pytest.approx(np.array([20e3, 40e3]) * np.pi / 4 * 0.01)
    assert any("area of the plate" in said for said in data.understood)


def test_a_rectangular_plate_has_the_area_of_its_sides(tmp_path: Path) -> None:
    text = "contact,width [mm],length [mm],pressure [kPa],sinkage [mm]\nplate,200,50,30,8\n"
    data = read_measurements(table(tmp_path, text))
    assert data.conditions.load == pytest.approx(30e3 * 0.2 * 0.05)
    assert data.conditions.width == pytest.approx(0.05)  # b, the smaller side
    assert np.pi / 4 * data.conditions.diameter**2 == pytest.approx(0.01)


def test_the_width_of_a_round_plate_is_no_side(tmp_path: Path) -> None:
    text = "contact,diameter,width,load,sinkage\nplate,0.1,0.05,30,0.01\nplate,0.1,,30,0.01\n"
    assert np.isnan(read_measurements(table(tmp_path, text)).conditions.width).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("contact,diameter,width,pressure,sinkage\nrolling,0.2,0.1,2e4,0.01\n", "that of a wheel changes"),
        ("diameter,width,pressure,sinkage\n0.2,0.1,2e4,0.01\n", "that of a wheel changes"),
        ("contact,diameter,width,length,load,sinkage\nplate,0.1,0.1,0.2,9,0.01\n", "round or rectangular"),
        ("contact,diameter,length,load,sinkage\nplate,,0.2,9,0.01\n", "length without its width"),
        ("load,diameter,sinkage\n9,0.1,0.01\n", "say contact = plate"),
        ("pressure [kPa],sinkage [mm]\n20,5\n", "no column 'diameter'"),
        (HEADER + curve([-1, -2], [0.0, -1e-3]), "no row of load and sinkage over 0"),
        ("diameter,width,load,sinkage\n0.2,0.1,30,-0.01\n", "sinkage is -0.01, expected 0 to"),
        ("shear_stress [kPa],normal_stress [kPa]\n3,10\n", "no column 'shear_displacement'"),
        ("shear_stress,normal_stress,shear_displacement\n3e3,-1e4,0.001\n", "expected over 0"),
        ("shear_stress [mm],normal_stress,shear_displacement\n3,1e4,0.001\n", "a length"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(MeasurementsError, match=said):
        read_tests(table(tmp_path, text))


def test_compliance_is_taken_off_the_sinkage(tmp_path: Path) -> None:
    path = table(tmp_path, HEADER + curve([100, 200, 400], [0.002, 0.004, 0.007]))
    data = read_measurements(path, compliance=2e-6)
    assert data.channels["sinkage"] == pytest.approx([0.0018, 0.0036, 0.0062])
    assert any("up to 0.8 mm" in said for said in data.understood)
    with pytest.raises(MeasurementsError, match="1 mm under 1 kN is 1e-6 m/N"):
        read_measurements(path, compliance=2.0)
    rolling = table(tmp_path, "diameter,width,load,sinkage\n0.2,0.1,30,0.01\n", "r.csv")
    with pytest.raises(MeasurementsError, match="is the compliance right"):
        read_measurements(rolling, compliance=1e-3)


def test_rows_before_the_soil_and_after_the_load_are_left_out(tmp_path: Path) -> None:
    up = [1.0, 20, 40, 60, 80, 100]
    loads = [-0.5, 0.0, *up, 50, 10, 60, 95, 110]
    depths = [-0.1, 0.0, 0.1, 2.0, 4.0, 6.0, 8.0, 10.0, 9.8, 9.5, 9.7, 9.9, 11.0]
    depths = [1e-3 * z for z in depths]
    data = read_measurements(table(tmp_path, HEADER + curve(loads, depths)))
    assert data.conditions.load.tolist() == [*up, 95, 110]
    said = " ".join(data.understood)
    assert "2 rows of plates or pressed wheels are left out" in said
    assert "3 rows of curves are left out: the load was taken off" in said


def test_rows_in_no_order_are_no_unloading(tmp_path: Path) -> None:
    z = np.linspace(0.001, 0.02, 30)
    order = np.random.default_rng(1).permutation(30)
    text = HEADER + curve((1e4 * z[order]).tolist(), z[order].tolist())
    assert len(read_measurements(table(tmp_path, text))) == 30


def test_a_load_that_falls_with_depth_is_said(tmp_path: Path) -> None:
    z = np.linspace(0.001, 0.02, 12)
    data = read_measurements(table(tmp_path, HEADER + curve((50 - 1e3 * z).tolist(), z.tolist())))
    assert any("the load falls while the body goes deeper" in said for said in data.warnings)


@pytest.mark.parametrize(("deep", "odd"), [(0.02, True), (0.0015, False)])
def test_one_load_at_all_depths_is_said(tmp_path: Path, deep: float, odd: bool) -> None:
    z = np.linspace(0.001, deep, 12)
    data = read_measurements(table(tmp_path, HEADER + curve([50.0] * 12, z.tolist())))
    assert any("50 N at all depths from 1 to 20 mm" in said for said in data.warnings) == odd


def test_curves_without_names_are_found(tmp_path: Path) -> None:
    z = np.linspace(0.001, 0.02, 20).tolist()
    loads = [1e4 * x for x in z]
    text = (HEADER + 2 * curve(loads, z) + curve(loads, z).replace("0.1,", "0.2,", 20)).replace(
        "run,", ""
    )
    data = read_measurements(table(tmp_path, text.replace("a,plate", "plate")))
    assert data.runs.size == 3
    assert any("3 curves" in said for said in data.understood)


def test_the_pressure_of_a_tyre_stays_a_column_of_its_own(tmp_path: Path) -> None:
    text = "load,diameter,width,sinkage,tyre_pressure [bar],pressure [kPa]\n30,0.2,0.1,0.01,2,5\n"
    data = read_measurements(table(tmp_path, text))
    assert set(data.conditions.covariates) == {"tyre_pressure", "pressure"}
    assert data.responses == ("pressure",)


def test_a_shear_table_in_german(tmp_path: Path) -> None:
    lines = ["Normalspannung [kPa];Scherweg [mm];Scherspannung [kPa]"]
    tests = shear(np.random.default_rng(1), runs=1, rows=20)
    for s, j, t in zip(tests.normal_stress, tests.displacement, tests.shear_stress, strict=True):
        lines.append(f"{1e-3 * s};{1e3 * j};{1e-3 * t}".replace(".", ","))
    found = read_tests(table(tmp_path, "\n".join(lines)))
    assert isinstance(found, ShearTests)
    assert found.shear_stress == pytest.approx(tests.shear_stress)
    assert len(set(found.run.tolist())) == 3  # each begins where the normal stress changes
    assert any("no column 'run': 3 tests" in said for said in found.understood)


def lab_files(tmp_path: Path) -> tuple[Path, Path]:
    rng = np.random.default_rng(8)
    plates = write(tmp_path / "plates.csv", plate_rows(rng, runs=2, rows=25))
    tests = shear(rng, rows=30)
    columns = (tests.run, tests.normal_stress, tests.displacement, tests.shear_stress)
    header = ["run", "normal_stress", "shear_displacement", "shear_stress"]
    rows = [list(row) for row in zip(*columns, strict=True)]
    return plates, write(tmp_path / "shear.csv", rows, header)


def test_a_labs_files_become_a_model_in_one_command(tmp_path: Path) -> None:
    plates, sheared = lab_files(tmp_path)
    model, document = tmp_path / "soil.yaml", tmp_path / "fit.json"
    arguments = ["fit", str(plates), str(sheared), "-o", str(model), "--json", str(document)]
    done = CliRunner().invoke(cli.main, arguments)
    assert done.exit_code == 0, done.output
    for said in ("kphi", "Reece", "phi =", "size left out"):
        assert said in done.output
    shown = CliRunner().invoke(cli.main, ["fit", str(plates), str(sheared)])
    assert shown.output == done.output.replace(f"written: {model}\n", "")
    fitted = fit([plates, sheared])
    for name in ("k", "kc", "kphi", "soil.n", "cohesion", "shear_displacement"):
        assert fitted[name].std > 0.0  # type: ignore[operator]
    assert fitted.k.value == fitted.model.soils[0].k
    assert fitted.shear_displacement.value == fitted.model.soils[0].shear_displacement
    known = read_model(model)
    for name in ("n", "m", "cohesion", "friction_angle", "log_shear_displacement"):
        assert known.standard_deviation(f"soil.{name}") > 0.0
    found = json.loads(document.read_text())
    assert found["plate_laws"][0]["laws"]["bekker"]["constants"]["kc"]["unit"] == "Pa/m^(n-1)"
    assert found["shear"][0]["model"]["cohesion"] == pytest.approx(1500.0, abs=1500.0)
    # Later tests go into the model that is there.
    again = CliRunner().invoke(
        cli.main, ["fit", str(sheared), "--model", str(model), "-o", str(tmp_path / "b.yaml")]
    )
    assert again.exit_code == 0, again.output
    assert read_model(tmp_path / "b.yaml").model.soils[0].n == known.model.soils[0].n


def test_shear_alone_is_shown_and_a_file_needs_a_model(tmp_path: Path) -> None:
    _, sheared = lab_files(tmp_path)
    shown = CliRunner().invoke(cli.main, ["fit", str(sheared)])
    assert shown.exit_code == 0
    assert "phi = " in shown.output
    assert "No model was made: shear tests give" in shown.output
    done = CliRunner().invoke(cli.main, ["fit", str(sheared), "--json", "-"])
    document = json.loads(done.stdout)
    assert document["schema"] == 1
    for name in ("cohesion", "friction_angle", "shear_displacement"):
        assert document["shear"][0]["parameters"][name]["std"] > 0.0
    named = ["fit", str(sheared), "--model", "dry_sand", "-o", str(tmp_path / "d.yaml")]
    assert CliRunner().invoke(cli.main, named).exit_code == 0
    assert read_model(tmp_path / "d.yaml").standard_deviation("dry_sand.cohesion") is not None
    done = CliRunner().invoke(cli.main, ["fit", str(sheared), "-o", str(tmp_path / "m.yaml")])
    assert done.exit_code == 2
    assert "needs k and n too" in done.output
    assert not (tmp_path / "m.yaml").exists()
    done = CliRunner().invoke(cli.main, ["compare", str(sheared)])
    assert done.exit_code == 2
    assert "shear tests" in done.output


def test_files_of_one_plate_each(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    paths = []
    for size in (0.05, 0.1):
        rows = [["1", *row[1:]] for row in plate_rows(rng, sizes=(size,), runs=1, rows=20)]
        paths.append(write(tmp_path / f"{1e3 * size:.0f}.csv", rows))
    tables = [read_test(path) for path in paths]
    assert all(isinstance(t, Measurements) for t in tables)
    found = fit(paths)
    assert found.held_out["sinkage"] > 0.0  # run 1 of one file is not run 1 of the other
    assert {p.status for p in found.parameters if p.name == "m"} != {"held"}
    assert "Bekker" in str(found)
    assert len(found.rows()) > len(found.parameters)
    assert found.to_dict()["plate_laws"][0]["runs"] == 2


@pytest.mark.parametrize("name", ["load", "sinkage"])
def test_a_sign_that_is_the_other_one_is_said(tmp_path: Path, name: str) -> None:
    rows = [{"load": 30.0 * i, "sinkage": 0.001 * i} for i in range(1, 7)]
    lines = [f"plate,0.1,{r['load']},{r['sinkage']}" for r in (r | {name: -r[name]} for r in rows)]
    text = "\n".join(["contact,diameter,load,sinkage", *lines, ""])
    with pytest.raises(MeasurementsError, match=f"{name} is under 0 throughout, is its sign"):
        read_measurements(table(tmp_path, text))


def test_what_was_understood_in_each_file_stays_when_they_are_joined(tmp_path: Path) -> None:
    head = "run,{load},diameter [m],width [m],contact,{sinkage}\n"
    first = head.format(load="load [N]", sinkage="sinkage [m]") + "a,20,0.1,0.1,plate,0.01\n"
    second = head.format(load="load [kN]", sinkage="Einsinkung [mm]").replace(",", ";")
    second += "a;0,02;0,1;0,1;plate;10,5\na;0,04;0,1;0,1;plate;14,5\n"
    files = [table(tmp_path, first, "one.csv"), table(tmp_path, second, "two.csv")]
    parts = [read_measurements(file) for file in files]
    assert any("decimal commas" in line for line in parts[1].understood)
    whole = joined(parts)
    assert [line for line in whole.understood if line.startswith("two.csv: ")] == [
        f"two.csv: {line}" for line in parts[1].understood
    ]
    assert whole.written_units == {
        "load": "N", "diameter": "m", "width": "m", "sinkage": "m"}  # fmt: skip
    assert joined(parts[::-1]).written_units["sinkage"] == "mm"


def test_what_was_understood_in_each_table_of_shear_tests_stays(tmp_path: Path) -> None:
    def one(name: str, columns: str) -> ShearTests:
        rows = "a;5,0;2,0;1,2\na;5,0;9,0;2,8\na;5,0;30,0;3,4\n"
        found = read_tests(table(tmp_path, f"{columns}\n{rows}", name))
        assert isinstance(found, ShearTests)
        return found

    header = "run;normal stress [kPa];shear displacement [mm];shear stress [kPa]"
    parts = [one("one.csv", header), one("two.csv", header.replace("run", "Versuch"))]
    said = joined_shear(parts).understood
    assert said == tuple(
        f"{name}: {line}"
        for name, part in zip(("one.csv", "two.csv"), parts, strict=True)
        for line in part.understood
    )
    assert any("Versuch" in line for line in said)
