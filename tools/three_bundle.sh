#!/bin/sh
# Writes evaluation/report/assets/three.min.js anew: what the player uses of three.js, and nothing
# else. Needs node, npm and a network; the same inputs give the same bytes, which NOTICE names.
set -eu
three=0.187.0
tarball=ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728
esbuild=0.28.2
out="$(cd "$(dirname "$0")/.." && pwd)/evaluation/report/assets/three.min.js"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
npm pack --silent "three@$three" > /dev/null
echo "$tarball  three-$three.tgz" | sha256sum --check --quiet
npm install --silent --no-save --prefix . "./three-$three.tgz" "esbuild@$esbuild"
cat > used.js <<'USED'
export {
  BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, CircleGeometry, Color, ConeGeometry,
  CylinderGeometry, DirectionalLight, Group, HemisphereLight, Mesh, MeshBasicMaterial,
  MeshStandardMaterial, PerspectiveCamera, Quaternion, Scene, SphereGeometry, Vector3,
  WebGLRenderer,
} from "three";
USED
npx esbuild used.js --bundle --minify --format=iife --global-name=THREE --legal-comments=inline \
    --outfile="$out" --log-level=warning
sha256sum "$out"
