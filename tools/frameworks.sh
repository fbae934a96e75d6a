#!/usr/bin/env bash
# The tests that need Stable-Baselines3, PyTorch or LeRobot: `tools/frameworks.sh`, after `make install`.
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
    "$folder/bin/python" -m pip install --quiet 'torch==2.13.0' 'stable-baselines3==2.9.2' 'onnxscript==0.7.2'
    touch "$folder/.installed"
fi
# LeRobot wants other versions of what the project uses, so it has nothing of .venv, and of the other
# environment what it lacks, PyTorch above all. Its own bound of PyTorch would bring the CUDA build of
# an older one; the datasets need none of the rest of its list.
lerobot=build/lerobot  # after the first: it has PyTorch from there
if [ ! -e "$lerobot/.installed" ]; then
    rm -rf "$lerobot"
    .venv/bin/python -m venv "$lerobot"
    "$folder/bin/python" -c 'import site; print(site.getsitepackages()[0])' \
        >"$("$lerobot/bin/python" -c 'import site; print(site.getsitepackages()[0])')/torch.pth"
    "$lerobot/bin/python" -m pip install --quiet 'torch==2.13.0' 'torchvision==0.28.0' 'datasets==4.8.5' \
        'huggingface-hub==0.35.3' 'numpy==2.2.6' 'pandas==2.3.3' 'packaging==25.0' 'av==15.1.0' \
        'draccus==0.10.0' 'accelerate==1.15.0' 'deepdiff==9.1.0' 'einops==0.8.2' 'gymnasium==1.4.0' \
        'imageio==2.38.1' 'jsonlines==4.0.0' 'pillow==13.0.0' 'requests==2.34.2' 'termcolor==3.3.0'
    "$lerobot/bin/python" -m pip install --quiet --no-deps 'lerobot==0.4.4'
    touch "$lerobot/.installed"
fi
export LEROBOT_PYTHON="$PWD/$lerobot/bin/python"
"$folder/bin/python" -m pytest -q tests/frameworks tests/envs/test_adapters.py \
    tests/evaluation/test_robot_forms.py tests/evaluation/test_evaluation_mode.py -k "not missing_package"
