#!/bin/sh
# healthy FILE: whether the service that keeps FILE gave a sign of life within the last 5 s, and is healthy.
# Nothing but the shell itself runs: one look costs a millisecond of a core.
if ! read -r state second detail <"$1"; then
  echo "$1: no sign of life yet"
  exit 1
fi
read -r up _ </proc/uptime
age=$((${up%%.*} - second))
echo "$state: $detail (${age} s ago)"
[ "$state" = healthy ] && [ "$age" -le 5 ]
