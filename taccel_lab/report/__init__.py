# SPDX-License-Identifier: Apache-2.0
"""Reports and pictures: one self-contained HTML page, a JSON and PNG files."""
