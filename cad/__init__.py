# SPDX-License-Identifier: Apache-2.0
"""Parametric sensor parts, their meshes and their files; lengths are in millimetres."""
