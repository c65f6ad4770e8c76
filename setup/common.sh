# Shared by the set-up scripts, which source it. Everything that set-up downloads or builds
# lies in $COIL_CACHE; scripts report on stderr, so that stdout can carry a result.
COIL_CACHE=${COIL_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/coil-ps}
mkdir -p "$COIL_CACHE"

say() { printf '%s  %s\n' "$(date +%T)" "$*" >&2; }
die() { say "error: $*"; exit 1; }
have() { command -v "$1" >/dev/null 2>&1; }

# Holds the lock NAME until the script ends, so that two runs never build the same thing.
lock() {
  have flock || return 0
  exec 9>"$COIL_CACHE/$1.lock"
  flock -n 9 || { say "waiting for another run to finish: $1"; flock 9; }
}

# Runs a command as root if this user may without typing a password.
can_root() { [ "$(id -u)" = 0 ] || { have sudo && sudo -n true 2>/dev/null; }; }
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }

# Installs Debian packages system-wide. Where that isn't allowed, says what to type.
apt_install() {
  have apt-get || die "please install: $* (this set-up knows only apt)"
  can_root || die "please run as root: apt-get install $*"
  say "apt-get install $*"
  as_root apt-get -qq update >&2 || say 'apt-get update reported errors; trying all the same'
  local log=$COIL_CACHE/apt.log
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >"$log" 2>&1 9>&- ||
    die "apt-get install failed: $(tail -n 20 "$log")"
}
