#!/bin/bash
#SBATCH --job-name=cophase-merge
#SBATCH --cpus-per-task=4
#SBATCH --time=00:30:00
# The estimate of the parts that estimate.sh made: NAME.fits of NAME.part*.fits, which are removed.
set -euo pipefail
name=$1

export RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1}
cophase merge "$name".part*.fits -o "$name.fits"
rm "$name".part*.fits
