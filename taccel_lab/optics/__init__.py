# SPDX-License-Identifier: Apache-2.0
"""Camera, lights and what a sensor would look like before it is built."""
