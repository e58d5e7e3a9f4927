# SPDX-License-Identifier: Apache-2.0
"""Reports of calibrations: one HTML page with verdict, tables and pictures, and its JSON."""

from taccel_lab.calibration.report.page import Page, Picture, Table, write_page

__all__ = ["Page", "Picture", "Table", "write_page"]
