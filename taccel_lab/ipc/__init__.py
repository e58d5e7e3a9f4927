# SPDX-License-Identifier: Apache-2.0
"""Incremental potential contact: energies, distances, barrier, friction and CCD as Warp functions.

All functions are FP64 `wp.func`s without state. Import from the modules, so that only what a kernel
uses is compiled into it.
"""
