#!/usr/bin/env bash
# Builds the source archive and from it the wheel, installs the wheel alone in a fresh environment, and tries it there:
# the command line, an episode by a map's name, and the tests of the environment. Run it in the repository's root:
# tests/wheel.sh PYTHON TESTS
set -euo pipefail
python=$1
shift
repository=$PWD
outside=$(mktemp -d)
trap 'rm -rf "$outside"' EXIT
rm -rf dist
"$python" -m build --outdir dist . > "$outside/build.log" 2>&1 || { cat "$outside/build.log"; exit 1; }
"$python" -m venv "$outside/venv"
"$outside/venv/bin/pip" install --quiet --disable-pip-version-check --constraint constraints.txt dist/*.whl pytest hypothesis
cp -r tests pyproject.toml "$outside"
cd "$outside"
venv/bin/mapf-pz maps list
venv/bin/mapf-pz render episode.html --policy pibt --map warehouse-10-20-10-2-1
venv/bin/python -c "import mapf_pz; assert '$repository' not in mapf_pz.__file__, mapf_pz.__file__"
venv/bin/python -m pytest -p no:cacheprovider "$@"
