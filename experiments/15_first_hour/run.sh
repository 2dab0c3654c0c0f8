#!/usr/bin/env bash
# The commands of docs/first-hour.md one by one, each with its time: run.sh [FOLDER]. `hybrid-id` is on the path.
set -u
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "${1:-runs/first_hour}" && cd "${1:-runs/first_hour}" || exit 2
TIMEFORMAT='[%U s of processor time, %R s of wall time]'
step() { echo; echo "\$ $*"; time "$@"; }

[ -d bench ] || tar xf "$here/logs.tar.xz"
step head -3 bench/run1.csv
step hybrid-id check bench
cp "$here/dataset.yaml" "$here/model.yaml" bench
step hybrid-id check bench
step hybrid-id identify bench --pooled --out runs/identify --force
step hybrid-id diagnose bench --jobs 1 --out runs/gap --force
step hybrid-id diagnose bench --jobs 1 --window 2 --out runs/window --force
step hybrid-id compare bench --model runs/gap/model.yaml --model runs/window/model.yaml --window whole --out runs/both --force
rm -f ./*.xml ./*.json
step hybrid-id export runs/window/refit.yaml --to mjcf --out before.xml --check bench
step hybrid-id export runs/window --to mjcf --out after.xml --check bench
