# SPDX-License-Identifier: Apache-2.0
"""Joints between affine bodies: constraint rows, their multipliers, limits and drives."""
