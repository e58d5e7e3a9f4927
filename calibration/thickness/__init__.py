# SPDX-License-Identifier: Apache-2.0
"""How thick the gel of captures is, where nobody has measured it."""
