# SPDX-License-Identifier: Apache-2.0
"""The solver against closed forms, conservation laws and its own invariants."""
