#: title   the safety loop's punctuality on PREEMPT_RT, in virtual time
#: kernel  rt
#: icount  1
#: modules
#: seconds 400
seconds=20
world_up --picture 160x64
# Just below the safety loop's priority, at its pace.
cyclictest -m -q -p 39 -i 10000 -D $seconds -h 5000 >/tmp/cyclictest &
cyclictest=$!
"$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/run --status /rig/status.json >/tmp/run.log 2>&1 &
robot=$!
until_value turns /rig/status.json "v > 100 * $seconds"
turns=$(value turns /rig/status.json) missed=$(value skipped /rig/status.json)
kill -TERM $robot
wait $robot $cyclictest
world_down
sed -n '/"safety_late"/,/}/p' /tmp/run/summary.json >/tmp/late

check 'the safety loop at 100 Hz leaves out no turn' \
    awk -v missed=$missed -v turns=$turns 'BEGIN { print missed " of " turns; exit !(missed == 0) }'
check 'the safety loop comes less than 1 ms late' \
    awk -v p50="$(value p50 /tmp/late)" -v p99="$(value p99 /tmp/late)" -v max="$(value max /tmp/late)" 'BEGIN {
        printf "p50 %.0f, p99 %.0f, max %.0f us\n", 1000 * p50, 1000 * p99, 1000 * max; exit !(max > 0 && max < 1) }'
check 'cyclictest beside it at the same pace comes less than 1 ms late' awk '
    /^[0-9]/ { late[lines++] = $1 + 0; count[$1 + 0] = $2; all += $2 }
    END {
        for (i = 0; i < lines; i++) {
            seen += count[late[i]]
            if (p50 == "" && 2 * seen >= all) p50 = late[i]
            if (p99 == "" && seen >= 0.99 * all) p99 = late[i]
            if (count[late[i]] > 0) max = late[i]
        }
        print "p50 " p50 ", p99 " p99 ", max " max " us of " all " turns"
        exit !(all > 0 && max < 1000)
    }' /tmp/cyclictest
