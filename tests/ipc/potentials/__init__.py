# SPDX-License-Identifier: Apache-2.0
"""Each potential as it is assembled, against finite differences."""
