# SPDX-License-Identifier: Apache-2.0
"""The bench's diagnosis of the steady stretches of a drive, at the end of its replay."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.fitting.constants import ALARM
from smallwheel_ros.measurements.display import effect_words

if TYPE_CHECKING:
    import pandas as pd

    from smallwheel_ros.diagnosis.pipeline import Diagnosis

# Stretches: with fewer, an effect that is there is rarely seen; if there are more, every second, third and so
# on is used, since a diagnosis takes a tenth of a second for each.
_FEWEST, _MOST = 120, 240
# Chance of such stretches if nothing were missing, over which no model is refitted: four times the bench's
# own alarm. Drives of another author's simulator are above it in none of 8 with hidden slip sinkage, and in
# 9 of 12 with nothing hidden.
_NOTHING = 4.0 * ALARM
_LIKELY = 0.5  # probability from which the likeliest of several candidates is singled out


@dataclass(frozen=True)
class DriveDiagnosis:
    """Diagnosis of the model from a drive's steady stretches.

    Attributes
    ----------
    stretches
        Number of rows used, each of one wheel and stretch.
    verdict
        Verdict of `diagnose`, such as `missing_effect` or `adequate`; empty if nothing was diagnosed.
    effects
        Ids of the effects that the model lacks.
    candidates
        Ids of effects of which the model lacks one.
    lines
        The diagnosis in sentences, or why there is none.
    by_filter
        Remarks of the soil's filter on missing effects, from every reading of the drive.
    """

    stretches: int
    verdict: str
    effects: tuple[str, ...]
    candidates: tuple[str, ...]
    lines: tuple[str, ...]
    by_filter: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The diagnosis as it stands in replay.json."""
        return {
            "stretches": self.stretches,
            "verdict": self.verdict or None,
            "missing_effects": list(self.effects),
            "candidates": list(self.candidates),
            "by_filter": list(self.by_filter),
            "text": list(self.lines),
        }


def diagnosed(table: pd.DataFrame, path: Path, remarks: Sequence[str] = ()) -> DriveDiagnosis:
    """Diagnose a table of steady stretches.

    Parameters
    ----------
    table
        One row for each wheel and stretch, with the columns of measurements.csv.
    path
        File of the table, for the commands that are proposed next.
    remarks
        Remarks of the soil's filter at the end, as in `SoilEstimate.remarks`. The filter uses every reading,
        and may show what a few stretches of much the same slip cannot.

    Returns
    -------
    DriveDiagnosis
        Without a verdict if there are fewer than 120 rows, or they cannot be diagnosed.
    """
    by_filter = tuple(remarks)
    if len(table) < _FEWEST:
        return _none(table, f"there are {len(table)}, and it needs {_FEWEST}", by_filter)
    from smallwheel_ros.diagnosis.pipeline import chance_of_nothing, diagnosis_of, start_of
    from smallwheel_ros.diagnosis.text import verdict_sentences
    from smallwheel_ros.measurements.from_file import read_measurements

    command = f"smallwheel diagnose {shlex.quote(str(path))}"
    runs = table["run"].drop_duplicates()
    used = table[table["run"].isin(runs.iloc[:: -(-len(table) // _MOST)])]
    try:
        start = start_of(read_measurements(used.reset_index(drop=True)))
        chance = chance_of_nothing(start)
        if chance > _NOTHING:
            return _nothing(len(used), chance, command, by_filter)
        found = diagnosis_of(start)
    except SmallwheelError as error:
        return _none(used, str(error), by_filter)
    if _none_is_likelier(found):
        return _stray(len(used), chance, command, by_filter)
    following = {
        "apply": f"{command} --apply -o MODEL.yaml",
        "learn": f"smallwheel learn {shlex.quote(str(path))} -o law.py",
    }
    first, *_, next_step = verdict_sentences(found.document, following)
    said = f"{first[0].lower()}{first[1:]}{_likeliest(found)}"
    return DriveDiagnosis(
        len(used),
        found.verdict,
        tuple(found.missing_effects),
        tuple(found.candidates),
        (f"Diagnosis of {len(used)} steady stretches: {said}{_agrees(by_filter)}", next_step),
        by_filter,
    )


def _probabilities(found: Diagnosis) -> dict[str, float]:
    """Probability of each candidate."""
    known = {row["effect"]: row["probability"] or 0.0 for row in found.rows()}
    return {name: known.get(name, 0.0) for name in found.candidates}


def _none_is_likelier(found: Diagnosis) -> bool:
    """Whether no effect at all is likelier than each effect and curve: none of them is then named."""
    none = found.document["lack_of_fit"].get("probability_of_none", 0.0)
    likely = max((row["probability"] or 0.0 for row in found.rows()), default=0.0)
    return found.verdict == "unknown_effect" and likely < none


def _likeliest(found: Diagnosis) -> str:
    """A sentence on the one of several candidates that is likelier than all others together."""
    known = _probabilities(found)
    name = max(known, key=known.__getitem__, default="")
    if len(known) < 2 or known[name] <= _LIKELY:
        return ""
    return f" Most probable: {effect_words(name)} ({known[name]:.2f})."


def _agrees(by_filter: tuple[str, ...]) -> str:
    """A sentence with the remarks of the soil's filter; empty if there are none."""
    return f" The soil's filter, from every reading: {'; '.join(by_filter)}." if by_filter else ""


def _stray(
    stretches: int, chance: float, command: str, by_filter: tuple[str, ...]
) -> DriveDiagnosis:
    """The diagnosis if stretches deviate from the law, but no effect is likelier than none."""
    return DriveDiagnosis(
        stretches, "unknown_effect", (), (),
        (
            f"Diagnosis of {stretches} steady stretches: they stray from the law (p = {chance:.2g}), and no"
            f" effect of the library is likelier than none.{_agrees(by_filter)}",
            f"Next: `{command}` says where they stray, and what would settle it.",
        ),
        by_filter,
    )  # fmt: skip


def _nothing(
    stretches: int, chance: float, command: str, by_filter: tuple[str, ...]
) -> DriveDiagnosis:
    """The diagnosis if the stretches agree with the law, so that no model was refitted."""
    shows = "these alone do not show a missing effect" if by_filter else "no missing effect shows"
    return DriveDiagnosis(
        stretches, "adequate", (), (),
        (
            f"Diagnosis of {stretches} steady stretches: {shows} (p = {chance:.2g}).{_agrees(by_filter)}",
            f"Next: `{command}` says what these stretches could not have shown.",
        ),
        by_filter,
    )  # fmt: skip


def _none(table: pd.DataFrame, why: str, by_filter: tuple[str, ...]) -> DriveDiagnosis:
    line = f"No diagnosis of the steady stretches: {why}.{_agrees(by_filter)}"
    return DriveDiagnosis(len(table), "", (), (), (line,), by_filter)
