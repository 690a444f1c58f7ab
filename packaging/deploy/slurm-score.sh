#!/bin/sh
# Scores the recordings of a manifest as a Slurm array job, one shard a task:
#
#   sbatch --array=0-63 packaging/deploy/slurm-score.sh MANIFEST OUT [more options of vitreo score]
#
# Recordings, manifest and OUT lie in folders that every node has, or in an object store (s3://...,
# with AWS_... in the environment, which sbatch hands on).
#
# The number of shards is that of the array, which must begin at 0 and leave none out. The same line
# again does only what is missing: a shard whose table is whole is left alone. A task whose worker
# was killed or lost its store is queued again by itself, twice. One task is run by its number with
# the number of shards said:
#   sbatch --array=17 --export=ALL,SHARDS=64 packaging/deploy/slurm-score.sh MANIFEST OUT
# At the end, vitreo score --gather OUT --csv all.csv puts all tables together, or names what lacks.
#SBATCH --job-name=vitreo-score
#SBATCH --cpus-per-task=4
#SBATCH --mem=4G
#SBATCH --time=01:00:00
#SBATCH --output=vitreo-score-%A-%a.log
#SBATCH --open-mode=append
#SBATCH --requeue
set -eu

if [ "$#" -lt 2 ]; then
    echo "usage: sbatch --array=0-N $0 MANIFEST OUT [options of vitreo score]" >&2
    exit 2
fi
if [ -z "${SLURM_ARRAY_TASK_ID:-}" ]; then
    echo "$0: SLURM_ARRAY_TASK_ID is not set; start it with sbatch --array=0-N" >&2
    exit 2
fi
manifest=$1 out=$2
shift 2
shards=${SHARDS:-${SLURM_ARRAY_TASK_COUNT:?not set by this Slurm; give --export=ALL,SHARDS=N}}
if [ -z "${SHARDS:-}" ] && [ "$((SLURM_ARRAY_TASK_MAX + 1))" -ne "$shards" ]; then
    echo "$0: the array must run from 0 to N without gaps, or SHARDS say how many shards there are" >&2
    exit 2
fi

code=0
vitreo score --manifest "$manifest" --shard "$SLURM_ARRAY_TASK_ID/$shards" --out "$out" --resume \
    --jobs "${SLURM_CPUS_PER_TASK:-1}" "$@" || code=$?
case $code in
# 3: some recordings are damaged and listed in the table; trying again would not mend them.
0 | 3) exit 0 ;;
# Wrong options stay wrong, and a score that differs (the table is written) goes on to differ.
2 | 5) exit "$code" ;;
esac
if [ -n "${SLURM_JOB_ID:-}" ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 2 ]; then
    echo "$0: the worker ended with $code; the task is queued again" >&2
    scontrol requeue "$SLURM_JOB_ID" || true
fi
exit "$code"
