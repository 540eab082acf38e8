#!/usr/bin/env bash
# Renews requirements.lock (run and test) and requirements-extras.lock (optional extras) with hashes and
# without any index address. Needs `uv` on PATH: python -m pip install uv
set -euo pipefail
cd "$(dirname "$0")"
compile() { uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
    --custom-compile-command ./lock.sh pyproject.toml "$@"; }
compile --extra test -o requirements.lock
compile --extra test --extra launchers --extra pardiso -c requirements.lock -o requirements-extras.lock
