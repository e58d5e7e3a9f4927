# SPDX-License-Identifier: Apache-2.0
"""What large parts of a gel do together, for conjugate gradients."""
