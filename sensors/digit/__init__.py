# SPDX-License-Identifier: Apache-2.0
"""The DIGIT of Meta."""
