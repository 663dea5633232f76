# Sourced by demo.sh and test.sh: goes to the repository's root and makes .venv ready.
# After `prepare_venv [EXTRA]`, $PYTHON is an interpreter with roadtorch and that extra.

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
PYTHON=.venv/bin/python
STAMP=.venv/roadtorch-installed # holds the extras and the checksum of what was asked for

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
  cat pyproject.toml constraints.txt | cksum
}

# Installs only when something changed since the last time. Extras that are already
# there are kept, so that demo.sh and test.sh do not undo each other's work.
prepare_venv() {
  local extras=${1:-} had="" asked="" python wanted
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
    echo "making .venv with $("$python" --version)" >&2
    "$python" -m venv .venv
  fi
  wanted=".${extras:+[$extras]}"
  echo "installing roadtorch${wanted#.} into .venv (some minutes the first time)" >&2
  "$PYTHON" -m pip install --quiet --disable-pip-version-check -c constraints.txt -e "$wanted"
  printf '%s\n%s\n' "$extras" "$(checksum)" >"$STAMP"
}
