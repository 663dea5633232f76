#!/usr/bin/env bash
# Builds the site into out/site, warnings being errors, and checks its links.
set -euo pipefail
VENV=.venv-site # so that what is installed in .venv stays as it is
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv docs

"$PYTHON" scripts/build_site.py "$@"
