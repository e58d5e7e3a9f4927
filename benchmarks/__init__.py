# SPDX-License-Identifier: Apache-2.0
"""How fast, at what error: scenes, suites and their results.

``python -m taccel_lab.benchmarks`` runs everything here without the command line's libraries, on a
machine that has Warp and numpy only; ``taccel-lab bench`` is the same with better help.
"""
