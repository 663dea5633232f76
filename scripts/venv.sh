# shellcheck shell=bash
# Sourced by demo.sh, test.sh and site.sh: goes to the repository's root and makes $VENV ready, which
# is .venv unless they say otherwise.
# After `prepare_venv [EXTRA]`, $PYTHON is an interpreter with roadtorch and that extra.

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
VENV=${VENV:-.venv}
PYTHON=$VENV/bin/python
STAMP=$VENV/roadtorch-installed # holds the extras and the checksum of what was asked for
CPU_INDEX=${ROADTORCH_CPU_INDEX:-https://download.pytorch.org/whl/cpu} # or a mirror of it
CPU_INDEX_SECONDS=3

find_python() {
  local candidate
  for candidate in python3 python3.14 python3.13 python3.12 python3.11 python; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      echo "$candidate"
      return
    fi
  done
  echo "roadtorch: error: python3: 3.11 or newer is not there (install it)" >&2
  return 1
}

checksum() {
  cat pyproject.toml constraints.txt requirements/*.txt | cksum
}

# Succeeds when the index of CPU wheels has torch and answers within CPU_INDEX_SECONDS. `timeout`,
# because no time limit of Python's own covers the look-up of a name.
cpu_index_answers() {
  timeout "$CPU_INDEX_SECONDS" "$PYTHON" -c "import sys, urllib.request as u; u.urlopen(sys.argv[1])" \
    "$CPU_INDEX/torch/" 2>/dev/null
}

# Sets INDEX, pip's options that say where torch comes from. pip takes the CPU wheels of that
# index (2.13.0+cpu) before those of the package index (2.13.0), the version being higher.
choose_index() {
  INDEX=()
  if [ "$(uname -s)" != Linux ]; then
    return # the package index has CPU wheels there
  fi
  if cpu_index_answers; then
    INDEX=(--extra-index-url "$CPU_INDEX")
    echo "torch: CPU wheels from $CPU_INDEX (0.2 GB)" >&2
  else
    echo "torch: $CPU_INDEX does not answer within $CPU_INDEX_SECONDS seconds. Unless pip has a" \
      "CPU wheel on disk, torch comes with CUDA: 2.8 GB to fetch, 5 GB on disk" >&2
  fi
}

# Installs what is in . as it was tested: install_tested PYTHON base|test PIPS-OPTIONS…
# The package index may serve the files whose hashes are in requirements/ and no others. torch and
# torchvision come by their version alone: the hashes of the index of CPU wheels are not ours to know.
install_tested() {
  local pip=("$1" -m pip install --quiet --disable-pip-version-check --no-compile) kind=$2
  shift 2
  "${pip[@]}" --no-deps ${INDEX[@]+"${INDEX[@]}"} -c constraints.txt torch torchvision
  "${pip[@]}" --no-deps --require-hashes -r "requirements/$kind.txt"
  "${pip[@]}" --no-deps --no-build-isolation "$@"
}

# Installs only when something changed since the last time; Python compiles what is used, not pip
# all there is, which takes a minute. Extras that are already
# there are kept, so that demo.sh and test.sh do not undo each other's work.
prepare_venv() {
  local extras=${1:-} had="" asked="" python wanted INDEX
  if [ -f "$STAMP" ]; then
    { read -r had && read -r asked; } <"$STAMP"
  fi
  if [ -z "$extras" ]; then
    extras=$had
  elif [ "$extras" != "$had" ]; then
    asked="" # only one kind of extras is ever asked for
  fi
  if [ "$asked" = "$(checksum)" ] && "$PYTHON" -c '' 2>/dev/null; then
    return
  fi
  if ! "$PYTHON" -m pip --version >/dev/null 2>&1; then
    python=$(find_python)
    echo "making $VENV with $("$python" --version)" >&2
    "$python" -m venv "$VENV"
  fi
  wanted=".${extras:+[$extras]}"
  echo "installing roadtorch${wanted#.} into $VENV (some minutes the first time)" >&2
  choose_index
  case "$extras" in
    "" | test) install_tested "$PYTHON" "${extras:-base}" -e . ;;
    *) "$PYTHON" -m pip install --quiet --disable-pip-version-check --no-compile \
      ${INDEX[@]+"${INDEX[@]}"} -c constraints.txt -e "$wanted" ;;
  esac
  printf '%s\n%s\n' "$extras" "$(checksum)" >"$STAMP"
}
