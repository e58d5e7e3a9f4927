# SPDX-License-Identifier: Apache-2.0
"""The report of a study: what is best, what trades against what, what moves what."""

from taccel_lab.studies.report.page import write_study_report

__all__ = ["write_study_report"]
