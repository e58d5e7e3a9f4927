# SPDX-License-Identifier: Apache-2.0
"""The page of benchmarks, its pictures and the README's speeds, made from result files."""
