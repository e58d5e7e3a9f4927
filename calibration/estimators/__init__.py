# SPDX-License-Identifier: Apache-2.0
"""Estimators: from captures and surfaces to profile blocks."""
