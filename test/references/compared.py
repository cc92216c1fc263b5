# SPDX-License-Identifier: Apache-2.0
"""What this package finds for each reference problem, and how many digits agree with what is certified.

Digits are those of NIST's Statistical Reference Datasets: -log10 of the relative error, at most 15. What is
asked of each group of values stands in `ASKED`, with what limits it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
from reference_file import Reference, Value, read_reference

import smallwheel_ros as sw
from smallwheel_ros.lab.lab import LabFit
from smallwheel_ros.model.model import Model, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.paper import table_7
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

MOST_DIGITS = 15.0  # of a double
OFF = 0.005  # of its standard deviation, no estimate may differ by more: the second digit of the deviation

Found = dict[str, tuple[float, float | None]]  # by name: a value and its deviation


class Asked(NamedTuple):
    """Of values whose names match: least digits, of deviations too, and what limits them."""

    names: str
    digits: float
    of_deviation: float
    why: str


class Compared(NamedTuple):
    """One value. digits: that agree; of_deviation: of its standard deviation, None where it has none."""

    name: str
    certified: Value
    value: float
    digits: float
    of_deviation: float | None
    asked: Asked

    @property
    def off(self) -> float | None:
        """Difference over the certified standard deviation."""
        if self.certified.deviation is None:
            return None
        return abs(self.value - float(self.certified.value)) / float(self.certified.deviation)


_STOPS = "the fit rests where little is gained: 0.05 nats, 0.001 of the size of a value"
_NODES = "12 nodes along the arc, 8 behind a kink of the stresses"

ASKED: dict[str, tuple[Asked, ...]] = {
    "contact_integral": (Asked(".*", 14, 0, "rounding of double precision"),),
    "wheel_forces": (
        Asked(r".*\.sinkage", 14, 0, "rounding of double precision"),
        Asked(".*", 6, 0, _NODES),
    ),
    "wong_reece_1967": (Asked(".*", 5, 0, _NODES),),
    "paper_2011": (Asked(".*", 12, 0, "rounding of double precision"),),
    "plates_exact": (
        Asked("n", 5, 0, "the fit rests where little is gained"),
        Asked("k|m", 4, 0, "its priors pull, as far as the scatter of each value leaves m open"),
    ),
    "plates_noise": (
        Asked(".*", 2.5, 2.4, _STOPS),
    ),
    "plates_cmu": (Asked(".*", 2.5, 2.5, _STOPS),),
    "wheel_k_n_m": (Asked(".*", 2.5, 2.5, _STOPS),),
    "shear_exact": (Asked(".*", 12, 0, "rounding, and where least squares stop"),),
    "shear_noise": (
        Asked(r"\d.*", 7, 0, "least squares of each curve stop at changes of 1e-8"),
        Asked(".*", 4, 2, "the scatter of runs is sought to 1 %, and its curvature with steps of 0.1"),
    ),
    "shear_cullinan": (Asked(".*", 5, 0, "least squares of each curve stop at changes of 1e-8"),),
}  # fmt: skip


def digits(found: float, certified: str) -> float:
    """How many digits agree, 0 to 15."""
    wanted = float(certified)
    if found == wanted:
        return MOST_DIGITS
    return float(np.clip(-math.log10(abs(found - wanted) / abs(wanted)), 0.0, MOST_DIGITS))


def frame(reference: Reference) -> pd.DataFrame:
    """The data of a reference as a table of this package."""
    table = pd.DataFrame(reference.rows, columns=reference.columns)
    for name in table.columns:
        if "[" in name:
            table[name] = table[name].astype(float)
    return table


def _prediction(
    row: tuple[str, ...], form: ThrustForm = "stress_integral", rule: str = "contact_integral"
) -> Prediction:
    load, diameter, width, k, n, m, *shear = map(float, row[1:])
    soil, covariates = Soil(row[0], k, n, m), {}
    if shear:
        cohesion, friction, modulus, slip, rolling, rim, peak = shear
        moves = peak / slip if slip > 0.0 and form == "stress_integral" else 0.0
        soil = Soil(
            row[0], k, n, m, cohesion, math.radians(friction), modulus, "", rolling, rim, moves
        )
        covariates = {"slip": slip}
    model = Model(soil, rule, thrust_form=form)  # type: ignore[arg-type]
    return predict(model, Conditions.of(load, diameter, width, **covariates))


def _contact(reference: Reference) -> Found:
    found: Found = {}
    for row in reference.rows:
        whole, closed = _prediction(row), _prediction(row, rule="closed_form")
        found[f"{row[0]}.sinkage"] = float(whole.sinkage[0]), None
        found[f"{row[0]}.compaction_resistance"] = float(whole.compaction_resistance[0]), None
        found[f"{row[0]}.closed_form_sinkage"] = float(closed.sinkage[0]), None
    return found


def _forces(reference: Reference) -> Found:
    form: ThrustForm = "wong_reece" if reference.name.startswith("wong") else "stress_integral"
    names = ("sinkage", "thrust", "rolling_resistance", "drawbar_pull", "torque")
    found: Found = {}
    for row in reference.rows:
        said = _prediction(row, form)
        found |= {f"{row[0]}.{name}": (float(getattr(said, name)[0]), None) for name in names}
    return found


def _fitted(reference: Reference) -> Found:
    fit = sw.fit(frame(reference))
    found: Found = {name: (fit[name].value, fit[name].std) for name in ("k", "n", "m")}
    laws = fit.laws[0].laws if isinstance(fit, LabFit) else ()
    for law in laws:
        found |= {f"{law.law.id}.{c.name}": (c.value, c.std) for c in law.constants}
    return found


def _sheared(reference: Reference) -> Found:
    fit = sw.fit(frame(reference))
    assert isinstance(fit, LabFit)
    names = ("cohesion", "friction_angle", "shear_displacement")
    found: Found = {name: (fit[name].value, fit[name].std) for name in names}
    for law in (fit.shear[0].plain, fit.shear[0].peaked):
        for run in law.runs:
            owner = law.law.id if len(law.runs) == 1 else run.curve.run
            strength, log_modulus, *residual = run.numbers.tolist()
            if law.law.id == "peak_residual" and len(law.runs) > 1:
                continue
            found[f"{owner}.strength"] = strength, None
            found[f"{owner}.shear_displacement"] = math.exp(log_modulus), None
            found |= {f"{owner}.residual": (value, None) for value in residual}
            found[f"{owner}.misfit"] = run.misfit, None
    return found


def _paper(reference: Reference) -> Found:
    """Lines of Table 7 in `smallwheel paper` come in the order of the file."""
    pairs = zip(reference.rows, table_7(), strict=True)
    return {row[0]: (line.computed, None) for row, line in pairs}


_FINDERS: dict[str, Callable[[Reference], Found]] = {
    "contact_integral": _contact,
    "wheel_forces": _forces,
    "wong_reece_1967": _forces,
    "paper_2011": _paper,
    "plates_exact": _fitted,
    "plates_noise": _fitted,
    "plates_cmu": _fitted,
    "wheel_k_n_m": _fitted,
    "shear_exact": _sheared,
    "shear_noise": _sheared,
    "shear_cullinan": _sheared,
}


def compared(name: str) -> list[Compared]:
    """Every certified value of a problem beside what this package finds.

    The scatter (phi) is part of the certificate, for other codes; the package's is not compared.
    """
    reference = read_reference(name)
    found = _FINDERS[name](reference)
    lines = []
    for value_name, certified in reference.certified.items():
        if value_name.startswith("phi."):
            continue
        value, std = found[value_name]
        asked = next(a for a in ASKED[name] if re.fullmatch(a.names, value_name))
        of_deviation = None
        if certified.deviation is not None:
            assert std is not None, f"{name}: {value_name} has no deviation"
            of_deviation = digits(std, certified.deviation)
        agree = digits(value, certified.value)
        lines.append(Compared(value_name, certified, value, agree, of_deviation, asked))
    return lines
