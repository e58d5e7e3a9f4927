# SPDX-License-Identifier: Apache-2.0
"""The standard presses: what every design goes through, and what a press leaves behind."""
