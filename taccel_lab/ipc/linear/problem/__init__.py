# SPDX-License-Identifier: Apache-2.0
"""One Newton system an environment: its arrays, its rows, its products."""
