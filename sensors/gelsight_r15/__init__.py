# SPDX-License-Identifier: Apache-2.0
"""The GelSight R1.5."""
