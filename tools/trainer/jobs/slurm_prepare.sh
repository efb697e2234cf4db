#!/bin/sh
# Makes the shards of recorded runs in the tasks of a SLURM array, and then lists and labels in one job that waits for
# them. Source, store and further options are those of `embodied-depth prepare`, the same in both commands:
#   array=$(sbatch --parsable --array=1-16 slurm_prepare.sh /shared/pulled --out /shared/store)
#   sbatch --dependency="afterany:$array" slurm_prepare.sh /shared/pulled --out /shared/store
# All nodes must mount source and store under the same paths. Both commands may be repeated: only what is missing is made.
# The second one also makes what tasks that failed have left, so it need not wait for a whole array (`afterany`).
# To repeat some tasks of an array of 16 only: PARTS=16 sbatch --array=3,7 slurm_prepare.sh ...
#SBATCH --job-name=embodied-depth-prepare
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --time=24:00:00
#SBATCH --requeue
set -eu
workers="${SLURM_CPUS_PER_TASK:-1}"
if [ -n "${SLURM_ARRAY_TASK_ID:-}" ]; then
    parts="${PARTS:-$SLURM_ARRAY_TASK_COUNT}"
    exec embodied-depth prepare "$@" --workers "$workers" --part "$SLURM_ARRAY_TASK_ID/$parts"
fi
exec embodied-depth prepare "$@" --workers "$workers"
