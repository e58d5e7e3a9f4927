# SPDX-License-Identifier: Apache-2.0
"""The families of the catalogue, a module each with its ``FAMILY``."""
