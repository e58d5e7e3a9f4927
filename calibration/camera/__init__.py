# SPDX-License-Identifier: Apache-2.0
"""Calibration of the camera: boards, lens, pose of the gel, scale, rectification."""
