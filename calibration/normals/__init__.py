# SPDX-License-Identifier: Apache-2.0
"""Inverse model of a sensor, from colour to surface, fitted to ball presses."""
