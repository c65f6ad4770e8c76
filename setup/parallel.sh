#!/usr/bin/env bash
# Makes sure that GNU parallel is there, which a test of `coil render --shard` runs.
set -euo pipefail
. "$(dirname "$0")/common.sh"

have parallel && exit
lock apt
apt_install parallel
