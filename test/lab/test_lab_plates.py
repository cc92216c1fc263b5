# SPDX-License-Identifier: Apache-2.0
"""Plates: the model's k, n, m, Bekker's and Reece's constants, and plates that disagree with wheels.

Tests `agreement.py`, `lab.py` and `plates.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lab_truth import TRUTHS, N, plate_rows, pressed_rows, write
from scipy.optimize import curve_fit

from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.lab.lab import LabFit, fit_lab
from smallwheel_ros.lab.plates import PlateLaws, laws_text, plate_laws, which_law
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model
from smallwheel_ros.physics.plates import LAWS, equivalent_diameter, plate_area


def measured(tmp_path: Path, rows: list[list[object]]) -> Measurements:
    return read_measurements(write(tmp_path / "plates.csv", rows))


def lab(tmp_path: Path, rows: list[list[object]]) -> LabFit:
    return fit_lab(measured(tmp_path, rows))


def laws_of(tmp_path: Path, rows: list[list[object]]) -> PlateLaws:
    """The laws alone, without the fit's own held-out error."""
    problem = Problem.of(measured(tmp_path, rows))
    return plate_laws(problem.fitter, problem.fit, "soil")


def bins_of_runs(rows: list[list[object]]) -> np.ndarray:
    """ln p, ln z, D of six stretches of each run: what a textbook fits a line to. Shape (bins, 3)."""
    found = []
    for run in dict.fromkeys(row[0] for row in rows):
        mine = [row for row in rows if row[0] == run]
        z, load = (np.array([row[i] for row in mine], dtype=float) for i in (5, 4))
        d = float(mine[0][2])  # type: ignore[arg-type]
        for part in np.array_split(np.argsort(z), 6):
            pressure = load[part] / (np.pi / 4 * d**2)
            found.append([np.log(pressure).mean(), np.log(z[part]).mean(), d])
    return np.array(found)


@pytest.mark.parametrize("seed", range(2))
def test_n_and_m_are_those_of_a_line_in_logarithms(tmp_path: Path, seed: int) -> None:
    rows = plate_rows(np.random.default_rng(seed), sizes=(0.05, 0.1, 0.15))
    log_p, log_z, d = bins_of_runs(rows).T
    design = np.column_stack([np.ones_like(d), log_z, np.log(d)])
    _, n, m = np.linalg.lstsq(design, log_p, rcond=None)[0]
    fit = lab(tmp_path, rows).fit
    assert fit is not None
    for name, other, truth in (("n", n, N), ("m", m, 0.5)):
        found = next(p for p in fit.parameters if p.name == name)
        assert found.std is not None
        assert abs(found.value - other) < 1.5 * found.std
        assert abs(found.value - truth) < 2.5 * found.std


def test_a_curve_of_a_thousand_rows_is_one_curve(tmp_path: Path) -> None:
    fits = [lab(tmp_path, plate_rows(np.random.default_rng(4), rows=r, runs=2)) for r in (25, 1000)]
    for name in ("n", "m", "log_reference_pressure"):
        few, many = (next(p for p in f.fit.parameters if p.name == name) for f in fits if f.fit)
        assert few.std is not None
        assert many.std is not None
        assert abs(few.value - many.value) < 0.3 * many.std
        assert many.std == pytest.approx(few.std, rel=0.15)
    few_laws, many_laws = (f.laws[0] for f in fits)
    for a, b in zip(few_laws.laws, many_laws.laws, strict=True):
        assert a.held_out == pytest.approx(b.held_out, rel=0.1)


def bekker(x: np.ndarray, kc: float, kphi: float, n: float) -> np.ndarray:
    return np.log(np.maximum(kc / (x[1] / 2) + kphi, 1e-3)) + n * x[0]


def reece(x: np.ndarray, cohesive: float, frictional: float, n: float) -> np.ndarray:
    b = x[1] / 2
    return np.log(np.maximum(cohesive + frictional * b, 1e-3)) + n * (x[0] - np.log(b))


@pytest.mark.parametrize(
    ("law", "formula", "truth"),
    [("bekker", bekker, (2e4, 8e5, N)), ("reece", reece, (3e3, 2e5, N))],
)
def test_constants_are_those_of_a_direct_fit(
    tmp_path: Path, law: str, formula: object, truth: tuple[float, ...]
) -> None:
    rows = plate_rows(np.random.default_rng(11), law)
    log_p, log_z, d = bins_of_runs(rows).T
    direct, _ = curve_fit(formula, np.array([log_z, d]), log_p, p0=truth)
    laws = laws_of(tmp_path, rows)
    fitted = next(f for f in laws.laws if f.law.id == law)
    for constant, other, true in zip(fitted.constants, direct, truth, strict=True):
        assert constant.std is not None
        assert abs(constant.value - other) < 1.5 * constant.std
        assert abs(constant.value - true) < 2.5 * constant.std
    deviations = np.sqrt(np.diag(fitted.covariance))
    assert deviations == pytest.approx([c.std for c in fitted.constants])


def test_the_law_of_the_soil_predicts_the_plate_left_out(tmp_path: Path) -> None:
    laws = lab(tmp_path, plate_rows(np.random.default_rng(2), sizes=(0.03, 0.06, 0.12, 0.2))).laws[
        0
    ]
    errors = {law.law.id: law.held_out for law in laws.laws}
    assert laws.best is laws.laws[0]
    assert errors["meirion_griffith_spenko"] < 0.15
    assert errors["bekker"] > 0.3  # p = (kc/b + kphi) z^n cannot grow with the plate's size so
    said = " ".join(which_law(laws))
    assert "Meirion-Griffith & Spenko's law predicts" in said
    assert "Bekker" in laws_text(laws)
    assert "kphi" in laws_text(laws)


def test_two_sizes_fit_and_do_not_judge(tmp_path: Path) -> None:
    laws = laws_of(tmp_path, plate_rows(np.random.default_rng(2), sizes=(0.06, 0.12)))
    assert all(law.held_out is None for law in laws.laws)
    assert "third size" in laws_text(laws)


def test_one_size_says_what_it_cannot_tell(tmp_path: Path) -> None:
    found = lab(tmp_path, plate_rows(np.random.default_rng(2), sizes=(0.08,)))
    assert not found.laws
    assert "kc apart from kphi" in found.notes[0]
    assert found.fit is not None
    assert next(p for p in found.fit.parameters if p.name == "m").status == "held"


def test_plates_close_in_size_determine_no_constant_of_size(tmp_path: Path) -> None:
    laws = laws_of(tmp_path, plate_rows(np.random.default_rng(2), sizes=(0.08, 0.085, 0.09)))
    kc = next(c for law in laws.laws for c in law.constants if c.name == "kc")
    assert kc.status == "not determined"


@pytest.mark.parametrize(("factor", "agrees"), [(1.0, True), (0.4, False)])
def test_a_wheel_that_meets_another_soil_is_said(
    tmp_path: Path, factor: float, agrees: bool
) -> None:
    rng = np.random.default_rng(6)
    (found,) = lab(tmp_path, plate_rows(rng) + pressed_rows(rng, factor)).agreements
    assert found.agrees is agrees
    assert found.low < factor < found.high
    assert ("disagree" in found.sentence()) is not agrees


def test_a_model_that_the_wheels_contradict_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    known = lab(tmp_path, plate_rows(rng)).model
    found = fit_lab(measured(tmp_path, pressed_rows(rng, 0.4)), known=known)
    (with_model,) = found.agreements
    assert with_model.first == "the model's soil"
    assert not with_model.agrees


def test_laws_agree_where_their_constants_say_the_same() -> None:
    """At one size, K of each law is the same modulus."""
    from smallwheel_ros.physics.conditions import Conditions

    plates = Conditions.of([10.0, 200.0], 0.1, np.nan, contact="plate")
    for law in LAWS:
        reference = float(law.size(plates)[0])
        z = law.sinkage(plates, reference, np.log(2e4), 0.8, 0.3)
        pressure = plates.load / plate_area(0.1)
        assert pressure == pytest.approx(2e4 * (z / 0.01) ** 0.8)


def test_rectangular_plates_have_the_area_of_their_equivalent() -> None:
    assert plate_area(equivalent_diameter(0.05, 0.2)) == pytest.approx(0.01)


def test_no_law_of_the_truth_needs_the_package() -> None:
    assert set(TRUTHS) == {law.id for law in LAWS}


def test_plates_of_a_real_rig(shared_data: Path) -> None:
    """Three sizes on one sand, and the wheel pressed into it (SOURCE.md): m near 1, and they disagree."""
    found = fit_lab(
        read_measurements(shared_data / "cmu_wheel_rig" / "indentation.csv"), base=Base()
    )
    laws = found.laws[0]
    m = next(c for c in laws.laws[0].constants if c.name == "m")
    assert m.std is not None
    assert abs(m.value - 1.0) < 1.5 * m.std
    error = [law.held_out for law in laws.laws if law.held_out is not None]
    assert error[0] < 0.14
    assert max(error) < 0.4  # an m over 1 is beyond what Bekker's and Reece's laws can have
    assert error[0] == min(error)
    assert len(error) == 3
    (wheel,) = found.agreements
    assert wheel.high < 1.0


def test_a_lab_is_its_fit_and_the_constants_of_the_laws(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    found = lab(tmp_path, plate_rows(rng, runs=2, rows=15) + pressed_rows(rng, 1.0))
    assert found.fit is not None
    (laws,) = found.laws
    constants = [(law.law.name, c) for law in laws.laws for c in law.constants]
    rows, of_fit = found.rows(), found.fit.rows()
    assert rows[: len(of_fit)] == of_fit
    told = [(row["of"], row["parameter"], row["value"], row["std"]) for row in rows[len(of_fit) :]]
    assert told == [(f"{c.owner}, {law}", c.name, c.value, c.std) for law, c in constants]
    assert {"kc", "kphi"} <= {name for _, name, _, _ in told}
    assert found.headline() == f"{found.fit.headline()}; plates of {len(laws.diameters)} sizes"
    assert found.held_out == found.fit.held_out
    assert found.parameters == found.fit.parameters  # no shear test has told of a strength
    named = found.named()
    assert set(found.fit.named()) <= set(named)
    assert {c.full_name for _, c in constants} <= set(named)
    assert all(named[name] == own for name, own in found.fit.named().items())
    document = found.to_dict()
    assert document["schema"] == 1
    assert len(document["plate_laws"]) == 1
    assert [one["agrees"] for one in document["agreements"]] == [a.agrees for a in found.agreements]
    assert (document["shear"], document["lab_notes"]) == ([], list(found.notes))
    text = str(found)
    for part in (found.fit.text(), laws_text(laws), *(a.sentence() for a in found.agreements)):
        assert part.rstrip(".")[1:] in text
    again = Model.load(found.save(tmp_path / "lab.yaml"))
    assert again.soils[0].k == pytest.approx(found.model.soils[0].k, rel=1e-6)
