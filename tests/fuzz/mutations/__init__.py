# SPDX-License-Identifier: Apache-2.0
"""Ways to damage a file or a folder, each drawn from a seed."""
