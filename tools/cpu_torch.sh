#!/usr/bin/env bash
# Installs PyTorch's build for CPUs, 0.2 GB, before anything asks PyPI for the one with CUDA, 3 GB.
#   tools/cpu_torch.sh PYTHON
# Where the index of CPU builds cannot be reached, what pip finds elsewhere is installed.
set -euo pipefail
cd "$(dirname "$0")/.."
index=https://download.pytorch.org/whl/cpu
"$1" -m pip install -q --disable-pip-version-check ${PIP_FLAGS:-} -c constraints.txt \
    --no-compile --no-deps --retries 1 --timeout 10 --extra-index-url "$index" torch
