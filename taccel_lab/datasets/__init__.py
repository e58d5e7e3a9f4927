# SPDX-License-Identifier: Apache-2.0
"""Labelled data sets of simulated touches: a TOML file in, zarr arrays and a Parquet index out."""
