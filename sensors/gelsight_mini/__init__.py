# SPDX-License-Identifier: Apache-2.0
"""The GelSight Mini."""
