# SPDX-License-Identifier: Apache-2.0
"""Force from images: a network trained on a data set of simulated touches."""
