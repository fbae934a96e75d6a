#!/usr/bin/env bash
# The main jobs, and some tests, with the lowest versions that pyproject.toml allows, then with the
# newest: `tools/lowest.sh`, after `make install`, which has the versions of requirements.lock.
#
# Under build/lowest uv and both environments are kept for the next time. Where pip cannot get uv, the
# script says so and ends.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=build/lowest
uv=$folder/uv/bin/uv
projects=(-e '.[train]' -e workshop -e board)
export JAX_PLATFORMS=cpu

# The tools of the tests are no part of the question, so they come in the newest versions.
make_environment() {
    [ -e "$folder/$1/bin/python" ] || "$uv" venv --quiet --python .venv/bin/python "$folder/$1"
    "$uv" pip install --quiet --python "$folder/$1/bin/python" --resolution "$1" --upgrade "${projects[@]}"
    "$uv" pip install --quiet --python "$folder/$1/bin/python" pytest hypothesis beartype
}

play_jobs() {
    local program="$PWD/$1/bin/assistax-zoo" out="$1/out" tiny=(--task scratch --backend native --episodes 1)
    rm -rf "$out"
    "$program" doctor >"$1/doctor.txt" || { cat "$1/doctor.txt" >&2; return 1; }
    "$program" evaluate "${tiny[@]}" scratch/ppo-ego-s0-v1/robot --partners 'scratch/ippo-d1-s[01]-v1' \
        --no-references --out "$out/evaluate"
    "$program" report "$out/evaluate" --out "$out/evaluate.html"
    "$program" crossplay "${tiny[@]}" --robots 'scratch/ippo-d1-s[012]-v1' --humans 'scratch/ippo-d1-s[012]-v1' \
        --out "$out/crossplay"
    "$program" plot crossplay "$out/crossplay" --out "$out/crossplay.png"
    "$program" train-ego --task scratch --split half-s0-v1 --backend fused --steps 1 --set rollout_steps=4 \
        --set minibatches=2 --set 'hidden=(8, 8)' --out "$out/train"
}

mkdir -p "$folder"
if [ ! -x "$uv" ] && ! { .venv/bin/python -m venv "$folder/uv" && "$folder/uv/bin/python" -m pip install --quiet uv; }; then
    echo "pip could not get uv: neither the lowest nor the newest versions are tried" >&2
    exit 0
fi
for versions in lowest-direct highest; do
    make_environment "$versions"
    export ASSISTAX_ZOO_CACHE="$PWD/$folder/$versions/cache" # XLA's programs of one release are strange to another
    play_jobs "$folder/$versions"
    "$folder/$versions/bin/python" -m pytest -q -o filterwarnings=ignore -m "not slow and not attack" \
        tests/base/test_files.py tests/base/test_statistics.py tests/zoo/test_registry.py tests/evaluation/test_record.py \
        tests/board/test_submit_form.py::test_a_form_from_elsewhere_is_not_read
done
