# SPDX-License-Identifier: Apache-2.0
"""Pages in the browser: profiles, presses, studies, data sets, tasks and designs."""
