# SPDX-License-Identifier: Apache-2.0
"""What a camera makes of slopes: fitted from slope to colour and from colour to slope."""
