# SPDX-License-Identifier: Apache-2.0
"""Which surfaces are in reach of one another, and what a contact costs."""
