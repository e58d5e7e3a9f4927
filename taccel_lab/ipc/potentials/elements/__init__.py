# SPDX-License-Identifier: Apache-2.0
"""Elastic and viscous energies of tets."""
