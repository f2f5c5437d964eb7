#!/bin/sh
# until-all-ended COMMAND...: the first process of a container. Starts COMMAND, hands SIGTERM on to it, and ends, with
# its status, once no process is left. The kernel kills whatever the first process of a container leaves behind; and what
# a Robot Server that dies leaves behind brakes its robot.
"$@" &
child=$!
trap 'kill -TERM "$child" 2>/dev/null' TERM INT
while :; do
  wait "$child"
  status=$?
  kill -0 "$child" 2>/dev/null || break # otherwise the signal ended the waiting, and not the child
done
while set -- /proc/[0-9]* && [ $# -gt 1 ]; do
  sleep 0.05
done
exit "$status"
