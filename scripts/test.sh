#!/usr/bin/env bash
# Checks everything: form, lint, types, imports, tests; with --slow the slow tests, too. Other
# arguments go to pytest.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv test
if [ "${1:-}" = --slow ]; then
  shift
  set -- -m "" "$@"
fi
unset PYTHONDONTWRITEBYTECODE # hundreds of processes would each compile the package

"$PYTHON" -m ruff format --check .
"$PYTHON" -m ruff check .
"$PYTHON" -m basedpyright
.venv/bin/lint-imports --no-logo
"$PYTHON" -m pytest -q -n 2 "$@"
