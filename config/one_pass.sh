#!/usr/bin/env bash
# Starts the nodes of a cell, makes one pass, records it, and stops everything.
# usage: one_pass.sh [CELL.yaml] [DIRECTORY of the recording]
set -eu
cell=${1:-$(dirname "$0")/paper.yaml}
out=${2:-one_pass}
log=$(mktemp)
recorded=$(mktemp)
nodes=()
trap 'kill -TERM "${nodes[@]}" 2>/dev/null || true; wait; cat "$recorded" >&2; rm -f "$log" "$recorded"' EXIT

recorder --ros-args -p directory:="$out" -p attach:="$cell" 2>"$recorded" &
nodes+=($!)
until grep -q "recording to" "$recorded"; do # before there is anything that it could miss
  kill -0 "${nodes[@]}" || { echo "the recorder ended" >&2; exit 1; }
  sleep 0.1
done
trajectory_compensator --ros-args -p cell_file:="$cell" 2>"$log" &
nodes+=($!)
milling_cell --ros-args -p cell_file:="$cell" -p autostart:=true &
nodes+=($!)

# the compensator revises the reference when a pass is complete
for _ in $(seq 600); do
  if grep -q "revised after pass 1" "$log"; then
    sleep 1 # the recorder takes what is still under way
    exit 0
  fi
  kill -0 "${nodes[@]}" || { echo "a node ended before the pass was complete" >&2; exit 1; }
  sleep 0.2
done
echo "no pass within two minutes" >&2
exit 1
