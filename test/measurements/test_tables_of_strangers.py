# SPDX-License-Identifier: Apache-2.0
"""Tables as loggers and labs write them: each is read, or refused with a reason that holds."""

from __future__ import annotations

import shlex

import numpy as np
import pytest

from smallwheel_ros.measurements.cells import MeasurementsError
from smallwheel_ros.measurements.from_file import read_measurements

ROWS = [(20, 150, 75, 0.1, 5.62), (40, 200, 100, 0.1, 6.25), (80, 300, 150, 0.3, 8.5)]
DEPTHS = [0.00562, 0.00625, 0.0085]


def read(tmp_path, text: str, code: str = "utf-8"):
    path = tmp_path / "table.txt"
    path.write_bytes(text.encode(code))
    return read_measurements(path)


def body(by: str) -> str:
    return "".join(by.join(map(str, row)) + "\n" for row in ROWS)


@pytest.mark.parametrize("mark", ["# ", "#", "% ", ""])
@pytest.mark.parametrize("blank", [" ", "   ", "\t "])
def test_columns_between_blanks_with_a_header_in_a_comment(tmp_path, mark: str, blank: str) -> None:
    """As numpy.savetxt and gnuplot have them."""
    head = blank.join(["load [N]", "diameter[mm]", "width[mm]", "slip", "sinkage[mm]"])
    text = f"# sand box, raked\n{mark}{head}\n{body(blank)}# the end\n"
    data = read(tmp_path, text)
    np.testing.assert_allclose(data.channels["sinkage"], DEPTHS)
    np.testing.assert_allclose(data.conditions.load, [20, 40, 80])
    assert "1 lines of comments are left out" in data.understood


def test_decimal_commas_between_blanks(tmp_path) -> None:
    text = (
        "load[N]  diameter[mm] width[mm] sinkage[mm]\n20,5 150,0 75,0 5,62\n40,5 150,0 75,0 6,25\n"
    )
    np.testing.assert_allclose(read(tmp_path, text).conditions.load, [20.5, 40.5])


@pytest.mark.parametrize("by", ["\t", ",", ";", "|"])
def test_names_of_several_words_keep_their_separator(tmp_path, by: str) -> None:
    head = by.join(
        ["Normal load [N]", "Wheel diameter [mm]", "Wheel width [mm]", "Slip", "Sinkage [mm]"]
    )
    data = read(tmp_path, f"{head}\n{body(by)}")
    np.testing.assert_allclose(data.channels["sinkage"], DEPTHS)
    np.testing.assert_allclose(data.conditions["slip"], [0.1, 0.1, 0.3])


def test_who_checked_it_is_a_remark_and_a_cell_with_a_digit_is_not(tmp_path) -> None:
    head = "run;load [N];diameter [mm];width [mm];sinkage [mm]\n"
    rows = "1;20;150;75;5.62\n2;40;150;75;6.25\n"
    data = read(tmp_path, f"{head}{rows}end of data;;;;\nchecked by;B. Meier;;;\n")
    assert len(data) == 2
    assert data.understood[0] == "2 of 4 rows kept"
    assert any("'checked by, B. Meier' is a remark" in said for said in data.understood)
    with pytest.raises(MeasurementsError, match="'2O' found, expected a number"):
        read(tmp_path, f"{head}{rows}3;2O;x;;\n")


def test_a_wheels_speed_in_rpm_is_not_the_speed_over_ground(tmp_path) -> None:
    head = "load [N],diameter [mm],width [mm],wheel speed [rpm],speed [mm/s],sinkage [mm]\n"
    data = read(tmp_path, head + "20,150,75,6.4,45,5.62\n40,150,75,6.5,50,6.25\n")
    np.testing.assert_allclose(data.conditions["speed"], [0.045, 0.05])
    assert any("'wheel speed [rpm]' is not speed" in said for said in data.notes)
    # What is asked for is not explained away.
    with pytest.raises(MeasurementsError, match="unit 's' is a time, expected a force"):
        read(tmp_path, "load [s],diameter [mm],width [mm],sinkage [mm]\n20,150,75,5\n40,150,75,6\n")


def test_a_torques_symbol_needs_its_unit(tmp_path) -> None:
    head = "load_N,D_mm,b_mm,z_mm,{}\n"
    rows = "20,150,75,5.62,1.5\n40,150,75,6.25,2.5\n"
    np.testing.assert_allclose(
        read(tmp_path, head.format("T_Nm") + rows).channels["torque"], [1.5, 2.5]
    )
    assert "torque" not in read(tmp_path, head.format("T") + rows).channels
    assert "torque" not in read(tmp_path, head.format("T [degC]") + rows).channels


@pytest.mark.parametrize(
    ("head", "code"),
    [
        ("载荷(N),轮径(mm),轮宽(mm),滑转率,沉陷量(mm)\n", "gb18030"),
        ("荷重[N],直径[mm],幅[mm],スリップ率,沈下量[mm]\n", "shift_jis"),
    ],
)
def test_files_of_the_far_east(tmp_path, head: str, code: str) -> None:
    data = read(tmp_path, head + body(","), code)
    np.testing.assert_allclose(data.channels["sinkage"], DEPTHS)
    assert f"text in {code.upper()}, as it is not UTF-8" in data.understood


def test_two_columns_of_one_name_are_not_told_apart_by_an_option(tmp_path) -> None:
    head = "load [N],diameter [mm],width [mm],sinkage [mm],{}\n"
    rows = "20,150,75,5.62,5.7\n40,150,75,6.25,6.3\n"
    with pytest.raises(MeasurementsError) as refused:
        read(tmp_path, head.format("sinkage [mm]") + rows)
    assert str(refused.value).endswith("remove or rename the other")
    with pytest.raises(MeasurementsError, match="or say which with --map 'sinkage=sinkage"):
        read(tmp_path, head.format("Sinkage [cm]") + rows)


def test_a_long_header_has_its_unit_and_differs_from_another(tmp_path) -> None:
    """Of 60 characters that a message shows, two headers of a logger were one, and the unit was lost."""
    long = "force of the pulling load cell behind the carriage, after taring, mean {} (kN)"
    first, other = long.format("of 2 s"), long.format("of 20 s")
    head = f'load [N],diameter [mm],width [mm],slip,"{first}","{other}"\n'
    (tmp_path / "table.txt").write_text(head + "20,150,75,0.2,0.0056,1\n40,150,75,0.2,0.012,1\n")
    data = read_measurements(tmp_path / "table.txt", map={"drawbar_pull": first})
    np.testing.assert_allclose(data.channels["drawbar_pull"], [5.6, 12.0])
    (own,) = (name for name in data.conditions.covariates if "20 s" in name)
    np.testing.assert_allclose(data.conditions.covariates[own], [1000.0, 1000.0])


@pytest.mark.parametrize(
    ("head", "row", "said"),
    [
        ("load,sinkage", "20,-0.0001", "sinkage is positive downwards"),
        ("load [N],sinkage [mm]", "-20,5", "a load is positive where"),
        ("load,sinkage,sinkage_std", "20,0.005,0", "leave the cell blank if unknown"),
        ("load,sinkage", "20,5.6", "metres: for mm"),
        ("load [N],sinkage [mm]", "20,56000", ""),
    ],
)
def test_the_advice_on_a_number_out_of_range_fits_it(
    tmp_path, head: str, row: str, said: str
) -> None:
    """A sign is no unit: -0.1 mm was answered by how to write millimetres, 56 m by how to turn a sign."""
    advice = ["positive downwards", "positive where", "leave the cell blank", "metres: for mm"]
    with pytest.raises(MeasurementsError) as refused:
        read(tmp_path, f"{head},diameter [mm],width [mm]\n{row},150,75\n")
    given = [one for one in advice if one in str(refused.value)]
    assert [one for one in advice if one in said] == given
    assert said in str(refused.value)


@pytest.mark.parametrize(
    "header",
    ["sinkage, driver's left", "sinkage\nleft", "sinkage " + 5 * "of a very " + "long name"],
)
def test_the_option_that_a_refusal_names_is_typed_as_it_stands(tmp_path, header: str) -> None:
    """Apostrophes, line breaks of a spreadsheet, and headers longer than a message quotes."""
    names = f'"{header} [mm]",sinkage right [mm]'
    text = f"load [N],diameter [mm],width [mm],{names}\n20,150,75,5.62,6\n40,150,75,6.25,7\n"
    with pytest.raises(MeasurementsError, match="--map") as refused:
        read(tmp_path, text)
    option = (
        str(refused.value).partition("which is it with --map ")[2].partition(". The columns")[0]
    )
    (typed,) = shlex.split(option)
    name, _, column = typed.partition("=")
    data = read_measurements(tmp_path / "table.txt", map={name: column})
    np.testing.assert_allclose(data.channels["sinkage"], [0.00562, 0.00625])


@pytest.mark.parametrize("index", ["0\n", "7\n", "BDG_1\n"])
def test_an_index_without_a_name_is_left_out_and_reported(tmp_path, index: str) -> None:
    """As pandas and R write them, when nobody asks them not to."""
    names = [index.strip(), "12", "x"]
    rows = "".join(f"{n},{','.join(map(str, row))}\n" for n, row in zip(names, ROWS, strict=True))
    data = read(tmp_path, f",load [N],diameter [mm],width [mm],slip,sinkage [mm]\n{rows}")
    np.testing.assert_allclose(data.channels["sinkage"], DEPTHS)
    assert "column 1 has no name, an index? It is left out" in "; ".join(data.understood)


def test_a_cell_too_many_in_each_row_is_refused_the_columns_may_have_shifted(tmp_path) -> None:
    rows = "20,5,150,75,5.62\n40,5,200,100,6.25\n"  # 20,5 N with a decimal comma between commas
    with pytest.raises(MeasurementsError, match="column 5 has no name"):
        read(tmp_path, f"load [N],diameter [mm],width [mm],sinkage [mm],\n{rows}")


@pytest.mark.parametrize("by", [",", ";", "\t", " "])
@pytest.mark.parametrize("first", ["774.35", "0", "-1.5e-3", "1e-05"])
def test_a_log_without_a_header_is_called_so(tmp_path, by: str, first: str) -> None:
    """As single-wheel rigs log them; two zeros in the first row are no two columns of one name."""
    rows = "".join(by.join([first, "0", "0", "41.38", str(70507 + i)]) + "\n" for i in range(9))
    with pytest.raises(MeasurementsError, match="line 1: nothing but numbers, expected a header"):
        read(tmp_path, rows)


def test_a_header_that_has_numbers_is_one(tmp_path) -> None:
    with pytest.raises(MeasurementsError, match="no column 'load'"):
        read(tmp_path, "plot,2019,2020\nA,3.1,2.9\nB,2.7,2.2\n")


@pytest.mark.parametrize(
    ("load", "depth", "words", "not_words"),
    [
        ("0", "-{}", "load is 0 throughout, was its sensor connected?", "load is under 0"),
        ("-{}", "{}", "load is under 0 throughout, is its sign the other one?", "sinkage is"),
        ("{}", "-12{}.5", "sinkage is under 0 throughout and hardly changes", "sign"),
        ("{}", "-{}", "sinkage is under 0 throughout, is its sign the other one?", "load is"),
        ("0", "0", "sinkage is 0 throughout, was its sensor connected?", "under 0 throughout"),
    ],
)
def test_a_curve_that_never_presses_says_which_sensor_and_why(
    tmp_path, load: str, depth: str, words: str, not_words: str
) -> None:
    rows = "".join(f"plate,{load.format(i)},100,{depth.format(i)}\n" for i in range(1, 9))
    with pytest.raises(MeasurementsError, match="no row of load and sinkage over 0") as error:
        read(tmp_path, f"contact,load [N],diameter [mm],sinkage [mm]\n{rows}")
    assert words in str(error.value)
    assert not_words not in str(error.value)


def test_volts_beside_newton_metres_have_no_mean(tmp_path) -> None:
    head = "load [N],diameter [mm],width [mm],grouser torque [{}],rubber torque [{}]\n"
    counts = head.replace(" [{}]", "").replace("rubber torque", "grouser torque_V")
    for heads, mean in (
        (head.format("V", "N m"), False),
        (head.format("mV", "mV"), True),
        (counts, False),
    ):
        with pytest.raises(MeasurementsError, match="nothing was measured") as error:
            read(tmp_path, f"{heads}20,150,75,5.6,1.1\n")
        assert "which is it with --map" in str(error.value)
        assert ("their mean" in str(error.value)) == mean
