# SPDX-License-Identifier: Apache-2.0
"""From colour to surface: the inverse model of a sensor, fitted to ball presses."""
