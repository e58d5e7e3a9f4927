# SPDX-License-Identifier: Apache-2.0
"""Dimensioned drawings on paper sizes, as SVG, PDF or PNG."""
