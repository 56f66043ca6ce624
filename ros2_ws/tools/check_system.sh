#!/usr/bin/env bash
# Says what is missing on this machine to set the suite up, in words that can be acted on. Usage: check_system.sh [PYTHON]
set -uo pipefail
python=${1:-python3}
missing=0

complain() {
  echo "MISSING: $1" >&2
  missing=1
}

repo=$(cd "${BASH_SOURCE[0]%/*}/../.." && pwd -P)
[[ $repo != *[[:space:]]* ]] ||
  complain "a path without blanks: the nodes' start scripts name their interpreter in the first line, and Linux
         takes no blanks there. Move this folder: '$repo'"
if ! command -v "$python" >/dev/null; then
  complain "Python 3.11 or 3.12 ('$python' not found). Ubuntu 24.04: sudo apt install python3 python3-venv python3-dev.
         Debian 12 has 3.11 under the same names. Another interpreter: make setup PYTHON=/path/to/python3.11"
else
  version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  case $version in
    3.11) ;;
    3.12) echo "note: Python 3.12: pybullet has no ready-made package for it and is compiled now, which takes some minutes" >&2 ;;
    *) complain "Python 3.11 or 3.12: '$python' is $version, and ROS 2 Jazzy exists for 3.11 and 3.12 only.
         Name another interpreter: make setup PYTHON=python3.11" ;;
  esac
  "$python" -c 'import venv, ensurepip' 2>/dev/null ||
    complain "Python's venv module. sudo apt install python3-venv"
  include=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
  [[ -f $include/Python.h ]] ||
    complain "Python's C headers (no $include/Python.h), needed to compile the message packages. sudo apt install python3-dev"
fi
command -v "${CXX:-c++}" >/dev/null ||
  complain "a C++ compiler (compiles the message packages). sudo apt install g++"
command -v make >/dev/null ||
  complain "make. sudo apt install make"
if ! command -v cmake >/dev/null; then
  complain "cmake 3.19 or newer. sudo apt install cmake"
else
  cmake_version=$(cmake --version | sed -n 's/^cmake version //p')
  if [[ $(printf '3.19\n%s\n' "$cmake_version" | sort -V | head -n 1) != 3.19 ]]; then
    complain "cmake 3.19 or newer (found $cmake_version). sudo apt install cmake, or: pip install cmake"
  fi
fi
# libusb is only needed for a real D455; the Python package libusb-package brings one along.
if [[ $missing -ne 0 ]]; then
  echo "All at once on Debian 12 or Ubuntu 24.04: sudo apt install python3 python3-venv python3-dev g++ cmake make" >&2
fi
exit "$missing"
