#!/usr/bin/env bash
# Builds the site into out/site, warnings being errors, and checks its links.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv test

"$PYTHON" scripts/build_site.py "$@"
