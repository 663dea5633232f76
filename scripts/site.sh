#!/usr/bin/env bash
# Builds the site into out/site, warnings being errors, and checks its links. Where npm is, the site
# has the page that finds the road in a browser.
set -euo pipefail
VENV=.venv-site # so that what is installed in .venv stays as it is
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
prepare_venv docs

if command -v npm >/dev/null; then
  version=$("$PYTHON" -c "from roadtorch.export.folders import RUNTIME_VERSION as v; print(v)")
  mkdir -p out/browser
  (
    cd out/browser
    npm install --silent --no-audit --no-fund --prefix . "onnxruntime-web@$version"
    "../../$PYTHON" -m roadtorch export fusion --format web --out page
  )
  set -- --page out/browser/page "$@"
fi
"$PYTHON" scripts/build_site.py "$@"
