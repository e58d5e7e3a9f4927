# SPDX-License-Identifier: Apache-2.0
"""Which primitives may come near one another in a step."""
