#!/usr/bin/env bash
# Runs a sweep under a real Slurm on this machine: an array of four tasks, three at once, of which two are stopped (one by
# SIGUSR1, one by SIGTERM) and requeued, compared with the same sweep run locally; a task with failed trials; and the
# output of `sweep status` with a queue, and from Slurm's accounts without one. The daemons run in a temporary folder.
# Without slurmdbd and MariaDB there are no accounts, and that part reports a skip.
#
# bash tests/slurm/run.sh HEADTAIL
# Exit status 3 means that Slurm's daemons do not start on this machine, which is not a fault of the sweep.
set -euo pipefail
headtail="$(realpath "$1")"
here="$(mktemp -d)"
daemons=()
finish() {
    for pid in "${daemons[@]}"; do kill "$pid" 2>/dev/null || true; done
    for pid in "${daemons[@]}"; do wait "$pid" 2>/dev/null || true; done
    # The steps of a job briefly outlive the daemons.
    rm -rf "$here" 2>/dev/null || { sleep 3; rm -rf "$here"; }
}
trap finish EXIT
cd "$here"
mkdir state spool
export SLURM_CONF="$here/slurm.conf"
host="$(hostname -s)"

# Accounts: a database on a socket in this folder, and the daemon that writes to it.
accounting="AccountingStorageType=accounting_storage/none"
start_accounts() {
    local program port=$((40000 + RANDOM % 10000))
    for program in slurmdbd sacctmgr sacct mariadbd mariadb-install-db mariadb; do
        command -v "$program" >/dev/null || { echo "SKIPPED: Slurm's accounts (there is no $program)" >&2; return 1; }
    done
    mariadb-install-db --no-defaults "--user=$(id -un)" --datadir="$here/database" --auth-root-authentication-method=normal \
        --skip-test-db >install.log 2>&1
    mariadbd --no-defaults "--user=$(id -un)" --datadir="$here/database" --socket="$here/database.sock" --skip-networking \
        --innodb-buffer-pool-size=16M >database.log 2>&1 &
    daemons+=($!)
    for _ in $(seq 100); do
        mariadb --no-defaults -u root --socket="$here/database.sock" -e 'create database if not exists slurm_acct_db' 2>/dev/null && break
        sleep 0.2
    done
    cat >slurmdbd.conf <<CONF
AuthType=auth/none
DbdHost=localhost
DbdPort=$port
SlurmUser=$(id -un)
PidFile=$here/slurmdbd.pid
StorageType=accounting_storage/mysql
StorageHost=localhost
StorageUser=root
StorageLoc=slurm_acct_db
CONF
    chmod 600 slurmdbd.conf
    accounting="AccountingStorageType=accounting_storage/slurmdbd
AccountingStorageHost=127.0.0.1
AccountingStoragePort=$port"
    # sacctmgr also reads it.
    printf 'ClusterName=test\nSlurmctldHost=%s(127.0.0.1)\nAuthType=auth/none\n%s\n' "$host" "$accounting" >"$SLURM_CONF"
    MYSQL_UNIX_PORT="$here/database.sock" slurmdbd -D >accounts.log 2>&1 &
    daemons+=($!)
    for _ in $(seq 100); do
        timeout 10 sacctmgr --immediate add cluster test >/dev/null 2>&1 && return
        sleep 0.2
    done
    echo "the daemon of Slurm's accounts does not start here" >&2
    tail -n 5 install.log database.log accounts.log >&2
    exit 3
}
has_accounts=yes
start_accounts || has_accounts=no

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
# Allows four tasks on a machine with two cores.
SlurmdParameters=config_overrides
SlurmctldPidFile=$here/slurmctld.pid
SlurmdPidFile=$here/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
SwitchType=switch/none
JobAcctGatherType=jobacct_gather/none
$accounting
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
controller=$!
daemons+=("$controller")
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
job="$("$headtail" sweep submit space.toml --out cluster --checkpoint-every 50 --at-once 3 --sbatch=--time=10)"
[ $((SECONDS - start)) -le 5 ] || { echo "submit did not return at once" >&2; exit 1; }
[[ "$job" =~ ^[0-9]+$ ]] || { echo "submit printed '$job'" >&2; exit 1; }
grep -q '^#SBATCH --comment=passed-on' cluster/slurm.sh
scontrol show job "$job" | grep -q 'ArrayTaskThrottle=3' || { echo "not three tasks at once" >&2; scontrol show job "$job" >&2; exit 1; }

# When the first two tasks have made progress, one is signalled that its time is up, the other to end. Requeued jobs wait
# two minutes by default, so they are released.
for _ in $(seq 300); do
    [ "$(find cluster/trials -path '*/checkpoints/step-*' -prune 2>/dev/null | cut -d/ -f3 | sort -u | wc -l)" -ge 3 ] && break
    sleep 0.1
done
said="$("$headtail" sweep status space.toml --out cluster)"
grep -q "^Slurm: jobs $job: .*RUNNING.*squeue" <<<"$said" || { echo "status says nothing of the queue: $said" >&2; exit 1; }
scancel --signal=USR1 --batch "${job}_0"
scancel --signal=TERM --batch "${job}_1"
for _ in $(seq 90); do
    left="$(squeue --noheader --array --jobs "$job" --format %i 2>/dev/null | wc -l)"
    [ "$left" -gt 0 ] || break
    waiting="$(squeue --noheader --array --jobs "$job" --states PENDING --format %i)"
    # Seen once on a busy machine: a task that started within the second in which its earlier run ended failed at once,
    # without output.
    sleep 2
    for task in $waiting; do
        scontrol update "JobId=$task" StartTime=now 2>/dev/null || true
    done
done
"$headtail" sweep status space.toml --out cluster
grep -hq 'asks to be queued again' cluster/logs/slurm-*.log || { echo "no task was queued again" >&2; cat cluster/logs/*.log >&2; exit 1; }
for task in 0 1 2 3; do
    scontrol show job "${job}_$task" | grep -q 'JobState=COMPLETED' || { scontrol show job "${job}_$task" >&2; cat cluster/logs/*.log >&2; tail -n 30 controller.log node.log >&2; exit 1; }
    scontrol show job "${job}_$task" | grep -q 'ExitCode=0:0' || exit 1
done
for task in 0 1; do
    scontrol show job "${job}_$task" | grep -q 'Restarts=1' || { echo "task $task was not queued again" >&2; cat cluster/logs/*.log >&2; exit 1; }
done

# The rows are equal except for times, and the files are identical.
for sweep in local cluster; do
    "$headtail" sweep collect space.toml --out "$sweep" >/dev/null
    for trial in "$sweep"/trials/*; do sha256sum <"$trial/sampler.safetensors" | sed "s|^|$(basename "$trial") |"; done >"$sweep.sums"
done
[ "$(wc -l <local.sums)" -eq 4 ]
cmp local.sums cluster.sums

# A task with a failed trial exits with 1.
sed 's/^env = .*/env = "none.hdr"/' space.toml >wrong.toml
wrong="$("$headtail" sweep submit wrong.toml --out wrong --tasks 1 --sbatch=--time=10)"
for _ in $(seq 100); do
    scontrol show job "${wrong}_0" | grep -q 'JobState=FAILED' && break
    sleep 0.2
done
scontrol show job "${wrong}_0" | grep -q 'ExitCode=1:0' || { echo "failed trials, and no exit status of 1" >&2; scontrol show job "${wrong}_0" >&2; exit 1; }

# Accounts: of a cancelled job, with a queue, and without one.
if [ "$has_accounts" = yes ]; then
    says() {
        for _ in $(seq 50); do
            said="$("$headtail" sweep status "$1" --out "$2")"
            grep -q "$3" <<<"$said" && return
            sleep 0.2
        done
        echo "status does not say '$3': $said" >&2
        exit 1
    }
    sed 's/^steps = 600/steps = 1000000/' space.toml >long.toml
    taken="$("$headtail" sweep submit long.toml --out taken --sbatch=--time=10)"
    says long.toml taken "^Slurm: jobs $taken: 4 RUNNING (sacct, squeue)"
    scancel "${taken}_2"
    says long.toml taken "^Slurm: task ${taken}_2: CANCELLED, exit 0:"
    scancel "$taken"
    says long.toml taken "^Slurm: task ${taken}_0: CANCELLED, exit 0:"
    for _ in $(seq 100); do
        [ -n "$(squeue --noheader)" ] || break
        sleep 0.2
    done
    kill "$controller"
    wait "$controller" || true
    says space.toml cluster "^Slurm: jobs $job: 4 COMPLETED (sacct)"
    says long.toml taken "^Slurm: jobs $taken: 4 CANCELLED (sacct)"
    echo "Slurm: accounts of jobs that ended and of those that were taken away"
fi
echo "Slurm: an array of four with two tasks queued again, equal to the local sweep bit for bit"
