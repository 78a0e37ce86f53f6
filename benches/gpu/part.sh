# The parts of a script on a graphics device, whose logs go to $out.
mkdir -p "$out"
# Its absence makes the driver print a warning for every device.
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$out}"

# part NAME SECONDS COMMAND...: one part in a process of its own, with its whole log; a failure ends only this part.
part() {
    local name="$1" limit="$2" start="$SECONDS" status=0
    shift 2
    date "+%T $name" >>"$out/parts.txt"
    timeout "$limit" "$@" >"$out/$name.txt" 2>&1 || status=$?
    echo "$name: status $status, $((SECONDS - start)) s" | tee -a "$out/parts.txt"
}

part devices 20 bash -c 'nvidia-smi || true; lscpu'
# Watts, use and clock of the device four times a second, for all parts: energy is their sum from a part's time to the next.
if command -v nvidia-smi >/dev/null; then
    nvidia-smi --query-gpu=timestamp,power.draw,utilization.gpu,clocks.sm --format=csv -lms 250 >"$out/power.csv" &
    trap "kill $!" EXIT
fi
