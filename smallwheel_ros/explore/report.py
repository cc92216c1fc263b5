# SPDX-License-Identifier: Apache-2.0
"""Pages of a diagnosis with the effects to set and unset in them."""

from __future__ import annotations

from pathlib import Path

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.diagnosis import Diagnosis
from smallwheel_ros.explore.data import SessionData
from smallwheel_ros.explore.session import Count, ExploreError, Session
from smallwheel_ros.report.effects_section import EffectsPage
from smallwheel_ros.report.page import write_page
from smallwheel_ros.report.whole_report import whole_report


def diagnosis_page(
    diagnosis: Diagnosis,
    session: Session | None = None,
    comparison: Comparison | None = None,
    progress: Count = lambda done, needed: None,
    pairs: bool = True,
) -> str:
    """The diagnosis as one self-contained HTML page.

    session: where every effect and every pair shall be in it, and not only the steps to the verdict;
    progress: told how many of these fits are done; pairs: whether pairs shall.
    """
    return whole_report(
        diagnosis.document,
        effects=_effects(diagnosis, session, progress, pairs),
        comparison=comparison,
        measurements=diagnosis.measurements,
    )


def write_diagnosis(diagnosis: Diagnosis, path: Path) -> None:
    """Write the page. Raises OutputError where it cannot be written."""
    write_page(path, diagnosis_page(diagnosis))


def _effects(
    diagnosis: Diagnosis, session: Session | None, progress: Count, pairs: bool
) -> EffectsPage | None:
    """What can be set and unset; None where nothing could be held out."""
    try:
        opened = session or Session(diagnosis)
        data = SessionData(opened)
    except ExploreError:
        return None
    views = opened.steps() if session is None else opened.fit_beforehand(progress, pairs)
    return data.page(views, opened.chosen)
