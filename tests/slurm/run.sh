#!/usr/bin/env bash
# A sweep under a real Slurm on this machine: an array of four tasks, of which one is told to stop and is queued again, against the same sweep
# run locally. The daemons are started here, in a folder that is removed in the end.
#
# bash tests/slurm/run.sh HEADTAIL
# Exit status 3 says that Slurm's daemons do not start here, which is not a fault of the sweep.
set -euo pipefail
headtail="$(realpath "$1")"
here="$(mktemp -d)"
daemons=()
finish() {
    for pid in "${daemons[@]}"; do kill "$pid" 2>/dev/null || true; done
    for pid in "${daemons[@]}"; do wait "$pid" 2>/dev/null || true; done
    rm -rf "$here"
}
trap finish EXIT
cd "$here"
mkdir state spool
export SLURM_CONF="$here/slurm.conf"
host="$(hostname -s)"
cat >"$SLURM_CONF" <<CONF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$((20000 + RANDOM % 10000))
SlurmdPort=$((30000 + RANDOM % 10000))
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthType=auth/none
CredType=cred/none
StateSaveLocation=$here/state
SlurmdSpoolDir=$here/spool
SlurmctldPidFile=$here/slurmctld.pid
SlurmdPidFile=$here/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
SwitchType=switch/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SchedulerType=sched/builtin
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
MinJobAge=600
KillWait=10
NodeName=localhost NodeHostname=$host NodeAddr=127.0.0.1 CPUs=4 State=UNKNOWN
PartitionName=all Nodes=localhost Default=YES MaxTime=INFINITE State=UP OverSubscribe=FORCE:4
CONF
slurmctld -D -i >controller.log 2>&1 &
daemons+=($!)
slurmd -D -N localhost >node.log 2>&1 &
daemons+=($!)
for _ in $(seq 100); do
    sinfo --noheader --format %t 2>/dev/null | grep -q '^idle' && break
    sleep 0.2
done
if ! sinfo --noheader --format %t 2>/dev/null | grep -q '^idle'; then
    echo "Slurm's daemons do not start here" >&2
    tail -n 5 controller.log node.log >&2
    exit 3
fi

cat >space.toml <<'SPACE'
#SBATCH --partition=all
#SBATCH --comment=passed-on
objectives = ["relative_variance"]
[run]
env = "studio"
steps = 600
conditions = 32
validate_every = 200
validation_conditions = 16
[axes]
head.bins = [4, 8]
seed = [0, 1]
SPACE

"$headtail" sweep run space.toml --out local --jobs 2 --threads 1
start=$SECONDS
job="$("$headtail" sweep submit space.toml --out cluster --checkpoint-every 50 --sbatch=--time=10)"
[ $((SECONDS - start)) -le 5 ] || { echo "submit did not return at once" >&2; exit 1; }
[[ "$job" =~ ^[0-9]+$ ]] || { echo "submit printed '$job'" >&2; exit 1; }
grep -q '^#SBATCH --comment=passed-on' cluster/slurm.sh

# The first task gets on, and is then told that its time is up. A job that is queued again waits for two minutes by default: it is released.
for _ in $(seq 300); do
    ls cluster/trials/*/checkpoints/step-* >/dev/null 2>&1 && break
    sleep 0.1
done
said="$("$headtail" sweep status space.toml --out cluster)"
grep -q "^Slurm: jobs $job: .*RUNNING.*squeue" <<<"$said" || { echo "status says nothing of the queue: $said" >&2; exit 1; }
scancel --signal=USR1 --batch "${job}_0"
for _ in $(seq 600); do
    left="$(squeue --noheader --array --jobs "$job" --format %i 2>/dev/null | wc -l)"
    [ "$left" -gt 0 ] || break
    for task in $(squeue --noheader --array --jobs "$job" --states PENDING --format %i); do
        scontrol update "JobId=$task" StartTime=now 2>/dev/null || true
    done
    sleep 0.3
done
"$headtail" sweep status space.toml --out cluster
grep -hq 'is queued again' cluster/logs/slurm-*.log || { echo "no task was queued again" >&2; cat cluster/logs/*.log >&2; exit 1; }
for task in 0 1 2 3; do
    scontrol show job "${job}_$task" | grep -q 'JobState=COMPLETED' || { scontrol show job "${job}_$task" >&2; exit 1; }
    scontrol show job "${job}_$task" | grep -q 'ExitCode=0:0' || exit 1
done
scontrol show job "${job}_0" | grep -q 'Restarts=1'

# The same rows but for times, and the same files to the bit.
for sweep in local cluster; do
    "$headtail" sweep collect space.toml --out "$sweep" >/dev/null
    for trial in "$sweep"/trials/*; do sha256sum <"$trial/sampler.safetensors" | sed "s|^|$(basename "$trial") |"; done >"$sweep.sums"
done
[ "$(wc -l <local.sums)" -eq 4 ]
cmp local.sums cluster.sums
echo "Slurm: an array of four with one task queued again, equal to the local sweep bit for bit"
