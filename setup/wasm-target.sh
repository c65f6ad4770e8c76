#!/usr/bin/env bash
# Makes sure that rustc can compile for wasm32-unknown-unknown. Prints what to set as
# RUSTUP_TOOLCHAIN for that, or nothing where the active toolchain will do.
#
# Tried in turn: the target is there; rustup fetches it; a private toolchain is made from
# Debian's packages (rustc-web and the library source), for machines that reach package
# registries but not rustup's servers. No root; about 2 minutes and 450 MB.
# COIL_WASM_FALLBACK=1 goes straight to the last.
set -euo pipefail
. "$(dirname "$0")/common.sh"

TARGET=wasm32-unknown-unknown
TOOLCHAIN=$COIL_CACHE/coil-wasm # complete or absent
MACHINE=$(uname -m)
HOST=$MACHINE-unknown-linux-gnu
RUSTUP_SECONDS=${COIL_RUSTUP_SECONDS:-120}

# A failed `rustup target add` can leave the folder behind, empty.
has_target() {
  local folder
  folder=$(rustc --print target-libdir --target $TARGET 2>/dev/null) && compgen -G "$folder/libcore-*.rlib" >/dev/null
}

by_rustup() {
  have rustup || return 1
  say "rustup target add $TARGET (at most $RUSTUP_SECONDS s)"
  RUSTUP_MAX_RETRIES=1 timeout "$RUSTUP_SECONDS" rustup target add $TARGET >&2 && has_target
}

# apt with package lists, sources and downloads of its own: needs no root, changes nothing of the system's.
private_apt() {
  local command=$1 work=$PART/apt; shift
  mkdir -p "$work/lists/partial" "$work/archives/partial" "$work/sources"
  "$command" -o Dir::State::lists="$work/lists" -o Dir::Cache="$work" -o Dir::Cache::archives="$work/archives" \
    -o Dir::Etc::sourceparts="$work/sources" -o APT::Sandbox::User="$(id -un)" -o Debug::NoLocking=1 -qq "$@"
}

fetch_lists() {
  say "Debian: package lists (private copy$1)"
  private_apt apt-get update >&2 || say 'apt-get update reported errors; trying all the same'
}

compiler_version() { private_apt apt-cache show --no-all-versions rustc-web 2>/dev/null | sed -n 's/^Version: //p'; }

# Package lists that have a compiler new enough for us: Debian 12's security updates bring one; a
# system that doesn't list them, or is a later Debian, gets them added, in the private copy alone.
lists() {
  local needed version security='deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian-security bookworm-security main'
  needed=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' "$(dirname "$0")/../Cargo.toml")
  mkdir -p "$PART/apt/sources"
  find /etc/apt/sources.list.d -type f -exec cp -t "$PART/apt/sources" {} + 2>/dev/null || true
  fetch_lists ''
  version=$(compiler_version)
  if dpkg --compare-versions "${version:-0}" lt "$needed"; then
    echo "$security" >"$PART/apt/sources/coil-ps-security.list"
    fetch_lists ', with bookworm-security'
    version=$(compiler_version)
  fi
  dpkg --compare-versions "${version:-0}" ge "$needed" ||
    die "rustc-web is ${version:-not known} here and coil-ps needs $needed: reach rustup's servers (rustup target add $TARGET), or a mirror of Debian 12's security updates, as in: $security"
}

dependency() { # PACKAGE PATTERN: the first dependency of PACKAGE that matches
  private_apt apt-cache show --no-all-versions "$1" | sed -n 's/^Depends: //p' | tr ',|' '\n\n' |
    sed 's/^ *//; s/[ (].*//' | grep -m1 "^$2" || die "$1 has no dependency $2: Debian changed its packages"
}

# Debian's compiler in $PART/usr, with the system libraries that this machine lacks beside it.
unpack() {
  lists
  local std llvm lld deb
  std=$(dependency libstd-rust-web-dev libstd-rust-web-)
  llvm=$(dependency "$std" libllvm)
  lld=lld-${llvm#libllvm}
  say "Debian: download rustc-web, its library source, $llvm, $lld"
  private_apt apt-get install --download-only --reinstall -y --no-install-recommends \
    rustc-web libstd-rust-web-dev "$std" rust-web-src "$llvm" "$lld" patchelf >&2
  for deb in "$PART"/apt/archives/*.deb; do dpkg -x "$deb" "$PART"; done
  rm -rf "$PART/apt"
}

# Makes the unpacked programs and libraries find each other, and rustc the linker, where they lie now.
relocate() {
  local libraries=$PART/usr/lib/$MACHINE-linux-gnu bin=$PART/usr/lib/rustlib/$HOST/bin version
  run_path() { # PATH FILE…: RPATH, which unlike RUNPATH holds for the libraries of the libraries too
    LD_LIBRARY_PATH=$libraries "$PART/usr/bin/patchelf" --force-rpath --set-rpath "$@"
  }
  mkdir -p "$bin"
  cp "$PART"/usr/lib/llvm-*/bin/lld "$bin/rust-lld"
  find "$PART/lib" -name '*.so.*' -exec mv -t "$libraries" {} + 2>/dev/null || true # packages from before /usr was merged
  find "$libraries" -type f -name '*.so*' -print0 | while IFS= read -r -d '' file; do run_path '$ORIGIN' "$file"; done
  run_path '$ORIGIN/../lib/'"$MACHINE-linux-gnu" "$PART/usr/bin/rustc" "$PART/usr/bin/rustdoc"
  run_path '$ORIGIN/../../../'"$MACHINE-linux-gnu" "$bin/rust-lld"
  version=$("$PART/usr/bin/rustc" --version) || die 'the unpacked compiler does not run'
  "$bin/rust-lld" -flavor wasm --version >/dev/null || die 'the unpacked linker does not run'
  say "unpacked: $version"
}

# Compiles the standard library for the target, with bitcode (for LTO) like rustup's own.
build_std() {
  local crate=$PART/std lib=$PART/usr/lib/rustlib/$TARGET/lib vendor=$PART/usr/lib/rustlib/src/rust/library/vendor source=()
  # The crates that std is made of: those that Debian brings, else crates.io's, as std's lock file names them.
  [ ! -d "$vendor" ] || source=(--config 'source.crates-io.replace-with="debian"' --config "source.debian.directory=\"$vendor\"")
  say "build std for $TARGET"
  mkdir -p "$crate/src" "$lib"
  : >"$crate/src/lib.rs"
  printf '[package]\nname = "stdbuild"\nversion = "0.0.0"\nedition = "2021"\n[workspace]\n[profile.release]\ndebug = 0\n' >"$crate/Cargo.toml"
  (cd "$crate" && env -u CARGO_TARGET_DIR -u CARGO_ENCODED_RUSTFLAGS RUSTC_BOOTSTRAP=1 RUSTC="$PART/usr/bin/rustc" \
    RUSTFLAGS=-Cembed-bitcode=yes "$1" build -q --release --target-dir target --target $TARGET \
    ${source[@]+"${source[@]}"} \
    -Zbuild-std=std,panic_abort,panic_unwind,proc_macro,test >&2)
  cp "$crate/target/$TARGET"/release/deps/*.rlib "$lib/"
  rm -f "$lib"/libstdbuild-*.rlib
}

by_debian() {
  have apt-get && have dpkg && [ "$(uname -s)" = Linux ] || die "no $TARGET target: run 'rustup target add $TARGET'"
  "$(dirname "$0")/compiler.sh"
  lock coil-wasm
  [ ! -d "$TOOLCHAIN" ] || return 0 # another run made it meanwhile
  local cargo
  cargo=$(rustup which cargo 2>/dev/null || command -v cargo)
  PART=$TOOLCHAIN.part
  rm -rf "$PART"
  unpack
  relocate
  build_std "$cargo"
  ln -s "$cargo" "$PART/usr/bin/cargo"
  rm -rf "$PART/std" "$PART/usr/src" "$PART/usr/share" "$PART/usr/lib/rustlib/src" "$PART"/usr/lib/llvm-*
  mv "$PART/usr" "$TOOLCHAIN"
  rm -rf "$PART"
  say "toolchain ready: $TOOLCHAIN ($(du -sh "$TOOLCHAIN" | cut -f1))"
}

if [ -z "${COIL_WASM_FALLBACK:-}" ]; then
  if has_target; then exit 0; fi
  if [ ! -d "$TOOLCHAIN" ] && by_rustup; then exit 0; fi
fi
[ -d "$TOOLCHAIN" ] || by_debian
echo "$TOOLCHAIN"
