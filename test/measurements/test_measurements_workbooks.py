# SPDX-License-Identifier: Apache-2.0
"""Old workbooks (xls), and what is not read of xls and ods.

Tests `workbooks.py`.
"""

from __future__ import annotations

import base64
import resource
import zlib
from pathlib import Path

import messy_tables as messy
import pytest

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import MeasurementsError


def book(packed: str) -> bytes:
    """A workbook that xlwt 1.3.0 wrote."""
    return zlib.decompress(base64.b64decode(packed))


# The truth of messy_tables; then slips shown in per cent, a load that is #DIV/0!, a width without a value;
# then one cell in the last corner, IV65536.
PLAIN = book(
    "eNrtWE1oE0EU/mZ/mrQkaVJToRVKKLYmsQjixUsblWoPaqj10CJC3ZigIWlaQjwoiNXaoyB6EMVLoRcvrV78QQW9CQoV"
    "PQiC0OrRk6Ig2GZ987IbmxpKA1pU9lvmzXtv3nwzO3/783IuMD91p3UBK9ADFUWzHnXLfIJSvW34QeWmKVU7d1MyHfxT"
    "qHfTRNbpeOh94ZJzKOd7AQpua09JAu8pHcUY4qO5VGgdsYf7YAjZh26SAjfJ40ML96qJ5XGWG1jOcuQjlrvYc4llN8XO"
    "iyOYi8WjO61VPKS0c5kPkvce13nLnu1oxjO5is9dFqVYHbvzaSP7dxa0aR5Mg+atL5VL5Y3sPII0gdP4aoaAL/ZOfRJy"
    "/OvrFyD/t0q/q4r/qqIB4zCP8QKfhAffVVmiodcoGIsYQoN1rJJ74FSOtAOjRjIUjke8QG/aGEkVUvlQeGQkQoGD6WTh"
    "JBsUdzibHguFOyIeUtO5jHEixSW0fgxKCclb2vr+iq3v5S3hIZlEI+sB3hh+6sXirU+vDib6Y8PsGed+lR4KHfI+YOK8"
    "rEGVfVyiw2aNco2tLC8w6ybWW1kGKZLyzv5mS9k3wTEXubST2tnBeB3bskwPkz758dD9tskPsQjpM30LZ4Izb2JTaKeH"
    "VJLqy2sCXaJL3Lgu8SBm58I6QN6xbPnlMHErfqvvpvXka8QSzwVoPCRKlhwdUbYUa6xKlkqWWrY0srSypZOlW+2IKu0I"
    "bkeO3GNs5vsI4DP74pqUV4SUUfbs90o+yaRUYVIqmJRVmWbLTGoVJpVjXBaTykzPz65kGuCoawGbSavCpFUwaasybePR"
    "6lGacFfeCh3tP9EABw4cOHDgwIEDBzVD8Isrf2Dwi5luvbK7rP86S5SKzm+S/xYDGKWrQB+me5GjPI/TNa2fjdCFzSXW"
    "WMf+XygxSK3nkUGC+5Gpef3Sh5xYfj9rruj/fVuo1vaLtfTzD7f/A/j66I8="
)
LOST = book(
    "eNrtWE1IVFEU/u77cX6a0RnTQAMbJG1GJYo2bXQqLBfVYLooIqinM9SgjjJMi4LKMpdB1CKKNoKbNlqbfqjAdkGBUYsg"
    "CLSWrYqCFurr3PPemxybxIGSjPc97rnnnHvvd++7/++9mg7PjN2rncUStEHFgulD2SKfoOBzjBAo3TSl6sReCqaLNQWf"
    "lwayTMfj4EuPHEM53rNQcFd7RhL4QOEYhpAYzKQiq4g93AZDyDa0khS4TZ5y1HCrKln2slzPcpJzPmG5iz1XWLZS3hlx"
    "FNPxRNNOexYfUeo5rRyS9wGXecee7ajGczmLL1wVVl4du7Npo3+NJdRpAYyDBrQjlUlljf4ZVNHIjuObGQG+Okt4KuL6"
    "V9cvQP7vhX7Pb/xe2muX+q8rGjAM8wSviFEEsE2TKRrajZwxRyt1nb1Hq0DX6QztyAcGjWQkmogFgfa0MZDKpbKR6MBA"
    "zA8cTidzp9igfN396aFItCEWIDWd6TNOpjiF5pVBoYdCr19y834RKtgvgryOAiSTqGA9zKspRO8wd+fz64M9nfHj7Bnm"
    "M8I6SRrku8DERVmCCpfD4bNkE5doZnmJWTeyXsuyiqY6xY2d1bayb4TzXObURqpnB+NNfMsiPUr66KdDD+tGP8ZjpE90"
    "zJ6tmngbH0M99VqSystnBC2iRdy6KfEo7sTC3nXes6z5ZQfyKiG77aZ9XFZgHn5WwywtS/aOyFuK3VeWpZKl5i2NLC1v"
    "6WTpdj2iSD2C65E99xSb+T3C+MK+hCblNSH3zWb27A9KPsmkFGFSCpiUZZkm80xqESaV83hsJpWZXpxbytTNuW6EHSat"
    "CJNWwKQty7QVDpPOvVjIpHMeOQ91xUuWZPKI84qfJ5LFV4ZNZDmjIW81FoUP7dSxU3UK9DalEvdlT9Fx8xN+uHDhwoUL"
    "Fy5c/OMQfAfl7wW+Y+n27dtj/9eZp7Dg/ib5b9GFQXpy9J25FxmKszhT0vzZAF04XGKFZZz/hRKHqfYs+tDD7egref7S"
    "N5lY/D4rLhj6c0uo1PoXSmnnX67/B18z9y4="
)
CORNER = book(
    "eNrtWD1oE2EYfr7LpfkhSZOaCq1QQqE1qV3ExaWmSrWLhlqFigh6NUFD/kqIgw5arRkFwUlxKXRxqbr4gyK6OQgVHQRB"
    "SBQnJ6GiQ5vz/d67xEvN0ICWKvcc33vv733vff93r5dClfn7vVWswR44UNM96LDoBBVPXQiC7Lou2frdTUW38U/B46aO"
    "7HDiif+VS/ah7O8qFNxTXxAFPlI5gRkkCvlUZAOxj3PQhMxhhKjAbdIE0MNZdTE9zXQL07vs+ZTpKGuuMR0h34o4jqV4"
    "Ymi3OYqPKf1sC0A+9yHHvGfNTnTjpRzFl64Lw9eJvcW0lt2chj7VhwVQv42n8qmilq0gTB24gG96BFiuz9TnEVu/sXoB"
    "0v9o1rta6G8oKjAL/RQP8DJ8+O6QFhVjWklbwVHZt1xIPXkuTwvswYKWjEQTMT8wltZyqVKqGInmcjEvMJVOls6yQH5H"
    "sumZSHQg5iM2nc9oZ1JsofGjeeUyztM+2DTt/TwdfEST6GQ+xJMiSAv7yp2vbw5NT8RPsmaWl3pjQxiQ7wAdl2UEBQcs"
    "m4UkQxyxg+kVfuo25nuZhmko031wottkDsyxz1W2DlI9uxhv49stfJT48pfDj/rKn+Ix4hfHqxfCi+/i8+inDSpJ8fKa"
    "w7AYFrduSjyO1+/CXDw+MO35bSFxK0EYLaKbL9KJVXiZDTE1JNk6oiEpZlsZkoMkR0NSSVIbkpMkp1mPYN/megTXI/vj"
    "oiIl+eSEavgra/yf0bsrZl4Gb+QhfR0tfB0Wu9rCrlrsvKWLX3aZjdznjdw+cysKjlA4Sz40KF14wOyo5djghQ0bNmzY"
    "sGHDho1NA8GHV/7A4COh0/wYcJn/dVap1OzfJP8tJlGgq0QfpvuRp3sR59saP1vhFPVniXXG1P8XSkxR7UVkMM15ZNoe"
    "v/QZIqzvs+7A4J+bQu3WX2snz79c/0+IJuDw"
)


def read(folder: Path, data: bytes) -> object:
    (folder / "a").write_bytes(data)
    return read_measurements(folder / "a")


def fault(folder: Path, data: bytes) -> str:
    with pytest.raises(MeasurementsError) as caught:
        read(folder, data)
    return str(caught.value)


def test_an_xls_is_read_and_what_it_does_not_tell_is_said(tmp_path: Path) -> None:
    data = read(tmp_path, PLAIN)
    assert data.run.tolist() == [row[0] for row in messy.TRUTH]  # type: ignore[attr-defined]
    c, z = data.conditions, data.channels  # type: ignore[attr-defined]
    assert c.load.tolist() == [60.0, 60.0, 80.5, 80.5]
    assert c["slip"].tolist() == pytest.approx([0.1, 0.1, 0.2, 0.2])
    assert z["sinkage"].tolist() == pytest.approx([0.0085, 0.00875, 0.01125, 0.011])
    assert any("20 % is read as 0.2" in line for line in data.understood)  # type: ignore[attr-defined]


def test_shares_below_per_cent_and_errors_in_an_xls_are_refused(tmp_path: Path) -> None:
    said = fault(tmp_path, LOST)
    assert "slip is 0.2 % at most: are these shares, shown in per cent?" in said
    assert "row 6, column 'Load (N)': the cell is blank" in said
    assert "row 6, column 'Width (mm)': the cell is blank" in said


@pytest.mark.parametrize("column", [b"\xff\x00", b"\xff\xff"])
def test_a_cell_in_the_last_corner_of_an_xls_is_refused(tmp_path: Path, column: bytes) -> None:
    """The second is outside of any sheet: calamine asks for 100 GB, and aborts."""
    cell = b"\x7e\x02\x0a\x00\xff\xff"
    assert CORNER.count(cell + b"\xff\x00") == 1
    data = CORNER.replace(cell + b"\xff\x00", cell + column)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "expected at most 5000000 cells: delete what stands far from the table" in fault(
        tmp_path, data
    )
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('office:value-type="float" office:value="80.5" calcext:value-type="float"',
         'table:formula="of:=1/0" office:value-type="string" calcext:value-type="error"',
         "sheet 'A' has errors of formulas"),
        ('<table:table-cell office:value-type="float" office:value="80.5" calcext:value-type="float">'
         "<text:p>80,5</text:p></table:table-cell>",
         '<table:table-cell table:formula="of:=B2*2"/>', "has formulas without a computed value"),
    ],
)  # fmt: skip
def test_formulas_of_an_ods_that_have_no_value_are_refused(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    data = messy.ods(A=[messy.ENGLISH, *map(list, messy.TRUTH)])
    assert words in fault(tmp_path, messy.changed(data, "content.xml", old.encode(), new.encode()))
