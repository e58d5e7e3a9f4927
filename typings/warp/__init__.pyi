# SPDX-License-Identifier: Apache-2.0
# Warp's own annotations describe Python scope; inside kernels its vectors index, add and scale in
# ways they do not cover, which gives hundreds of false errors. Warp's compiler checks kernels.
from typing import Any

def __getattr__(name: str) -> Any: ...
