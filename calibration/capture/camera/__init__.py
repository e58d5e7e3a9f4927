# SPDX-License-Identifier: Apache-2.0
"""Cameras: of a sensor that is plugged in, or replayed from images and videos."""
