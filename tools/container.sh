#!/usr/bin/env bash
# What the container runs: demo, site, or any command.
set -euo pipefail
case "${1:-demo}" in
demo)
    make demo
    cp -r demo/. /out/
    ;;
site)
    make site
    exec python -m http.server --directory build/site 8000
    ;;
*) exec "$@" ;;
esac
