# SPDX-License-Identifier: Apache-2.0
"""Dots on the gel: fitted to a layout in millimetres, followed through videos."""
