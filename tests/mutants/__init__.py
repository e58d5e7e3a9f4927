# SPDX-License-Identifier: Apache-2.0
"""Faults that are planted in the product, one at a time: do the tests notice them?"""
