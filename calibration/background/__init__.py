# SPDX-License-Identifier: Apache-2.0
"""The untouched sensor: its mean image, how its light drifts, and how units of it differ."""
