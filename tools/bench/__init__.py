# SPDX-License-Identifier: Apache-2.0
"""Suites that make our documentation; ``python -m tools.bench`` runs them in a checkout."""
