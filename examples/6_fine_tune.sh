#!/usr/bin/env bash
# 6. Go on training from the shipped weights: a few steps here, some thousands on a dataset of your own objects
#    (docs/dataset.md makes one from the meshes of example 5).
#    bash examples/6_fine_tune.sh [DATASET] [OUT] [STEPS]
#    then: dgs evaluate --out runs/tuned --models-dir OUT --model latest
set -euo pipefail
repo=$(realpath "$(dirname "${BASH_SOURCE[0]}")/..")
source "$repo/ros2_ws/setup_env.sh"
dgs train --dataset "${1:-$repo/models/dataset.npz}" --init dgs_net --out "${2:-$repo/data/fine_tuned}" \
  --steps "${3:-5}" --batch 2 --learning-rate 3e-4 --validate-every 1000
