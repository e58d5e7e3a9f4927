# SPDX-License-Identifier: Apache-2.0
"""The square GelSight of Taccel's examples."""
