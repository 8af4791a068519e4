#!/bin/sh
# Run the tests marked vcan in a User-Mode Linux kernel: a kernel with AF_CAN and vcan as
# an ordinary process, whatever the host's kernel has. Needs the Debian packages
# user-mode-linux, kmod, iproute2 and can-utils, and root (the links are made inside).
#
#   tests/uml/run.sh [pytest arguments]      default: every file of tests that names vcan
#
# Environment: PYTHON (default: .venv/bin/python), UML_TIMEOUT_S (default: 900).
# Exit code: pytest's; 3 when something is missing; 4 when the kernel did not boot or
# died; 5 when no test ran.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
python=${PYTHON:-$root/.venv/bin/python}

lacks() {
  echo "tests/uml/run.sh: $1" >&2
  exit 3
}
kernel=$(command -v linux.uml) || lacks "no linux.uml; apt-get install user-mode-linux kmod iproute2"
for tool in timeout ip insmod candump; do
  command -v "$tool" >/dev/null || lacks "no $tool; apt-get install coreutils kmod iproute2 can-utils"
done
command -v "$python" >/dev/null || lacks "no Python at $python; make dev, or set PYTHON"
python=$(command -v "$python")
[ "$(id -u)" = 0 ] || lacks "must be root, so that the host's files are root's inside as well"

# Everything the inside needs to know, and what it tells us, in one fresh directory.
# Its name, and that of init.sh in it, stand on the kernel's command line: no space in them.
job=$(mktemp -d /var/tmp/dftc-uml.XXXXXX)
machine=
end() {
  [ -z "$machine" ] || kill -KILL "$machine" 2>/dev/null || :
  rm -rf "$job"
}
trap end EXIT
trap 'exit 130' INT TERM
# Reading all other files as well, to leave them out, takes minutes in there.
if [ $# -eq 0 ]; then
  # shellcheck disable=SC2046  # no name of a test file has a space in it
  set -- $(cd "$root" && grep -rlw --include='test_*.py' vcan tests)
fi
# The console inside always is a terminal; whether ours is one decides about colour.
colour=no
[ ! -t 1 ] || colour=yes
printf '%s\0' -p no:cacheprovider "--color=$colour" "$@" >"$job/arguments"
cp "$here/init.sh" "$job/init.sh"
printf '%s\n' "$root" >"$job/root"
printf '%s\n' "$python" >"$job/python"

# The kernel puts its memory into a file in TMPDIR. Its console is our stdin and stdout.
echo "Booting $(basename "$kernel") for: pytest -m vcan $*" >&2
status=0
set -- timeout --foreground --signal=KILL "${UML_TIMEOUT_S:-900}" \
  "$kernel" mem=1G root=/dev/root rootfstype=hostfs rootflags=/ rw \
  init="$job/init.sh" dftc_job="$job" umid="dftc-$$" uml_dir="$job/" \
  con=null con0=null,fd:1 quiet
# Killed half-way, the kernel would leave behind the processes that it runs programs in;
# a PID namespace, where we may have one, takes them along.
namespace="unshare --pid --fork --kill-child=KILL sh -c"
if $namespace : 2>/dev/null; then
  # shellcheck disable=SC2086,SC2016  # words of the command; expanded by the inner shell
  set -- $namespace '"$@"; exit $?' sh "$@"
fi
TMPDIR="$job" "$@" </dev/null &
machine=$!
wait "$machine" || status=$?
machine=

if [ ! -s "$job/exit_code" ]; then
  echo "tests/uml/run.sh: the kernel ended (status $status) before the tests did" >&2
  exit 4
fi
exit "$(cat "$job/exit_code")"
