# SPDX-License-Identifier: Apache-2.0
"""Tasks that others can run again: geometry, starts, policy, criterion and seeds in one file."""
