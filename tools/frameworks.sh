#!/usr/bin/env bash
# The tests that need Stable-Baselines3 and PyTorch: `tools/frameworks.sh`, after `make install`.
#
# They are no part of requirements.lock: PyTorch takes several GB where only its CUDA build is to be
# had. So they get an environment of their own under build/frameworks, kept for the next time, which
# takes everything else from .venv.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=build/frameworks
if [ ! -e "$folder/.installed" ]; then
    rm -rf "$folder"
    .venv/bin/python -m venv "$folder"
    .venv/bin/python -c 'import site; print("\n".join(site.getsitepackages()))' \
        >"$("$folder/bin/python" -c 'import site; print(site.getsitepackages()[0])')/venv.pth"
    "$folder/bin/python" -m pip install --quiet 'torch==2.13.0' 'stable-baselines3==2.9.2'
    touch "$folder/.installed"
fi
"$folder/bin/python" -m pytest -q tests/frameworks tests/envs/test_adapters.py -k "not missing_package"
