# SPDX-License-Identifier: Apache-2.0
"""The camera of a sensor: its lens, the media that bend its sight lines, what its pixels see."""
