# SPDX-License-Identifier: Apache-2.0
"""How fast, at what error: scenes, suites and their results; ``taccel-lab bench`` runs them."""
