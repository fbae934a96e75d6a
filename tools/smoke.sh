#!/usr/bin/env bash
# A small set of tests on another Python than .venv's: `tools/smoke.sh`, after `make install`.
#
# It takes what is installed, or else what uv can get; without any it says so and goes on. Under
# build/smoke the environment and a Python of uv's are kept for the next time.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=build/smoke
default=$(.venv/bin/python -c 'import sys; print("%d.%d" % sys.version_info[:2])')

find_python() {
    for version in 3.13 3.12 3.11; do
        [ "$version" = "$default" ] && continue
        for candidate in "python$version" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python3 \
            "$folder/pythons"/*"$version"*/bin/python3; do
            "$candidate" -c 'import ensurepip, venv' 2>/dev/null && echo "$candidate" && return
        done
    done
    return 1
}

get_python() {
    python3 -m venv "$folder/uv" && "$folder/uv/bin/python" -m pip install --quiet uv || return
    version=3.13
    [ "$default" = 3.13 ] && version=3.12
    timeout 300 "$folder/uv/bin/uv" python install --quiet --no-bin --install-dir "$folder/pythons" "$version"
}

mkdir -p "$folder"
if ! python=$(find_python); then
    get_python && python=$(find_python) || {
        echo "no other Python than $default is installed, and uv could get none: no smoke" >&2
        exit 0
    }
fi
"$python" --version
make install VENV="$folder/venv" PYTHON="$python"
"$folder/venv/bin/python" -m pytest -q -m "not slow and not attack" tests/base tests/zoo/test_registry.py \
    tests/envs/fused/test_golden.py tests/population/test_ppo.py tests/evaluation/test_evaluator.py \
    tests/workshop/test_plan.py tests/board/test_submissions.py tests/cli/test_main.py
