# SPDX-License-Identifier: Apache-2.0
"""Any flat gel bonded to a plate, for sensors that the catalogue does not know."""
