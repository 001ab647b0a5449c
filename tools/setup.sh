#!/usr/bin/env bash
# Everything that `make demo` and `make test` need: system libraries, .venv, packages. Does nothing when it is all there.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# The stamp is named after what was installed, so another pyproject.toml sets up anew.
stamp=".venv/.set-up-$(cat pyproject.toml tools/setup.sh | sha256sum | cut -c1-16)"
if [[ -e $stamp ]] && .venv/bin/python -c "" 2>/dev/null; then
    exit 0
fi
started=$SECONDS
say() { echo "set-up: $*"; }

install_system_packages() { # PURPOSE PACKAGE...: with apt-get where that is possible, else one line that says what to do
    local purpose=$1
    shift
    if [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
        say "installing $* ($purpose)"
        apt-get update -qq || say "apt-get update failed; trying with the package lists that are here"
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null && return
    fi
    say "$purpose: please install $* (Debian, Ubuntu: sudo apt-get install $*)"
    return 1
}

find_python() { # prints the first Python that is new enough; 3.11 first, because the packages are tested with it
    local name
    for name in python3.11 python3.12 python3.13 python3 python; do
        if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$name"
            return
        fi
    done
    return 1
}

# ---------------------------------------------------------------- virtual environment

if ! .venv/bin/python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    python=$(find_python) || { say "no Python 3.11 or newer was found; please install one (python3.11)"; exit 1; }
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    "$python" -c 'import ensurepip, venv' 2>/dev/null || install_system_packages "Python's venv" "python$version-venv"
    say "making .venv with Python $version"
    "$python" -m venv --clear .venv
fi

# ---------------------------------------------------------------- system libraries that open3d loads

missing=$(.venv/bin/python - <<'PYTHON'
import ctypes, sys

NEEDED = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
}
for library, package in NEEDED.items() if sys.platform == "linux" else ():
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
PYTHON
)
if [[ -n $missing ]]; then
    # Rectifying does without open3d; making data and its tests do not.
    # shellcheck disable=SC2086
    install_system_packages "libraries that open3d loads" $missing || say "going on without them"
fi

# ---------------------------------------------------------------- packages

say "installing packages (some minutes the first time)"
pip=(.venv/bin/python -m pip --disable-pip-version-check install --quiet)
# PyTorch first and alone: its CPU build, where pip is told of one, satisfies what the project asks for after it.
"${pip[@]}" torch==2.13.0
"${pip[@]}" --editable '.[data,dev]'
rm -f .venv/.set-up-*
touch "$stamp"
say "done in $((SECONDS - started)) s"
