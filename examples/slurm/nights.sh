#!/bin/bash
#SBATCH --job-name=cophase-nights
#SBATCH --array=0-99
#SBATCH --cpus-per-task=4
#SBATCH --time=00:30:00
# One estimate for each file of a folder, one task for each file:
#
#   sbatch --array=0-99 nights.sh nights scene.toml est
#
# writes est/NAME.fits for each nights/NAME.fits. Task k takes the k-th file by name, from 0, so that no file may be added or removed until
# all tasks are done. --strict ends a task with status 3 where its estimate has warnings: the estimate is written, and `sacct` lists
# the task as failed. A task is repeated by its number:
#
#   sbatch --array=17 nights.sh nights scene.toml est
set -euo pipefail
nights=$1 scene=$2 estimates=$3

export RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1}
shopt -s nullglob
files=("$nights"/*.fits)
if ((SLURM_ARRAY_TASK_ID >= ${#files[@]})); then
    echo "nights.sh: task $SLURM_ARRAY_TASK_ID has no file: $nights has ${#files[@]} (--array=0-$((${#files[@]} - 1)))" >&2
    exit 1
fi
night=${files[SLURM_ARRAY_TASK_ID]}
mkdir -p "$estimates"
cophase estimate "$night" --scene "$scene" -o "$estimates/$(basename "$night")" --strict
