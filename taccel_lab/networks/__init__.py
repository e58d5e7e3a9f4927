# SPDX-License-Identifier: Apache-2.0
"""The small networks of a profile as plain data: settings, shapes of the weights, and whether what
they answer exists. ``taccel_lab.signals`` runs them, with torch."""
