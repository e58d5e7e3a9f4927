#!/usr/bin/env bash
# Installs what `pip install` would, by uv, which pip brings: it takes seconds where pip takes minutes.
#   tools/install.sh PYTHON ARGUMENT...
# ARGUMENT: of pip. Where uv cannot (an index that asks for more than pip's settings say), pip does.
# PIP_FLAGS are passed to both; uv's cache, which environments share by links, is UV_CACHE_DIR.
set -euo pipefail
python=$1
shift
pip() { "$python" -m pip "$@"; }
if ! uv=$(command -v uv); then
    uv=$(dirname "$python")/uv
    [ -x "$uv" ] || pip install -q --disable-pip-version-check ${PIP_FLAGS:-} -c constraints.txt uv
fi
# uv reads none of pip's settings.
index=${PIP_INDEX_URL:-$(pip config get global.index-url 2>/dev/null || true)}
export UV_DEFAULT_INDEX=${UV_DEFAULT_INDEX:-${index:-https://pypi.org/simple}}
if ! "$uv" pip install -q --python "$python" ${PIP_FLAGS:-} "$@"; then
    echo "uv could not: pip installs, which takes minutes" >&2
    pip install -q --disable-pip-version-check --no-compile ${PIP_FLAGS:-} "$@"
fi
