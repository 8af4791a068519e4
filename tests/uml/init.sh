#!/bin/sh
# The first process of the User-Mode Linux kernel that run.sh boots. It ends by powering
# the machine off, so before anything else it makes sure which machine that is.
# Inside, /proc is at first the host's, seen through the file system: mount our own.
[ "$$" != 1 ] || mount -t proc proc /proc
if [ "$$" != 1 ] || ! grep -q "User Mode Linux" /proc/cpuinfo; then
  echo "init.sh: not inside User-Mode Linux; start it with tests/uml/run.sh" >&2
  exit 1
fi

export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export HOME=/tmp

finish() {
  [ -z "$job" ] || [ ! -d "$job" ] || echo "$1" >"$job/exit_code"
  sync
  echo o >/proc/sysrq-trigger
  while :; do sleep 1; done # power-off is on its way; init must not return
}
fail() {
  echo "init.sh: $1"
  finish 4
}

job=$(sed -n 's/.*dftc_job=\([^ ]*\).*/\1/p' /proc/cmdline)
[ -d "$job" ] || fail "no job directory"
root=$(cat "$job/root")
python=$(cat "$job/python")

mount -t sysfs sysfs /sys || fail "no /sys"
mount -t devtmpfs dev /dev 2>/dev/null # not in every kernel; the host's nodes do as well
mkdir -p /dev/shm && mount -t tmpfs shm /dev/shm
mount -t tmpfs run /run || fail "no /run"
case $root$job$python in
  /tmp*|*/tmp/*) ;; # the tree lies below /tmp: leave that as it is
  *) mount -t tmpfs tmp /tmp || fail "no /tmp" ;;
esac
ip link set lo up

modules=$(echo /usr/lib/uml/modules/*/kernel)
for module in net/can/can net/can/can-raw net/can/can-bcm drivers/net/can/dev/can-dev \
  drivers/net/can/vcan drivers/net/can/vxcan; do
  insmod "$modules/$module.ko" || fail "cannot load $modules/$module.ko"
done
for link in vcan0 vcan1 vcan2; do
  ip link add "$link" type vcan && ip link set "$link" mtu 72 up || fail "cannot make $link"
done

cd "$root" || fail "no $root"
"$python" -c '
import os, sys
arguments = open(sys.argv[1], "rb").read().split(b"\0")[:-1]
os.execv(sys.executable, [sys.executable, "-m", "pytest", "-m", "vcan", *arguments])
' "$job/arguments"
finish $?
