#!/usr/bin/env bash
# Makes sure that there is a Chromium for the page's tests. Prints the path of its program.
# CHROMIUM names another one.
set -euo pipefail
. "$(dirname "$0")/common.sh"

find_browser() {
  local name
  for name in ${CHROMIUM:+"$CHROMIUM"} chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$name" && return
  done
  return 1
}

find_browser && exit
lock apt
apt_install chromium chromium-driver
find_browser || die 'chromium was installed but is not on PATH'
