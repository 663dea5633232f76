#!/usr/bin/env bash
# Makes a release ready: checks everything, builds wheel and sdist into dist/, tries them in a fresh
# environment, and tags the commit. Uploads nothing.
#   bash scripts/release.sh --dry-run   the same without the tag, with entries under Unreleased
set -euo pipefail
dry=no
case "${1:-}" in
  --dry-run) dry=yes ;;
  "") ;;
  *)
    echo "roadtorch: error: $1: unknown argument (give --dry-run, or none)" >&2
    exit 2
    ;;
esac
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh" # in the repository's root from here on
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
export PIP_DISABLE_PIP_VERSION_CHECK=1

refuse() { # WHERE WHAT REMEDY
  echo "roadtorch: error: $1: $2 ($3)" >&2
  exit 1
}

said() {
  echo "release: $*"
}

section() { # TITLE: the entries of a section of the changelog
  awk -v title="## $1" 'index($0, "## ") == 1 { inside = $0 == title || index($0, title " ") == 1; next }
    inside && NF' CHANGELOG.md
}

version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' roadtorch/base/version.py)
[[ $version =~ ^[0-9]+\.[0-9]+\.[0-9]+((a|b|rc)[0-9]+)?$ ]] ||
  refuse roadtorch/base/version.py "'$version' is no version" "write MAJOR.MINOR.PATCH"
grep -qx "version: $version" CITATION.cff ||
  refuse CITATION.cff "states another version than $version" "change it there too"
[ -n "$(section "$version")" ] ||
  refuse CHANGELOG.md "has no entries under $version" "move those of Unreleased there"
unreleased=$(section Unreleased | wc -l)
if [ "$dry" = no ]; then
  [ "$unreleased" = 0 ] ||
    refuse CHANGELOG.md "has $unreleased lines under Unreleased" "move them under $version"
  [ -z "$(git tag --list "v$version")" ] ||
    refuse "v$version" "is a tag already" "raise the version"
fi
said "version $version; CITATION.cff and CHANGELOG.md have it; Unreleased has $unreleased lines"
[ -z "$(git status --porcelain)" ] || refuse . "has changes that no commit has" "commit them"
said "clean tree at $(git rev-parse --short HEAD)"

python=$(find_python)
"$python" -m venv "$place/build"
"$place/build/bin/pip" install --quiet build
rm -rf dist
git archive --prefix=source/ HEAD | tar -x -C "$place" # what is committed, and nothing else
"$place/build/bin/python" -m build --outdir dist "$place/source" >"$place/said" 2>&1 ||
  { cat "$place/said" >&2; refuse "$place/source" "cannot be built" "see above"; }
wheel=$(echo dist/*.whl)
"$python" -m zipfile -e "$wheel" "$place/wheel"
tar -x -C "$place" -f dist/*.tar.gz
for made in "$place/wheel" "$place"/roadtorch-*; do # links count as what they lead to
  diff -rq "$place/source/roadtorch" "$made/roadtorch" ||
    refuse "$made" "has other files than the commit" "mend package-data in pyproject.toml"
done

said "installing $wheel in a fresh environment"
"$python" -m venv "$place/env"
PYTHON=$place/env/bin/python choose_index
"$place/env/bin/pip" install --quiet ${INDEX[@]+"${INDEX[@]}"} -c constraints.txt "$wheel"
here=$PWD
cd "$place" # away from the checkout: what is imported is what was installed
env/bin/python -c "import roadtorch; print('release: imported from', roadtorch.__file__.partition('/env/')[2])"
env/bin/roadtorch doctor | tail -n 1
env/bin/python -m roadtorch.testing.scenes --out scenes --count 2
env/bin/roadtorch infer scenes --out roads --config thresholds/fusion --quiet
for result in config.toml index.csv scene_0{0,1}.{likelihood.png,mask.png,overlay.jpg}; do
  [ -s "roads/$result" ] || refuse "roads/$result" "was not made by the demonstration" "mend it"
done
said "the demonstration made $(find roads -type f | wc -l) files"
cd "$here"
(cd dist && sha256sum -- *)
if [ "$dry" = yes ]; then
  said "dry run of $version done; no tag was made"
else
  git tag --annotate "v$version" --message "roadtorch $version"
  said "v$version is tagged; push the tag, and upload dist/ when it is there"
fi
