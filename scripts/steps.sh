# shellcheck shell=bash
# Sourced by first_minutes.sh and first_day.sh: commands as a transcript, each with its seconds.
# Wants $place, a folder of their own whose name is left out of what is shown.

seconds_since() {
  awk -v a="$1" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }'
}

step() { # LINES COMMAND…: runs it, shows so many lines of the end of what it says
  local lines=$1 start status=0
  shift
  start=$(date +%s.%N)
  echo "\$ $*" | sed -e "s#$place/##g" -e "s#${python:-python3}#python#g"
  "$@" >"$place/said" 2>&1 || status=$?
  tail -n "$lines" "$place/said" | sed "s#$place/##g"
  echo "# $(seconds_since "$start") s, exit code $status"
  return "$status"
}
