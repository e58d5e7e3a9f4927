#!/usr/bin/env bash
# The CAD kernel and the 3D pictures load the system's OpenGL and X libraries. Installs them where
# that is possible (root on Debian or Ubuntu), otherwise says what to install.
# With --browser: Chromium, in which the tests of live pages run; without it they are skipped.
set -euo pipefail

# macOS has its OpenGL, and the wheels bring the rest.
[ "$(uname)" = Linux ] || exit 0

if [ "${1:-}" = "--browser" ]; then
    if command -v chromium >/dev/null || command -v google-chrome >/dev/null; then
        exit 0
    fi
    if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null &&
        apt-get update -qq &&
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium \
            >/dev/null; then
        exit 0
    fi
    echo "No Chromium: tests of live pages will be skipped; on Debian: sudo apt install chromium"
    exit 0
fi

missing=()
while read -r library package; do
    if ! ldconfig -p | grep -q "$library"; then
        missing+=("$package")
    fi
done <<'LIST'
libGL.so.1 libgl1
libEGL.so.1 libegl1
libX11.so.6 libx11-6
libexpat.so.1 libexpat1
LIST

if [ ${#missing[@]} -eq 0 ]; then
    exit 0
fi
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    echo "Installing system libraries: ${missing[*]}"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
else
    echo "System libraries are missing; on Debian or Ubuntu: sudo apt install ${missing[*]}" >&2
    exit 1
fi
