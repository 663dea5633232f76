#!/usr/bin/env bash
# A newcomer's first minutes, from nothing: an environment, the installation, the first road.
#   bash scripts/first_minutes.sh [PYTHON]        with pip, and no cache of it
#   bash scripts/first_minutes.sh --uv [PYTHON]   the same with uv, which has to be on the path
# Prints a transcript: each command, the end of what it says, its seconds, and sizes on disk.
set -euo pipefail
installer=pip
if [ "${1:-}" = --uv ]; then
  installer=uv
  shift
fi
python=$(command -v "${1:-python3}")
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh" # in the repository's root from here on
source scripts/steps.sh
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
export PIP_CACHE_DIR=$place/cache UV_CACHE_DIR=$place/cache VIRTUAL_ENV=$place/env
export PIP_DISABLE_PIP_VERSION_CHECK=1
began=$(date +%s.%N)

size_of() {
  du -sk "$1" | awk '{ printf "%.2f GB", $1 * 1024 / 1e9 }'
}

in_gigabytes() { # of pip's lines that end in (526.6 MB), what they say together
  awk -F'[()]' '{ split($(NF - 1), s, " "); u["B"] = 1; u["kB"] = 1e3; u["MB"] = 1e6; u["GB"] = 1e9
    sum += s[1] * u[s[2]] } END { printf "%.2f GB", sum / 1e9 }'
}

git clone --quiet . "$place/roadtorch"
cd "$place/roadtorch"
echo "# $("$python" --version), $installer, $(uname -sm), $(nproc 2>/dev/null || echo '?') processors"
PYTHON=$python choose_index
if [ "$installer" = uv ]; then
  step 1 uv venv --quiet --python "$python" "$place/env"
  step 0 uv pip install --quiet ${INDEX[@]+--torch-backend cpu} -c constraints.txt .
  fetched="$(size_of "$place/cache") unpacked"
else
  step 1 "$python" -m venv "$place/env"
  step 0 "$place/env/bin/pip" install --progress-bar off ${INDEX[@]+"${INDEX[@]}"} \
    -c constraints.txt .
  fetched=$(grep -oE 'Downloading .*\([0-9.]+ [kMG]?B\)' "$place/said" | in_gigabytes)
fi
echo "# env: $(size_of "$place/env"); fetched: $fetched"
echo "# torch $("$place/env/bin/python" -c 'from importlib.metadata import version as v; print(v("torch"))')"
cd "$place"
PATH=$place/env/bin:$PATH
step 1 roadtorch --version
step 60 roadtorch doctor
step 1 python -m roadtorch.testing.scenes --out scenes --count 6
step 3 roadtorch infer scenes --out roads
step 1 roadtorch infer scenes --out roads-cpf --config thresholds/cpf
step 1 roadtorch train --config adapt --set start=layout-free --set stopping.epochs=1 \
  --images scenes --out run --quiet
step 2 roadtorch infer scenes --out roads-mine --set weights.file=run/weights.safetensors
echo "# all: $(seconds_since "$began") s"
