#!/usr/bin/env bash
# On a machine with a GPU, in under four minutes: throughput, share of the device's limits, accuracy against the CPU, a
# sweep, and gradients, as the table of docs/lab/speed.md. Without a GPU the same, small.
#
#   PYTHON=.venv/bin/python bash tests/benchmarks/gpu.sh [folder for the tables]
set -euo pipefail
cd "$(dirname "$0")/../.."
python=${PYTHON:-python3}
folder=${1:-out}
mkdir -p "$folder"
export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}" TF_CPP_MIN_LOG_LEVEL=3
begin=$SECONDS
if [ "$($python -c 'import jax; print(jax.default_backend())')" = cpu ]; then sizes="100 1000"; else sizes="1000 10000 100000 1000000"; fi
$python -m tests.benchmarks.gpu $sizes | tee "$folder/gpu.md"
echo "in $((SECONDS - begin)) s"
