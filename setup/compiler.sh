#!/usr/bin/env bash
# Makes sure that there is a C compiler: Rust links with it, and tract assembles kernels with it.
set -euo pipefail
. "$(dirname "$0")/common.sh"
have cc || apt_install gcc libc6-dev
