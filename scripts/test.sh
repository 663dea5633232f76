#!/usr/bin/env bash
# Checks everything: form, lint, types, imports, tests; with --slow the slow tests, too. Other
# arguments go to pytest. Where files or folders are among them, types are checked in these alone.
set -euo pipefail
for word in "$@"; do
  case "$word" in
    *.py | *.py::* | tests/*)
      [ -e "${word%%::*}" ] || { echo "test.sh: ${word%%::*}: does not exist" >&2; exit 2; }
      ;;
  esac
done
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv test
if [ "${1:-}" = --slow ]; then
  shift
  set -- -m "" "$@"
fi
unset PYTHONDONTWRITEBYTECODE # hundreds of processes would each compile the package

paths=()
for word in "$@"; do
  [ ! -e "${word%%::*}" ] || paths+=("${word%%::*}")
done

"$PYTHON" -m ruff format --check .
"$PYTHON" -m ruff check .
"$PYTHON" -m basedpyright ${paths[@]+"${paths[@]}"}
if [ ${#paths[@]} -eq 0 ]; then
  .venv/bin/lint-imports --no-logo
  set -- -n 2 "$@"
fi
"$PYTHON" -m pytest -q "$@"
