# SPDX-License-Identifier: Apache-2.0
"""The R-Tac dome of PP-Tac."""
