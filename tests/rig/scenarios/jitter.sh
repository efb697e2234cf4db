#: title   the safety loop's punctuality on PREEMPT_RT, in virtual time
#: kernel  rt
#: icount  1
#: modules
#: seconds 400
seconds=10
world_up --lidar urg-04lx --protocol vesc --picture 160x64 --fps 10
"$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/run --status /rig/status.json >/rig/run.log 2>&1 &
robot=$!
# Its start, in which it claims its memory at its own priority, is not what is measured.
until_value turns /rig/status.json 'v > 100'
# At the safety loop's pace, just below its priority.
cyclictest -m -q -p 39 -i 10000 -D $seconds -h 2000 >/tmp/cyclictest
turns=$(value turns /rig/status.json) missed=$(value skipped /rig/status.json)
kill -TERM $robot
wait $robot
world_down
sed -n '/"safety_late"/,/}/p' /tmp/run/summary.json >/tmp/late

check 'the safety loop at 100 Hz leaves out no turn' \
    awk -v missed=$missed -v turns=$turns 'BEGIN { print missed " of " turns; exit !(missed == 0) }'
check 'the safety loop comes less than 1 ms late' \
    awk -v p50="$(value p50 /tmp/late)" -v p99="$(value p99 /tmp/late)" -v max="$(value max /tmp/late)" 'BEGIN {
        printf "p50 %.0f, p99 %.0f, max %.0f us\n", 1000 * p50, 1000 * p99, 1000 * max; exit !(max > 0 && max < 1) }'
check 'cyclictest beside it at the same pace comes less than 1 ms late' awk '
    /^# Max/ { max = $NF + 0 }
    /^[0-9]/ { late[lines++] = $1 + 0; count[$1 + 0] = $2; all += $2 }
    END {
        for (i = 0; i < lines; i++) {
            seen += count[late[i]]
            if (p50 == "" && 2 * seen >= all) p50 = late[i]
            if (p99 == "" && seen >= 0.99 * all) p99 = late[i]
        }
        print "p50 " p50 ", p99 " p99 ", max " max " us of " all " turns"
        exit !(all > 0 && max > 0 && max < 1000)
    }' /tmp/cyclictest
