#!/usr/bin/env bash
# Builds the image of the Dockerfile and uses it as a user would: a press from an empty folder, whose
# files belong to whoever asked. Where no Docker daemon answers, it says so and ends well.
set -euo pipefail
cd "$(dirname "$0")/.."
if ! docker info >/dev/null 2>&1; then
    echo "no Docker daemon answers: the image is not built"
    exit 0
fi
docker build -t taccel-lab .
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
docker run --rm --user "$(id -u):$(id -g)" -v "$work:/work" taccel-lab \
    press gelsight_mini --indenter sphere:4 --depth-mm 0.3 --out press --quiet
test -s "$work/press/press.json"
test -O "$work/press/press.json"
echo "the image works"
