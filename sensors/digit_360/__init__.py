# SPDX-License-Identifier: Apache-2.0
"""The DIGIT 360 of Meta."""
