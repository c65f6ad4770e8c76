#!/usr/bin/env bash
# cargo-tool.sh CRATE VERSION [CARGO OPTION…]: a command-line tool in $COIL_CACHE/tools/bin, built once.
set -euo pipefail
. "$(dirname "$0")/common.sh"

crate=$1 version=$2
shift 2
lock "$crate"
installed=$COIL_CACHE/tools/.coil-$crate
[ "$(cat "$installed" 2>/dev/null)" != "$version" ] || exit 0

install() {
  # unoptimised: these tools run for seconds, and optimising them takes minutes
  env -u CARGO_TARGET_DIR -u RUSTUP_TOOLCHAIN -u RUSTFLAGS CARGO_PROFILE_RELEASE_OPT_LEVEL=0 CARGO_PROFILE_RELEASE_LTO=off \
    cargo install "$crate" --version "$version" --root "$COIL_CACHE/tools" --quiet --force "$@" >&2
}
say "cargo install $crate $version"
# the tool's own lock may name a crate version that the registry lacks
install --locked "$@" || install "$@"
echo "$version" >"$installed"
