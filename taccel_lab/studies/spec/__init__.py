# SPDX-License-Identifier: Apache-2.0
"""The study file, its axes and what it reads: a study checked against the catalogue."""
