#!/bin/sh
# Runs tests/vcan on real SocketCAN: on this machine's vcan0 where it has one, else in a small virtual machine that
# has one, else not at all, and says so. The first argument is the Python of an environment that has the tests' needs; what
# follows is pytest's, in place of all of tests/vcan.
# OUT=FOLDER keeps junit.xml there; TIMEOUT_S ends the virtual machine, 600 unless set.
set -eu
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}
[ $# -eq 0 ] || shift
[ $# -gt 0 ] || set -- tests/vcan
vm=../shared/tools/run-in-vcan-vm
make_one='ip link add dev vcan0 type vcan && ip link set vcan0 up'

skip() {
	echo "tests/vcan SKIPPED: this kernel has no vcan0 ($make_one), and $1"
	exit 0
}

present=$("$python" -c 'from cutgate.config.bus import has_socketcan; print(has_socketcan())')
if [ "$present" = True ]; then
	# One process: all sessions are on the same bus. No cache: in the virtual machine it would be lost.
	exec "$python" -m pytest -p no:cacheprovider -n 0 ${OUT:+"--junit-xml=$OUT/junit.xml"} "$@"
fi
if [ "${VCAN_VM:-}" = 1 ]; then
	echo "tests/vcan: the virtual machine has no vcan0" >&2
	exit 1
fi
[ -x "$vm" ] || skip "$vm is not here"
if ! "$vm" --check >/dev/null 2>&1; then
	[ "$(id -u)" = 0 ] || skip "$vm must be installed first: sudo $vm --install"
	"$vm" --install || skip "$vm --install failed"
fi
# What the virtual machine's tools are is what this machine's are: installed for it, but no test depends on them alone.
if ! command -v candump >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
	apt-get -qq install -y --no-install-recommends can-utils </dev/null >/dev/null 2>&1 || true
fi
if [ -n "${OUT:-}" ]; then
	mkdir -p "$OUT"
	OUT=$(cd "$OUT" && pwd)
	export OUT
fi
echo "tests/vcan in a virtual machine: this kernel has no vcan0"
exec "$vm" --venv none --timeout "${TIMEOUT_S:-600}" ${OUT:+--out "$OUT"} -- tools/vcan.sh "$python" "$@"
