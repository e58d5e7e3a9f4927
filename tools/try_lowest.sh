#!/usr/bin/env bash
# Installs the lowest release of every range of pyproject.toml and runs commands and their tests there.
#   tools/try_lowest.sh PYTHON UV_PYTHON
# PYTHON: the oldest interpreter that is allowed; UV_PYTHON: one whose environment has uv.
# PyTorch is that of constraints.txt: builds for CPUs come from an index of their own. What runs the
# tests is of constraints.txt, too. Needs 3 GB in $TMPDIR.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD python=$1 uv=$(dirname "$2")/uv
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$python" -m venv "$work/venv"
lowest=$work/venv/bin/python
tools/cpu_torch.sh "$lowest"
grep '^torch==' constraints.txt >"$work/torch.txt"
export UV_DEFAULT_INDEX=${UV_DEFAULT_INDEX:-https://pypi.org/simple}
"$uv" pip install -q --python "$lowest" ${PIP_FLAGS:-} --resolution lowest-direct -c "$work/torch.txt" \
    -e ".[demo,video,parquet,onnx,repair,robots,newton,datasets,learning,tensorboard,optuna,slurm,view]"
"$uv" pip install -q --python "$lowest" ${PIP_FLAGS:-} -c <(grep -v '^packaging==' constraints.txt) \
    pytest pytest-timeout pytest-xdist hypothesis
"$lowest" -m pip check

cd "$work"
export PYTHONPATH=$root OMP_NUM_THREADS=1 MPLBACKEND=Agg
"$lowest" -c "from pathlib import Path; from tests.support.small_captures import write_captures as w; w(Path('captures'))"
# As people see it: in the tests noise stands for the pixels of figures.
venv/bin/taccel-lab sensors list >/dev/null
venv/bin/taccel-lab capture check captures --report page >/dev/null
test -s page/report.html
cd "$root"
"$lowest" -m pytest -q -p no:cacheprovider -W ignore -m "not slow and not thorough" \
    tests/cli tests/files tests/profile tests/report
echo "the lowest versions work on $("$python" --version)"
