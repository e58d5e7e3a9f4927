#!/usr/bin/env bash
# Builds the sdist, from it the wheel, installs that in a clean environment and uses it from an empty
# folder beside modules of a user's own that are named like our packages.
#   tools/try_wheel.sh PYTHON BUILD_PYTHON [COMMAND...]
# PYTHON: the interpreter to try; BUILD_PYTHON: one that has hatchling and pip.
# COMMAND: what to run at the end instead of a small demonstration (`true`: nothing).
# PIP_FLAGS are passed to pip. Needs 2 GB in $TMPDIR; leaves the archives in dist/.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD python=$1 build=$(command -v "$2" || realpath "$2")
shift 2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

rm -rf dist && mkdir dist
"$build" -m hatchling build -t sdist -d dist >/dev/null
"$build" -m pip wheel -q --no-deps --no-build-isolation -w dist dist/*.tar.gz
wheel=$(echo dist/*.whl)
echo "built $(basename dist/*.tar.gz) and $(basename "$wheel"), $(du -k "$wheel" | cut -f1) KiB"

"$python" -m venv "$work/venv"
tools/cpu_torch.sh "$work/venv/bin/python"
tools/install.sh "$work/venv/bin/python" -c constraints.txt "$root/$wheel[demo]"
# The wheel itself by pip, as users have it, and all that it asks for is there.
"$work/venv/bin/python" -m pip install -q --disable-pip-version-check --force-reinstall --no-deps "$wheel"
"$work/venv/bin/python" -m pip check
echo "installed on $("$python" --version)"

mkdir -p "$work/mine/cad" && cd "$work/mine"
echo 'raise SystemExit("the module of a user was imported")' |
    tee sensors.py calibration.py studies.py cad/__init__.py >/dev/null
taccel() { "$work/venv/bin/taccel-lab" "$@"; }
taccel --version
taccel doctor
taccel sensors list >/dev/null
taccel press gelsight_mini --indenter sphere:4 --depth-mm 0.3 --out press --quiet
test -s press/press.json
if [ $# -gt 0 ]; then
    PATH="$work/venv/bin:$PATH" "$@"
else
    # Of all captures `make demo` makes one, in the image.
    "$work/venv/bin/python" "$root/tools/fewer_captures.py"
    taccel demo --out demo --quiet
    test -s demo/report/report.html
fi
echo "the wheel works on $("$python" --version)"
