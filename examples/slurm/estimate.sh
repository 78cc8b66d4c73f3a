#!/bin/bash
#SBATCH --job-name=cophase
#SBATCH --array=1-8
#SBATCH --cpus-per-task=4
#SBATCH --time=00:30:00
# One estimate by a job array, each task a part of its images; merge.sh makes the estimate of all parts:
#
#   job=$(sbatch --parsable estimate.sh night.fits scene.toml est)
#   sbatch --dependency=afterok:$job merge.sh est
#
# A part that is there is not made again. A task that failed is started again alone, with the number of all parts:
#
#   sbatch --array=3 --export=ALL,PARTS=8 estimate.sh night.fits scene.toml est
#
# Where images or scene have changed since, merge.sh says so: remove the parts then.
set -euo pipefail
images=$1 scene=$2 name=$3

export RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1}
part=$name.part$SLURM_ARRAY_TASK_ID.fits
[[ -e "$part" ]] ||
    cophase estimate "$images" --scene "$scene" -o "$part" --part "$SLURM_ARRAY_TASK_ID/${PARTS:-$SLURM_ARRAY_TASK_COUNT}"
