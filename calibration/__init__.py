# SPDX-License-Identifier: Apache-2.0
"""Captures in, profile blocks out: loading, targets, estimators and their evaluation."""
