#!/usr/bin/env bash
# Checks everything: form, lint, types, tests. Arguments go to pytest.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv test
unset PYTHONDONTWRITEBYTECODE # hundreds of processes would each compile the package

"$PYTHON" -m ruff format --check .
"$PYTHON" -m ruff check .
"$PYTHON" -m basedpyright
.venv/bin/lint-imports --no-logo
"$PYTHON" -m pytest -q -n 2 "$@"
