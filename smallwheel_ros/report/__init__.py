"""Self-contained HTML reports: one file that opens without a network and prints well."""

from __future__ import annotations

from smallwheel_ros.report.compare_report import compare_report
from smallwheel_ros.report.diagnosis_report import diagnosis_report
from smallwheel_ros.report.page import (
    Block,
    Callout,
    Details,
    Picture,
    ReportError,
    Section,
    Table,
    Text,
    page,
    write_page,
)
from smallwheel_ros.report.whole_report import whole_report

__all__ = [
    "Block",
    "Callout",
    "Details",
    "Picture",
    "ReportError",
    "Section",
    "Table",
    "Text",
    "compare_report",
    "diagnosis_report",
    "page",
    "whole_report",
    "write_page",
]
