#!/bin/sh
# Runs one loop of a job file in each task of a SLURM array:
#   sbatch --array=1-"$(grep -cEv '^[[:space:]]*(#|$)' jobs.txt)" slurm.sh jobs.txt
# A preempted task continues where it was.
#SBATCH --job-name=embodied-depth
#SBATCH --cpus-per-task=2
#SBATCH --mem=8G
#SBATCH --time=24:00:00
#SBATCH --requeue
set -eu
exec embodied-depth loop --jobs "$1" --job "$SLURM_ARRAY_TASK_ID"
