# SPDX-License-Identifier: Apache-2.0
"""The source of a default that no source states."""

NO_FIGURE = "assumption: no source states it for this sensor"
