# SPDX-License-Identifier: Apache-2.0
"""How fast, at what error: scenes, suites and their results.

``taccel-lab bench`` and ``python -m taccel_lab.benchmarks`` are the same command line; the second
also starts where nothing but Warp and numpy is installed.
"""
