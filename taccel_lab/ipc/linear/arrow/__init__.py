# SPDX-License-Identifier: Apache-2.0
"""Direct solution of small gels in block-arrow form."""
