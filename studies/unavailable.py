# SPDX-License-Identifier: Apache-2.0
"""A figure that a design has not got."""


class Unavailable(Exception):
    """A metric has no value for a design; the message says why."""
