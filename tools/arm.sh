#!/usr/bin/env bash
# The fused engine's golden trajectories on ARM, emulated: `tools/arm.sh FOLDER`, on Debian as root.
#
# QEMU runs an ARM Python with the locked packages' ARM wheels. Nothing of it is installed here but
# qemu-user-static; FOLDER keeps the rest, 1.4 GB. Seven minutes on two cores.
set -euo pipefail
folder=$(realpath "${1:?name a folder for the ARM files}")
cd "$(dirname "$0")/.."
mkdir -p "$folder"/{apt/lists/partial,apt/cache,debs,root,site,wheels}
command -v qemu-aarch64-static >/dev/null || apt-get install -y -qq qemu-user-static

arm=(-oAPT::Architecture=arm64 -oAPT::Architectures=arm64 -oDir::State::Lists="$folder/apt/lists" -oDir::Cache="$folder/apt/cache")
if [ ! -e "$folder/root/usr/bin/python3.11" ]; then
    apt-get "${arm[@]}" update -qq
    (cd "$folder/debs" && apt-get "${arm[@]}" download -qq python3.11-minimal libpython3.11-{minimal,stdlib} libc6 libstdc++6 \
        libgcc-s1 zlib1g libexpat1 libssl3 libffi8 libbz2-1.0 liblzma5 libsqlite3-0 libuuid1 libcrypt1)
    for package in "$folder"/debs/*.deb; do dpkg-deb -x "$package" "$folder/root"; done
fi

platforms=()
for glibc in 17 24 26 27 28 31 34 35; do platforms+=(--platform "manylinux_2_${glibc}_aarch64"); done
names='jax|jaxlib|numpy|scipy|ml-dtypes|opt-einsum|mujoco|warp-lang|absl-py|etils|glfw|pyopengl|jaxtyping|wadler-lindig'
names+='|typing-extensions|zipp|fsspec|pytest|pluggy|iniconfig|packaging|pygments|beartype'
locked=$(sed -En "s/^(($names)==[^ ;\\]+)( ; python_full_version < '3.12')? ?\\\\?$/\1/p" requirements.lock)
.venv/bin/python -m pip download -q --no-deps --only-binary=:all: --python-version 3.11 --implementation cp \
    "${platforms[@]}" --platform manylinux2014_aarch64 -d "$folder/wheels" $locked
for wheel in "$folder"/wheels/*.whl; do .venv/bin/python -m zipfile -e "$wheel" "$folder/site"; done

# Without its windows MuJoCo starts no other process, which would not be emulated.
export MUJOCO_GL=disable JAX_PLATFORMS=cpu XDG_CACHE_HOME="$folder/cache" PYTHONPATH="$folder/site" PYTHONDONTWRITEBYTECODE=1
exec qemu-aarch64-static -L "$folder/root" "$folder/root/usr/bin/python3.11" -m pytest -q tests/envs/fused/test_golden.py
