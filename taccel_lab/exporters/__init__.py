# SPDX-License-Identifier: Apache-2.0
"""Sensor profiles in the formats of other simulators and tools."""
