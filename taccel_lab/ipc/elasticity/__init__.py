# SPDX-License-Identifier: Apache-2.0
"""Hyperelastic laws: energy, stress and Hessian of one element."""
