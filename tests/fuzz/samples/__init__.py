# SPDX-License-Identifier: Apache-2.0
"""Sound files to damage, as small as they can be."""
