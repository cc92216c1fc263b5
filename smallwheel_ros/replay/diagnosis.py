# SPDX-License-Identifier: Apache-2.0
"""The bench's diagnosis of the steady stretches of a drive, at the end of its replay."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.fitting.constants import ALARM

if TYPE_CHECKING:
    import pandas as pd

# Stretches: with fewer an effect that is there is rarely seen; of more every second, third and so on is
# taken, since a diagnosis takes a tenth of a second for each.
_FEWEST, _MOST = 120, 240
# Chance of such stretches if nothing were missing, over which no model is refitted: four times the bench's
# own alarm. Drives of another author's simulator are above in 1 of 8 with hidden slip sinkage, in none of 3
# over hardpans, and in 9 of 12 with nothing hidden.
_NOTHING = 4.0 * ALARM


@dataclass(frozen=True)
class DriveDiagnosis:
    """Diagnosis of the model from a drive's steady stretches.

    Attributes
    ----------
    stretches
        Number of stretches used.
    verdict
        Verdict of `diagnose`; empty if there is none.
    effects, candidates
        Ids that the model lacks, and ids of which it lacks one.
    lines
        The diagnosis in sentences.
    """

    stretches: int
    verdict: str
    effects: tuple[str, ...]
    candidates: tuple[str, ...]
    lines: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """The diagnosis as replay.json has it."""
        return {
            "stretches": self.stretches,
            "verdict": self.verdict or None,
            "missing_effects": list(self.effects),
            "candidates": list(self.candidates),
            "text": list(self.lines),
        }


def diagnosed(table: pd.DataFrame, path: Path) -> DriveDiagnosis:
    """Diagnose a table of steady stretches.

    Parameters
    ----------
    table
        One row for each stretch, in the columns of measurements.csv.
    path
        File of the table, for the commands that are proposed next.
    """
    if len(table) < _FEWEST:
        return _none(table, f"there are {len(table)}, and it needs {_FEWEST}")
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
            return _nothing(len(used), chance, command)
        found = diagnosis_of(start)
    except SmallwheelError as error:
        return _none(used, str(error))
    following = {
        "apply": f"{command} --apply -o MODEL.yaml",
        "learn": f"smallwheel learn {shlex.quote(str(path))} -o law.py",
    }
    first, *_, next_step = verdict_sentences(found.document, following)
    return DriveDiagnosis(
        len(used),
        found.verdict,
        tuple(found.missing_effects),
        tuple(found.candidates),
        (f"Diagnosis of {len(used)} steady stretches: {first[0].lower()}{first[1:]}", next_step),
    )


def _nothing(stretches: int, chance: float, command: str) -> DriveDiagnosis:
    """That no effect shows, before any model was refitted."""
    return DriveDiagnosis(
        stretches, "adequate", (), (),
        (
            f"Diagnosis of {stretches} steady stretches: no missing effect shows (p = {chance:.2g}).",
            f"Next: `{command}` says what these stretches could not have shown.",
        ),
    )  # fmt: skip


def _none(table: pd.DataFrame, why: str) -> DriveDiagnosis:
    return DriveDiagnosis(
        len(table), "", (), (), (f"No diagnosis of the steady stretches: {why}.",)
    )
