#!/bin/sh
# until-all-ended COMMAND...: the first process of a container. Starts COMMAND, hands SIGTERM on to it, and ends, with
# its status, once no process is left. The kernel kills whatever the first process of a container leaves behind; and what
# a Robot Server that dies leaves behind brakes its robot.
"$@" &
child=$!
signalled=
trap 'signalled=yes; kill -TERM "$child" 2>/dev/null' TERM INT
wait "$child"
status=$?
while [ "$signalled" ]; do
  # a signal ends the waiting, not the child; and whether the child is still there says nothing about its status
  signalled=
  wait "$child"
  again=$?
  [ "$again" -eq 127 ] || status=$again # 127: there was nothing left to wait for
done
while set -- /proc/[0-9]* && [ $# -gt 1 ]; do
  sleep 0.05
done
exit "$status"
