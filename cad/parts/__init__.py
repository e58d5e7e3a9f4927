# SPDX-License-Identifier: Apache-2.0
"""Parametric parts: one file for the shape as formulas, one for the solid."""
