# SPDX-License-Identifier: Apache-2.0
"""The Newton systems of all environments and their solvers."""
