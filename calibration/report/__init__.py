# SPDX-License-Identifier: Apache-2.0
"""The page of a profile, and what several pages of calibrations draw."""
