# SPDX-License-Identifier: Apache-2.0
"""Launches of each term of the incremental potential."""
