# SPDX-License-Identifier: Apache-2.0
"""Designs evaluated: runner, folder, shards, optimisers, the rows that come of it."""
