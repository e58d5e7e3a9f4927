# SPDX-License-Identifier: Apache-2.0
"""Recording: a camera in, a capture folder out, with pictures taken when a contact is steady."""
