#!/usr/bin/env bash
# Finds the road in the given images, or in rendered scenes when none are given.
set -euo pipefail
start=$PWD
case ${1-} in
"" | -* | *://* | *[*?@:]*) ;; # no input, an option, an address, a glob, a list or a camera
*)
  if [ ! -e "$1" ]; then # before minutes of installation
    echo "demo.sh: $1: does not exist" >&2
    exit 2
  fi
  ;;
esac
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv

out=$PWD/out/demo
if [ $# -eq 0 ]; then
  out=$PWD/out/demo-scenes
  "$PYTHON" -m roadtorch.testing.scenes --out out/scenes --count 6
  set -- "$PWD/out/scenes"
fi

python=$PWD/$PYTHON
cd "$start" # the images' names are meant from where the user is
status=0
# Overwriting: a demonstration shows what this version does, not what an older one did.
"$python" -m roadtorch infer "$@" --out "$out" --overwrite || status=$?
if [ -f "$out/index.csv" ]; then
  echo "results: $out (NAME.overlay.jpg to look at, NAME.likelihood.png, NAME.mask.png, index.csv)"
fi
exit "$status"
