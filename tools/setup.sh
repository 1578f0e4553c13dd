#!/usr/bin/env bash
# Install the project into .venv: first the system packages (as root on Debian or Ubuntu; elsewhere it names them), then
# the packages of requirements.lock.
set -euo pipefail
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}

if [ -L .venv ]; then  # before anything else: python -m venv --clear would empty the folder that the link names
  echo "error: $PWD/.venv is a link to $(readlink .venv); setup installs into a folder of this project only:" \
    "remove the link (rm .venv) and run make again" >&2
  exit 1
fi

missing=()
# Read once: a pipe into grep -q would fail now and then, because grep leaves before ldconfig ends.
libraries=$(ldconfig -p 2>/dev/null || /sbin/ldconfig -p 2>/dev/null || find /lib /usr/lib /usr/local/lib -name '*.so*' 2>/dev/null || true)
has_library() { grep -qF "$1" <<<"$libraries"; }
if [ "$(uname -s)" = Linux ]; then
  command -v git >/dev/null || missing+=(git)
  command -v make >/dev/null || missing+=(make)
  if ! command -v "$PYTHON" >/dev/null; then
    missing+=("$PYTHON" "$PYTHON-venv")
  elif ! "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null; then
    missing+=("$(basename "$PYTHON")-venv")
  fi
  # numba and torch need OpenMP; open3d links to the others, with a screen or without
  for pair in libgomp.so.1:libgomp1 libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1 \
              libX11.so.6:libx11-6 libudev.so.1:libudev1 libidn2.so.0:libidn2-0; do
    has_library "${pair%%:*}" || missing+=("${pair##*:}")
  done
fi

echo "pointnetkl: setting up in $PWD/.venv"
echo "  disk: about 3 GB for packages (more where PyTorch brings CUDA), 0.5 GB for the demo's data"
echo "  disk free here: $(df -h . | awk 'NR==2 {print $4}')"
echo "  system packages missing: ${missing[*]:-none}"

if [ ${#missing[@]} -gt 0 ]; then
  if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
  else
    echo "error: these system packages are missing: ${missing[*]}; on Debian or Ubuntu:" \
      "sudo apt-get install ${missing[*]}; elsewhere install what holds the same; then run make again" >&2
    exit 1
  fi
fi

"$PYTHON" - <<'PY' || exit 1
import sys
if not (3, 11) <= sys.version_info[:2] < (3, 15):
    sys.exit(f"error: Python {sys.version.split()[0]} cannot run this project: 3.11 to 3.14 can; "
             "name one, as in: make setup PYTHON=python3.12")
PY

"$PYTHON" -m venv --clear .venv
.venv/bin/python -m pip install --quiet --disable-pip-version-check --upgrade "pip>=24"
if [ -n "${TORCH_INDEX:-}" ]; then
  .venv/bin/python -m pip install --disable-pip-version-check --progress-bar on \
    --index-url "$TORCH_INDEX" "$(grep '^torch==' requirements.lock)"
fi
echo "  installing the packages of requirements.lock (a few minutes)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
.venv/bin/python -c 'import open3d, gtsam, torch' || {
  echo "error: a package does not load, see above: most often a system library is missing" >&2
  exit 1
}
echo "  compiling the registration's kernels (half a minute)"
.venv/bin/python tools/compile_kernels.py || echo "  not compiled (see above): the first run compiles them"
touch .venv/complete
echo "  done: make repro, make test; or: source .venv/bin/activate && dvc repro"
